"""Level of detail of a virtual board and the software that it executes, with their defaults."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Final, Literal, get_args

from servo_msgs_py.text_file import TextFileError, read_bytes

Level = Literal["registers", "ideal"]
"""Level of detail of the model."""

LEVEL_VARIABLE: Final = "SERVO_TWIN_LEVEL"
"""Environment variable with the level of boards without an explicit level."""

ELF_VARIABLE: Final = "SERVO_TWIN_ELF"
"""Environment variable with the ELF file of boards at level registers without an explicit one."""

DEFAULT_LEVEL: Final[Level] = "registers"
"""Default level of a board: the most detailed one."""

ELF_LEVEL: Final[Level] = "registers"
"""Level at which a board executes an ELF file."""

FAST_LEVEL: Final[Level] = "ideal"
"""Default level of experiments, which simulate minutes and hours."""

ELF_BYTES_MAX: Final = 16_000_000
"""Largest ELF file, with the information for a debugger."""

_ELF_MARK: Final = b"\x7fELF"

LEVELS: Final[tuple[Level, ...]] = get_args(Level)


def chosen_level(level: Level | None = None, default: Level = DEFAULT_LEVEL) -> Level:
    """`level`, or the value of the environment variable `LEVEL_VARIABLE`, or `default`; with an ELF file its level.

    Raises
    ------
    ValueError
        If the level does not exist.
    """
    name = level or os.environ.get(LEVEL_VARIABLE, ELF_LEVEL if os.environ.get(ELF_VARIABLE) else default)
    for known in LEVELS:
        if name == known:
            return known
    raise ValueError(f"level {name!r} does not exist; levels: {', '.join(LEVELS)}")


def chosen_elf() -> bytes | None:
    """ELF file of the environment variable `ELF_VARIABLE`; None without one.

    Raises
    ------
    ValueError
        If it cannot be read, is too large, or is no ELF file.
    """
    name = os.environ.get(ELF_VARIABLE)
    if not name:
        return None
    try:
        data = read_bytes(Path(name), ELF_BYTES_MAX)
    except OSError as error:
        raise ValueError(f"{name}: {error.strerror}") from None
    except TextFileError as error:
        raise ValueError(f"{name}: {error}") from None
    if not data.startswith(_ELF_MARK):
        raise ValueError(f"{name}: this is no ELF file; `make firmware` makes one")
    return data


def add_level_options(parser: argparse.ArgumentParser, what: str, default: str = DEFAULT_LEVEL) -> None:
    """Add ``--level`` and ``--elf``; `what` is the start of a help text, as in "the board is", `default` its end."""
    parser.add_argument(
        "--level", choices=LEVELS, help=f"level at which {what} modelled (default: ${LEVEL_VARIABLE}, or {default})"
    )
    parser.add_argument(
        "--elf",
        type=Path,
        metavar="FILE",
        help=f"execute the firmware of this ELF file (make firmware), at level {ELF_LEVEL} (default: ${ELF_VARIABLE})",
    )


def use_elf(args: argparse.Namespace) -> None:
    """Let all boards of this process and of its children have the ELF file of the option.

    Raises
    ------
    ValueError
        If the level of the option is another one, or the file cannot be read.
    """
    if args.elf is None:
        return
    if chosen_level(args.level, ELF_LEVEL) != ELF_LEVEL:
        raise ValueError(f"an ELF file runs at level {ELF_LEVEL} only")
    os.environ[ELF_VARIABLE] = str(args.elf.resolve())
    chosen_elf()
