"""Text files of users: UTF-8, with or without the byte order mark that editors of Windows write, and any line ends."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BYTES_MAX: Final = 1_000_000
"""Largest file without another bound [bytes]."""

_MARK = "\ufeff"


class TextFileError(ValueError):
    """The contents are not text, TOML or JSON; the message has the place and a remedy, but not the path."""


def decoded(data: bytes) -> str:
    r"""Text of a file, without byte order mark, with ``\n`` at the line ends.

    Raises
    ------
    TextFileError
        If it is not UTF-8.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data[:4]:
        raise TextFileError("it is UTF-16 or UTF-32 text, or no text; save it as UTF-8")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise TextFileError(
            f"line {line}: the byte {data[error.start]:#x} is not UTF-8; save the file as UTF-8"
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_text(path: Path, bytes_max: int = BYTES_MAX) -> str:
    """Read a text file of a bounded size.

    Raises
    ------
    TextFileError
        If it is not UTF-8, or larger.
    OSError
        If it cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(bytes_max + 1)
    if len(data) > bytes_max:
        raise TextFileError(f"it has more than {bytes_max} bytes, the largest size; choose a smaller file")
    return decoded(data)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse the text of a TOML file.

    Raises
    ------
    TextFileError
        If it is not TOML.
    """
    try:
        table: dict[str, Any] = tomllib.loads(text.removeprefix(_MARK))
    except tomllib.TOMLDecodeError as error:
        raise TextFileError(f"{error}; correct the TOML") from None
    except RecursionError:
        raise TextFileError("too many nested brackets; correct the TOML") from None
    return table


def parse_json(text: str) -> Any:
    """Parse the text of a JSON file.

    Raises
    ------
    TextFileError
        If it is not JSON.
    """
    try:
        return json.loads(text.removeprefix(_MARK))
    except json.JSONDecodeError as error:
        raise TextFileError(f"line {error.lineno}: {error.msg} at column {error.colno}; correct the JSON") from None
    except RecursionError:
        raise TextFileError("too many nested brackets; correct the JSON") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    TextFileError
        If it is not UTF-8 or not TOML.
    OSError
        If it cannot be read.
    """
    return parse_toml(read_text(path))
