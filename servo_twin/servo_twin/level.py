"""How closely a virtual board is modelled, and who chooses."""

from __future__ import annotations

import argparse
import os
from typing import Final, Literal, get_args

Level = Literal["registers", "ideal"]
"""How closely the board is modelled."""

LEVEL_VARIABLE: Final = "SERVO_TWIN_LEVEL"
"""Environment variable that names the level of boards without an explicit one."""

DEFAULT_LEVEL: Final[Level] = "registers"
"""Where it does not, either: as close to the board as there is."""

FAST_LEVEL: Final[Level] = "ideal"
"""Of experiments, which simulate minutes and hours, unless another is named."""

_LEVELS: Final[tuple[Level, ...]] = get_args(Level)


def chosen_level(level: Level | None = None, default: Level = DEFAULT_LEVEL) -> Level:
    """The level of a board for which `level` is asked: that, or what the environment names, or `default`.

    Raises
    ------
    ValueError
        If there is no such level.
    """
    name = level or os.environ.get(LEVEL_VARIABLE, default)
    for known in _LEVELS:
        if name == known:
            return known
    raise ValueError(f"level {name!r}: a board has the levels {', '.join(_LEVELS)}")


def add_level_option(parser: argparse.ArgumentParser, what: str, default: Level = DEFAULT_LEVEL) -> None:
    """Let a command line choose the level of `what`, as in "the board is"."""
    parser.add_argument(
        "--level", choices=_LEVELS, help=f"how closely {what} modelled (default: ${LEVEL_VARIABLE}, or {default})"
    )
