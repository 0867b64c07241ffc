"""Command lines: a parser, numbers, files and names as types for `argparse`, and the layout of its help."""

from __future__ import annotations

import re
import textwrap
from argparse import ArgumentParser, ArgumentTypeError, HelpFormatter
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.figure import PictureError, check_picture
from servo_msgs_py.output_file import check_output
from servo_msgs_py.quantity import ABOVE_0, Quantity

_FINITE: Final = Quantity()
_NOT_NEGATIVE: Final = Quantity(minimum=0.0)
_POSITIVE: Final = Quantity(minimum=ABOVE_0)
_WHOLE: Final = Quantity(minimum=0.0, whole=True)
_COUNT: Final = Quantity(minimum=1.0, whole=True)
_NEGATIVE: Final = re.compile(
    r"-(\.?\d[\d._]*(e[+-]?\d+)?|0x[\da-f]+|0b[01]+|0o[0-7]+|inf(inity)?|nan)(,.*)?$", re.IGNORECASE
)
_NAMESPACE: Final = re.compile(r"/?([a-z_]\w*/)*([a-z_]\w*)?", re.ASCII | re.IGNORECASE)


class Parser(ArgumentParser):
    """Parser that takes every negative number for a value, and not for an option: also ``-1e-3`` and ``-3,4``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = _NEGATIVE


def finite(text: str, valid: Quantity = _FINITE) -> float:
    """A finite number that is valid for a quantity."""
    try:
        return valid.parse(text)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None


def not_negative(text: str) -> float:
    """A finite number of at least 0."""
    return finite(text, _NOT_NEGATIVE)


def positive(text: str) -> float:
    """A finite number above 0."""
    return finite(text, _POSITIVE)


def whole(text: str, valid: Quantity = _WHOLE) -> int:
    """A whole number that is valid for a quantity, by default of at least 0."""
    return int(finite(text, valid))


def count(text: str) -> int:
    """A whole number of at least 1."""
    return whole(text, _COUNT)


def namespace(text: str) -> str:
    """A namespace of ROS, absolute or relative; may be empty."""
    if not _NAMESPACE.fullmatch(text):
        raise ArgumentTypeError(f"{text!r} is no ROS namespace; write names of ASCII letters, digits and _, as /servo")
    return text


def output_file(text: str, *, folder: bool = False) -> Path:
    """A file that can be written, as far as that is known before a program begins its work."""
    path = Path(text)
    try:
        check_output(path, folder=folder)
    except OSError as error:
        raise ArgumentTypeError(f"{text!r} cannot be written: {error.strerror} ({error.filename})") from None
    return path


def output_folder(text: str) -> Path:
    """A folder for files that can be written; it may be missing."""
    return output_file(text, folder=True)


def picture(text: str) -> Path:
    """A file for a picture, in a format that can be drawn."""
    path = output_file(text)
    try:
        check_picture(path)
    except PictureError as error:
        raise ArgumentTypeError(str(error)) from None
    return path


class ParagraphFormatter(HelpFormatter):
    """Formatter that fills each paragraph of a description on its own, and keeps those with indented lines."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = re.split(r"\n\s*\n", textwrap.dedent(text).strip())
        return "\n\n".join(
            textwrap.indent(paragraph, indent)
            if re.search(r"^\s", paragraph, re.MULTILINE)
            else super(ParagraphFormatter, self)._fill_text(paragraph, width, indent)
            for paragraph in paragraphs
        )
