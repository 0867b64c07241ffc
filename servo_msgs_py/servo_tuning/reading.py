"""Read ``servo.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.catalogue import AXIS_NAMES, Catalogue
from servo_msgs_py.text_file import TextFileError, parse_toml, read_toml

from servo_tuning.checks import check
from servo_tuning.configuration import Axis, Board, Configuration, Scales
from servo_tuning.errors import ConfigError, checking
from servo_tuning.schema import unknown_name

_CONFIG: Final = Path(__file__).resolve().parents[2] / "firmware" / "config"


def _file_of(board: str) -> Path:
    """Configuration of the checkout for a board: that of the default board if it has none of its own."""
    own = _CONFIG / f"{board}.toml"
    return own if own.is_file() else _CONFIG / "servo.toml"


SERVO_TOML: Final = _file_of(BoardDescription.load().name)
"""Configuration of the checkout for the board of this process; missing in an installed package."""


def load(path: Path, catalogue: Catalogue) -> Configuration:
    """Read and check a file.

    Raises
    ------
    ConfigError
        If it is not valid TOML or the configuration cannot work.
    OSError
        If it cannot be read.
    """
    return parse(read_table(path), catalogue)


def read_table(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Parsed file. With an entry ``base`` it contains the differences from another file, relative to its own folder.

    Parameters
    ----------
    path : Path
        The file.
    seen : tuple of Path
        Files whose base it is, resolved.

    Raises
    ------
    ConfigError
        If it is not valid TOML, or its base leads back to it.
    OSError
        If it cannot be read.
    """
    try:
        table = read_toml(path)
    except TextFileError as error:
        raise ConfigError(str(error)) from None
    base = table.pop("base", None)
    if base is None:
        return table
    seen = (*seen, path.resolve())
    file = path.parent / str(base)
    if file.resolve() in seen:
        raise ConfigError(f"{path}: base = {str(base)!r} leads back to this file; remove it, or name another")
    return _merged(read_table(file, seen), table)


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of `changes` change single entries, everything else replaces."""
    nested = {
        key: _merged(base[key], value)
        for key, value in changes.items()
        if isinstance(value, Mapping) and isinstance(base.get(key), Mapping)
    }
    return {**base, **changes, **nested}


def loads(text: str, catalogue: Catalogue) -> Configuration:
    """Read and check the text of a file.

    Raises
    ------
    ConfigError
        If it is not valid TOML or the configuration cannot work.
    """
    try:
        table = parse_toml(text)
    except TextFileError as error:
        raise ConfigError(str(error)) from None
    return parse(table, catalogue)


def parse(table: Mapping[str, Any], catalogue: Catalogue) -> Configuration:
    """Check a parsed table.

    Raises
    ------
    ConfigError
        If the configuration cannot work.
    """
    with checking(table):
        configuration = complete(table, catalogue)
        check(configuration, catalogue)
    return configuration


def complete(table: Mapping[str, Any], catalogue: Catalogue) -> Configuration:
    """Check that a parsed table has all entries, and no unknown ones; whether they can work is not checked.

    Raises
    ------
    ConfigError
        If an entry is missing, unknown, or outside its range.
    """
    known = ("board", "defaults", *AXIS_NAMES)
    for name in table:
        if name not in known:
            raise unknown_name(f"[{name}]", name, known)
    feature_names = [flag.name.lower() for flag in catalogue.flags["features"]]
    fault_names = [flag.name.lower() for flag in catalogue.flags["faults"]]
    with checking(table):
        board = Board.of(table.get("board", {}), catalogue.board)
        axes = tuple(Axis.of(table, name, feature_names, fault_names) for name in AXIS_NAMES)
    return Configuration(board, axes, Scales.of(catalogue), table)
