"""Port to a board: the integers of its variables, and its time; functions over it for one axis.

Its implementations are the serial line and the virtual board. A recording is part of
`servo_measurement.access.BoardAccess`, which is derived from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

TICK: Final = PERIOD_NS * SLOW_PERIODS * 1e-9
"""One slow tick [s]."""

_INSTANT: Final = 1e-9  # tolerance of times [s]


class BoardTime(Protocol):
    """Time of a board."""

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


class BoardPort(BoardTime, BoardWords, Protocol):
    """A board."""

    @property
    def catalogue(self) -> Catalogue:
        """Catalogue of its variables."""


def until(board: BoardTime, holds: Callable[[], bool], seconds: float, step: float = TICK) -> bool:
    """Wait until a condition holds.

    Parameters
    ----------
    board : BoardTime
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
