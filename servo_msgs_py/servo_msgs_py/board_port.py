"""Port to a board: the integers of its variables, and its time; functions over it for one axis.

Its implementations are the serial line and the virtual board. A recording is part of
`servo_measurement.access.BoardAccess`, which is derived from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.units import TICK
from servo_msgs_py.value_text import value_text

_INSTANT: Final = 1e-9  # tolerance of times [s]


class Waiting(Protocol):
    """Time in which a board can be waited for."""

    def clock(self) -> float:
        """Elapsed time including communication [s]; only differences are meaningful."""

    def wait(self, seconds: float) -> None:
        """Let board time elapse [s]; the board does not detect a loss of its host during the wait."""


class BoardWords(Protocol):
    """Raw integers of a board's variables."""

    def read_words(self, name: str) -> list[int]:
        """All elements of a variable."""

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        """Write elements of a variable from `first` on in one request; False if the board refuses the values."""


class BoardPort(Waiting, BoardWords, Protocol):
    """A board."""

    @property
    def catalogue(self) -> Catalogue:
        """Catalogue of its variables."""


def reached(board: Waiting, holds: Callable[[], bool], seconds: float, step: float = TICK) -> bool:
    """Wait for a condition.

    Parameters
    ----------
    board : Waiting
        The board.
    holds : callable
        The condition.
    seconds : float
        Timeout [s].
    step : float
        Time between two checks [s].

    Returns
    -------
    bool
        Whether it holds.
    """
    end = board.clock() + seconds - _INSTANT
    while not holds():
        if board.clock() >= end:
            return False
        board.wait(step)
    return True


def word(board: BoardPort, axis: int, name: str) -> int:
    """Raw integer of a variable of an axis."""
    return board.read_words(f"{axis_name(axis)}.{name}")[0]


def place(board: BoardPort, axis: int) -> str:
    """Sub-state of an axis in RUN, or its state."""
    state = board.catalogue.label("state_t", word(board, axis, "state"))
    return board.catalogue.label("substate_t", word(board, axis, "substate")) if state == "RUN" else state


def active(board: BoardPort, axis: int, name: str = "faults") -> set[str]:
    """Names of the set flags in a word of an axis."""
    return {flag.name for flag in board.catalogue.active(name, word(board, axis, name))}


def first_fault(board: BoardPort, axis: int) -> str:
    """Name of the first fault of an axis; empty: none."""
    code = word(board, axis, "first_fault")
    return next((fault.name for fault in board.catalogue.flags["faults"] if fault.bit + 1 == code), "")


def read_axis(board: BoardPort, name: str, axis: int) -> float:
    """One element of an array variable [SI]."""
    return float(board.catalogue[name].scale(board.read_words(name)[axis]))


def write_axis(board: BoardPort, name: str, axis: int, value: float) -> None:
    """Write one element of an array variable [SI], without a write to the other axis.

    Raises
    ------
    ValueError
        If the value is outside the limits of the variable, or the board refuses it.
    """
    write_word(board, name, axis, board.catalogue[name].to_raw(value))


def write_word(board: BoardPort, name: str, axis: int, raw: int) -> None:
    """As `write_axis`, with the raw integer."""
    if not board.write_words(name, [raw], axis):
        variable = board.catalogue[name]
        value = value_text(variable, variable.scale(raw), board.catalogue)
        raise ValueError(f"{name}: the board refuses {value} for {axis_name(axis)}")


def choose(board: BoardPort, name: str, axis: int, label: str) -> None:
    """Write one element of an array of enumeration values by its name, such as ``SPEED``."""
    enum = board.catalogue[name].enum
    assert enum is not None
    write_word(board, name, axis, board.catalogue.enums[enum][label])
