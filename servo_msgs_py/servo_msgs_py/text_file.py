"""Text files of users: UTF-8, with or without the byte order mark that editors of Windows write, and any line ends."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BYTES_MAX: Final = 1_000_000
"""Largest file without another bound [bytes]."""

_MARK = "\ufeff"
_DIGITS: Final = "an integer has more digits than Python converts; write a smaller number"
_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")


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
    return decoded(read_bytes(path, bytes_max))


def read_bytes(path: Path, bytes_max: int) -> bytes:
    """Read a file of a bounded size; a device may have no end.

    Raises
    ------
    TextFileError
        If it is larger.
    OSError
        If it cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(bytes_max + 1)
    if len(data) > bytes_max:
        raise TextFileError(f"it has more than {bytes_max} bytes, the largest size; choose a smaller file")
    return data


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
    except ValueError:
        raise TextFileError(_DIGITS) from None
    return table


def toml_text(table: Mapping[str, Any], name: str = "") -> str:
    """Text of nested tables, which `parse_toml` reads; their values as in `toml_value`."""
    groups = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    head = f"[{name}]\n" if name else ""
    entries = [f"{toml_key(key)} = {toml_value(value)}\n" for key, value in table.items() if key not in groups]
    prefix = f"{name}." if name else ""
    return head + "".join(entries) + "".join(toml_text(group, prefix + toml_key(key)) for key, group in groups.items())


def toml_key(key: str) -> str:
    """Key of an entry, quoted if necessary."""
    return key if _BARE_KEY.fullmatch(key) else toml_value(key)


def toml_value(value: object) -> str:
    """TOML of a number, boolean, string, or list or tuple of these."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        # As in JSON, but TOML has no surrogate pairs, and no DEL in a string.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_value, value))}]"
    return repr(value)


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
    except ValueError:
        raise TextFileError(_DIGITS) from None


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
