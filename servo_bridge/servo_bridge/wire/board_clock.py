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


_WRAP: Final = 1 << 32


@dataclass(frozen=True)
class TickReading:
    """Tick extended beyond 32 bits."""

    tick: int  # PWM periods since reset
    epoch: int  # number of board resets; ticks of different epochs are not comparable


class TickExtender:
    """Extends a 32-bit tick beyond its wraps, and compares its advance with the clock of the host.

    A clock that disagrees proves nothing: the board may have been reset, the computer suspended, or a virtual board may
    run slowly. The owner asks the board (`boot_token`) and registers a reset by `restart`.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._last_ns = (0, 0)
        self._epoch = 0

    def restart(self) -> None:
        """Register a reset of the board: the next reading begins a new epoch."""
        self._last = None
        self._epoch += 1

    def disagreement(self, raw: int, request_ns: int, response_ns: int) -> int:
        """Smallest error of the clocks that explains a reading [ns]; 0: they agree.

        The board takes the tick between request and response, however late the host processes the response. Within
        this uncertainty the bounds are wide, because a virtual board on a busy computer runs unevenly.

        Parameters
        ----------
        raw : int
            uint32 tick.
        request_ns, response_ns : int
            Request and arrival of the reading, monotonic clock [ns].
        """
        if self._last is None:
            return 0
        advance = (self._extended(raw, request_ns, response_ns) - self._last) * PERIOD_NS
        shortest = request_ns - self._last_ns[1]
        longest = response_ns - self._last_ns[0]
        fastest = round(longest * _FASTEST_BOARD) + _SLACK_NS
        slowest = round(shortest * _SLOWEST_BOARD) - _SLACK_NS
        return max(advance - fastest, slowest - advance, 0)

    def update(self, raw: int, request_ns: int, response_ns: int) -> TickReading:
        """Process a reading; arguments as in `disagreement`."""
        self._last = self._extended(raw, request_ns, response_ns)
        self._last_ns = (request_ns, response_ns)
        return TickReading(self._last, self._epoch)

    def _extended(self, raw: int, request_ns: int, response_ns: int) -> int:
        """Tick after the last one, with the number of wraps that agrees best with the clock of the host."""
        if self._last is None:
            return raw
        step = (raw - self._last) % _WRAP
        elapsed = (request_ns + response_ns - sum(self._last_ns)) // (2 * PERIOD_NS)
        wraps = max(0, round((elapsed - step) / _WRAP))
        return self._last + step + wraps * _WRAP


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
