"""Order of the samples of one board in a recording: the next one, one out of order, or the first one after a reset.

Ticks fall at a reset, and where messages are out of order or repeated. The clock of the recording tells which: without
a reset it moves as the ticks do, and after one at least as much as the board has run since.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from servo_msgs_py.units import PERIOD_NS

_TOLERANCE_NS: Final = 1_000_000_000  # of the clock of the recording against the ticks [ns]


class Place(Enum):
    """Where samples belong."""

    NEXT = "behind those before"
    LATE = "out of order, or repeated"
    RESET = "first after a reset of the board"


class SampleOrder:
    """Follows the messages of one topic in the order of the recording."""

    def __init__(self) -> None:
        self.newest: float | None = None  # tick; None: no message yet
        self._time_ns = 0

    def place(self, first: float, last: float, time_ns: int) -> Place:
        """Place of the next message.

        Parameters
        ----------
        first, last : float
            Ticks of its first and last sample.
        time_ns : int
            Time of the recording [ns].
        """
        found = Place.NEXT if first <= last else Place.RESET
        if self.newest is not None and first <= self.newest:
            clock = time_ns - self._time_ns
            out_of_order = abs(clock - (last - self.newest) * PERIOD_NS)
            after_reset = max(first * PERIOD_NS - clock, 0.0)
            found = Place.LATE if out_of_order < min(after_reset, _TOLERANCE_NS) else Place.RESET
        if found is not Place.LATE:
            self.newest, self._time_ns = last, time_ns
        return found
