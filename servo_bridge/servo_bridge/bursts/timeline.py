"""Common timeline of telemetry rows and burst points."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS, unwrap_u32

from servo_bridge.bursts.request import TICK
from servo_bridge.wire.board_clock import TickExtender


class Timeline(Protocol):
    """Timeline that begins with the first row."""

    def row(self, time_ns: int, tick: int | None) -> float | None:
        """Time of a row [s]; None if it repeats the previous row.

        Parameters
        ----------
        time_ns : int
            Monotonic time of the response [ns].
        tick : int or None
            uint32 tick of the board; None if it has no tick.
        """

    def burst(self, burst: Trace, stopped_ns: int) -> NDArray[np.float64]:
        """Times of the points of a burst [s].

        Parameters
        ----------
        burst : Trace
            Points of a recorder; with the tick if the board has one.
        stopped_ns : int
            Monotonic time at which the recorder was found stopped [ns].
        """


class BoardTime:
    """Time by the ticks of the board: rows and bursts are exact to the tick."""

    def __init__(self) -> None:
        self._extender = TickExtender()
        self._first: int | None = None
        self._last = 0

    def row(self, time_ns: int, tick: int | None) -> float | None:
        """Time since the first row [s] by `tick`; None for a repeated tick."""
        assert tick is not None
        extended = self._extender.update(tick, time_ns, time_ns).tick
        if self._first is None:
            self._first = extended
        elif extended == self._last:
            return None
        self._last = extended
        return (extended - self._first) * PERIOD_NS * 1e-9

    def burst(self, burst: Trace, stopped_ns: int) -> NDArray[np.float64]:
        """Times of the points of a burst since the first row [s], shape (points,), by their ticks."""
        assert self._first is not None
        ticks = [unwrap_u32(int(tick), self._last) - self._first for tick in burst[TICK].tolist()]
        return np.array(ticks, np.float64) * (PERIOD_NS * 1e-9)


class HostTime:
    """Time by the clock of this computer: a burst ends when its recorder is found stopped, about 50 ms late."""

    def __init__(self) -> None:
        self._first: int | None = None

    def row(self, time_ns: int, tick: int | None) -> float | None:
        """Time since the first row [s] by the host clock."""
        if self._first is None:
            self._first = time_ns
        return (time_ns - self._first) * 1e-9

    def burst(self, burst: Trace, stopped_ns: int) -> NDArray[np.float64]:
        """Times of the points of a burst since the first row [s], shape (points,); the last is at `stopped_ns` [ns]."""
        assert self._first is not None
        end = (stopped_ns - self._first) * 1e-9
        return np.asarray(burst.time - burst.time[-1] + end)
