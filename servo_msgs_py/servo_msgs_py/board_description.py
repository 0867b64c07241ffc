"""Descriptions of the boards (``boards/NAME.toml``): what the hardware of a board gives, as typed objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.text_file import read_toml

DEFAULT_BOARD: Final = "mc56f84789"
"""Board of the firmware and of the twin. Firmware and configurations that name no board are for it."""

FIRMWARE: Final = "servo"
"""Name of the firmware. It reports ``servo/BOARD``, and before it knew the name of its board, ``servo``."""

_FOLDER: Final = Path(__file__).with_name("boards")


class OtherBoardError(ValueError):
    """A board has no description, or is not the expected one; the message contains its name and the known ones."""


@dataclass(frozen=True, kw_only=True)
class BoardDescription:
    """What the hardware of one board gives."""

    name: str
    ranges: Mapping[str, float]  # full scales of the measured quantities, SI, by the names that variables.toml uses

    @classmethod
    def parse(cls, name: str, table: Mapping[str, Any]) -> BoardDescription:
        """Description from the parsed file."""
        return cls(name=name, **table)

    @classmethod
    def load(cls, name: str = DEFAULT_BOARD) -> BoardDescription:
        """Packaged description.

        Raises
        ------
        OtherBoardError
            If there is none of this name.
        """
        if name not in known_boards():
            raise OtherBoardError(f"there is no description of the board {name!r}; {_known()}")
        return cls.parse(name, read_toml(_FOLDER / f"{name}.toml"))


def board_of(reported: str) -> str | None:
    """Board of a target by the name that its firmware reports; None: another firmware."""
    firmware, _, board = reported.partition("/")
    return (board or DEFAULT_BOARD) if firmware == FIRMWARE else None


def check_board(name: str, expected: BoardDescription) -> None:
    """Check that a board is the expected one.

    Raises
    ------
    OtherBoardError
        If it is not.
    """
    if name != expected.name:
        raise OtherBoardError(f"{name!r} is not the board {expected.name!r} of this program; {_known()}")


@lru_cache(maxsize=1)
def known_boards() -> tuple[str, ...]:
    """Names of the packaged descriptions."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def _known() -> str:
    return f"known are {', '.join(known_boards())}"
