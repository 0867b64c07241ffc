"""Board time and host time: extension of ticks beyond 32 bits, and mapping to the clocks of the host.

A sample arrives some time after its tick: transmission, adapter, operating system. This delay is never negative, so the
smallest recent difference is the best estimate of the offset between both clocks.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.units import PERIOD_NS

_BUCKETS: Final = 8
_UP_NS: Final = 1_000_000_000
_DOWN_NS: Final = 100_000_000
_FASTEST_SLEW: Final = 0.1
_STEP_NS: Final = 250_000_000
_SLACK_NS: Final = 1_000_000_000
_FASTEST_BOARD: Final = 1.01
_SLOWEST_BOARD: Final = 0.5
_BRACKET_NS: Final = 100_000
_STEP_BACK_NS: Final = 1_000_000_000


@dataclass(frozen=True)
class TickReading:
    """Tick extended beyond 32 bits."""

    tick: int  # PWM periods since reset
    epoch: int  # number of board resets; ticks of different epochs are not comparable
    reset: bool  # whether this reading is the first of a new epoch


class TickExtender:
    """Extends a 32-bit tick beyond its wraps and detects resets of the board.

    Between two readings the tick must advance about as much as the clock of the host. A tick that goes back, leaps or
    lags far behind means a reset of the board. The bounds are wide, because a virtual board on a busy computer runs
    unevenly.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._last_ns = 0
        self._epoch = 0

    def restart(self) -> None:
        """Register a reset that was detected otherwise: the next reading begins a new epoch."""
        self._last = None
        self._epoch += 1

    def update(self, raw: int, host_ns: int) -> TickReading:
        """Process a reading.

        Parameters
        ----------
        raw : int
            uint32 tick.
        host_ns : int
            Arrival, monotonic clock [ns].
        """
        last = self._last
        tick, reset = raw, False
        if last is not None:
            step = (raw - last) & 0xFFFF_FFFF
            elapsed = host_ns - self._last_ns
            fastest = elapsed * _FASTEST_BOARD + _SLACK_NS
            slowest = elapsed * _SLOWEST_BOARD - _SLACK_NS
            reset = not slowest <= step * PERIOD_NS <= fastest
            tick = raw if reset else last + step
        self._epoch += reset
        self._last, self._last_ns = tick, host_ns
        return TickReading(tick, self._epoch, reset)


class BoardClock:
    """Maps ticks of the board to the monotonic clock of the host.

    The estimate follows the smallest delay of the last seconds: downwards within 0.1 s, because a smaller delay proves
    that the estimate was too large, and upwards within 1 s, which is sufficient for the drift of a crystal. It jumps
    only after a standstill of more than 0.25 s. Stamps increase strictly and are never after the arrival of the sample.

    Parameters
    ----------
    minimum_delay_ns : int
        Known part of the delay, such as the transmission time of the response [ns].
    window_ns : int
        Time for which a small delay is remembered [ns].
    """

    def __init__(self, minimum_delay_ns: int = 0, window_ns: int = 2_000_000_000) -> None:
        self._minimum_delay_ns = minimum_delay_ns
        self._bucket_ns = max(1, window_ns // _BUCKETS)
        self._buckets: deque[tuple[int, int]] = deque()  # number of the bucket, smallest offset in it
        self._offset: float | None = None
        self._last_tick = 0
        self._last_stamp: int | None = None

    @property
    def offset_ns(self) -> float | None:
        """Host time of tick zero [ns]; None before the first sample."""
        return self._offset

    def reset(self) -> None:
        """Discard the offset after a restart of the board."""
        self._buckets.clear()
        self._offset = None

    def update(self, tick: int, arrival_ns: int) -> int:
        """Process a sample.

        Parameters
        ----------
        tick : int
            Extended tick of the sample; larger than the previous one.
        arrival_ns : int
            Arrival of the last byte, monotonic host clock [ns].

        Returns
        -------
        int
            Host time of the tick [ns].
        """
        latest = arrival_ns - self._minimum_delay_ns
        target = self._smallest(latest - tick * PERIOD_NS, arrival_ns)
        if self._offset is None or abs(target - self._offset) > _STEP_NS:
            self._offset = float(target)
        else:
            elapsed = max(0, tick - self._last_tick) * PERIOD_NS
            error = target - self._offset
            share = min(elapsed / (_UP_NS if error > 0.0 else _DOWN_NS), 1.0)
            limit = _FASTEST_SLEW * elapsed
            self._offset += max(-limit, min(limit, error * share))
        self._last_tick = tick
        stamp = min(self.host_ns(tick), latest)
        if self._last_stamp is not None:
            stamp = max(stamp, self._last_stamp + 1)
        self._last_stamp = stamp
        return stamp

    def host_ns(self, tick: int) -> int:
        """Host time of a tick close to the last sample [ns].

        Raises
        ------
        ValueError
            Before the first sample.
        """
        if self._offset is None:
            raise ValueError("no sample of the board yet")
        return tick * PERIOD_NS + round(self._offset)

    def _smallest(self, offset: int, arrival_ns: int) -> int:
        number = arrival_ns // self._bucket_ns
        if self._buckets and self._buckets[-1][0] == number:
            self._buckets[-1] = (number, min(self._buckets[-1][1], offset))
        else:
            self._buckets.append((number, offset))
        while self._buckets[0][0] <= number - _BUCKETS:
            self._buckets.popleft()
        return min(value for _, value in self._buckets)


class WallClock:
    """Maps the monotonic clock to a clock that can be set, such as ROS time.

    Parameters
    ----------
    wall, steady : callable
        Functions that read the clocks [ns].
    """

    def __init__(self, wall: Callable[[], int], steady: Callable[[], int] = time.monotonic_ns) -> None:
        self._wall = wall
        self._steady = steady
        self._offset: int | None = None
        self._last_stamp: int | None = None
        self.refresh()

    def refresh(self) -> None:
        """Compare both clocks again; call it about once a second, with simulated time for every stamp.

        A comparison that was interrupted by the operating system is discarded, unless it is the first.
        """
        before = self._steady()
        wall = self._wall()
        after = self._steady()
        if self._offset is None or after - before <= _BRACKET_NS:
            self._offset = wall - (before + after) // 2

    def stamp(self, steady_ns: int) -> int:
        """Wall time of a monotonic time as a stamp [ns]; increasing, unless the wall clock was set back by a second."""
        stamp, last = self.wall_ns(steady_ns), self._last_stamp
        if last is not None and last - _STEP_BACK_NS < stamp <= last:
            stamp = last + 1
        self._last_stamp = stamp
        return stamp

    def wall_ns(self, steady_ns: int) -> int:
        """Wall time of a monotonic time [ns]."""
        assert self._offset is not None
        return steady_ns + self._offset
