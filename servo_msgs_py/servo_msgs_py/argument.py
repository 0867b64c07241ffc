"""Numbers on a command line, as types for `argparse`, and the layout of its help."""

from __future__ import annotations

import re
import textwrap
from argparse import ArgumentTypeError, HelpFormatter
from typing import Final

from servo_msgs_py.quantity import ABOVE_0, Quantity

_FINITE: Final = Quantity()
_NOT_NEGATIVE: Final = Quantity(minimum=0.0)
_POSITIVE: Final = Quantity(minimum=ABOVE_0)
_WHOLE: Final = Quantity(minimum=0.0, whole=True)
_COUNT: Final = Quantity(minimum=1.0, whole=True)


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
