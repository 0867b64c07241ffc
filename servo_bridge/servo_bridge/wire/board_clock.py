"""Board time and host time: counting ticks past 32 bits, and mapping them to the clocks of the host. Pure.

A sample reaches the host some time after the tick that it shows: transmission, adapter, operating system. That delay
only ever adds, so the smallest difference seen lately is the best estimate of the offset between both clocks.
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
    """A tick past 32 bits."""

    tick: int  # PWM periods since reset
    epoch: int  # board resets seen so far; ticks of different epochs are unrelated
    reset: bool  # whether this reading is the first of a new epoch


class TickExtender:
    """Follows a 32-bit tick past its wraps and notices resets of the board.

    Between two readings the count has to grow about as much as the host's clock. One that goes back, leaps ahead or
    has fallen far behind comes from a board that was reset in between. The bounds are wide, because a virtual board on
    a loaded computer runs unevenly.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._last_ns = 0
        self._epoch = 0

    def restart(self) -> None:
        """Note a reset that was seen otherwise: the next reading begins a new epoch."""
        self._last = None
        self._epoch += 1

    def update(self, raw: int, host_ns: int) -> TickReading:
        """Take a reading.

        Parameters
        ----------
        raw : int
            uint32 tick.
        host_ns : int
            Arrival on a clock that never goes back [ns].
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
    """Maps ticks of the board to the host's monotonic clock.

    The estimate follows the smallest delay of the last seconds smoothly: down within 0.1 s, because a smaller delay is
    proof that the estimate was late, and up within 1 s, which is enough for the drift of a crystal. Only after a
    standstill of more than 0.25 s it jumps. Stamps grow strictly and never lie after the arrival of their sample.

    Parameters
    ----------
    minimum_delay_ns : int
        Part of the delay that is certain, such as the time of the answer on the line [ns].
    window_ns : int
        How long a small delay is remembered [ns].
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
        """Discard the offset: the board counts anew."""
        self._buckets.clear()
        self._offset = None

    def update(self, tick: int, arrival_ns: int) -> int:
        """Take a sample.

        Parameters
        ----------
        tick : int
            Extended tick of the sample; larger than that of the sample before.
        arrival_ns : int
            When its last byte came, monotonic host clock [ns].

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
        """Host time of any tick near the last sample [ns].

        Raises
        ------
        ValueError
            Before the first sample.
        """
        if self._offset is None:
            raise ValueError("the board has not been seen yet")
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
    """Maps the monotonic clock to a clock that may be set, such as ROS time.

    Parameters
    ----------
    wall, steady : callable
        Read both clocks [ns].
    """

    def __init__(self, wall: Callable[[], int], steady: Callable[[], int] = time.monotonic_ns) -> None:
        self._wall = wall
        self._steady = steady
        self._offset: int | None = None
        self._last_stamp: int | None = None
        self.refresh()

    def refresh(self) -> None:
        """Compare both clocks again; call it about once a second, and for every stamp while the time is simulated.

        A comparison that the operating system interrupted is dropped, unless it is the first.
        """
        before = self._steady()
        wall = self._wall()
        after = self._steady()
        if self._offset is None or after - before <= _BRACKET_NS:
            self._offset = wall - (before + after) // 2

    def stamp(self, steady_ns: int) -> int:
        """Wall time of a monotonic time as a stamp [ns]: it grows, unless the wall clock was set back by a second."""
        stamp, last = self.wall_ns(steady_ns), self._last_stamp
        if last is not None and last - _STEP_BACK_NS < stamp <= last:
            stamp = last + 1
        self._last_stamp = stamp
        return stamp

    def wall_ns(self, steady_ns: int) -> int:
        """Wall time of a monotonic time [ns]."""
        assert self._offset is not None
        return steady_ns + self._offset
