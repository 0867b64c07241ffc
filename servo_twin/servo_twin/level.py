"""Level of detail of a virtual board, and its defaults."""

from __future__ import annotations

import argparse
import os
from typing import Final, Literal, get_args

Level = Literal["registers", "ideal"]
"""Level of detail of the model."""

LEVEL_VARIABLE: Final = "SERVO_TWIN_LEVEL"
"""Environment variable with the level of boards without an explicit level."""

DEFAULT_LEVEL: Final[Level] = "registers"
"""Default level of a board: the most detailed one."""

FAST_LEVEL: Final[Level] = "ideal"
"""Default level of experiments, which simulate minutes and hours."""

LEVELS: Final[tuple[Level, ...]] = get_args(Level)


def chosen_level(level: Level | None = None, default: Level = DEFAULT_LEVEL) -> Level:
    """`level`, or the value of the environment variable `LEVEL_VARIABLE`, or `default`.

    Raises
    ------
    ValueError
        If the level does not exist.
    """
    name = level or os.environ.get(LEVEL_VARIABLE, default)
    for known in LEVELS:
        if name == known:
            return known
    raise ValueError(f"level {name!r} does not exist; levels: {', '.join(LEVELS)}")


def add_level_option(parser: argparse.ArgumentParser, what: str, default: str = DEFAULT_LEVEL) -> None:
    """Add ``--level``; `what` is the start of its help text, as in "the board is", `default` its end."""
    parser.add_argument(
        "--level", choices=LEVELS, help=f"level at which {what} modelled (default: ${LEVEL_VARIABLE}, or {default})"
    )
