"""Model of the encoder timers of one axis in the configuration of DRM 2.4: TMRx0 with emulated index, and captures."""

from __future__ import annotations

import math
from dataclasses import dataclass

COUNTS = 4000
TIMER_CLOCK = 781_250.0  # bus clock / 128 [Hz]
AGE_OVERFLOW = 0x10000


class QuadTimer:
    """Model of TMRx0 and TMRx2, edge by edge (F10, F12, F13)."""

    def __init__(self, shaft: int = 0, count: int = 0, period: int = COUNTS) -> None:
        self._period = period
        self.shaft = shaft  # true position [edges]; a B edge follows each odd number upwards
        self.count = count  # TMRx0, -3999 .. 3999 with the period 4000
        self.index = 0  # TMRx2, 16 bits, increasing only
        self._oflag = False
        self.index_works = True

    def move(self, edges: int) -> None:
        """Move the shaft by some edges."""
        step = 1 if edges > 0 else -1
        for _ in range(abs(edges)):
            b_edge = (self.shaft if step > 0 else self.shaft - 1) % 2 == 1
            self.shaft += step
            if b_edge:
                self._oflag = False
            last = step * (self._period - 1)
            self.count = 0 if self.count == last else self.count + step
            if self.count == last and not self._oflag:  # compare match: OFLAG rises and clocks TMRx2
                self._oflag = True
                if self.index_works:
                    self.index = (self.index + 1) & 0xFFFF

    @property
    def raw(self) -> int:
        """The counter register."""
        return self.count & 0xFFFF


@dataclass
class EdgeCapture:
    """Captures of the B edges of a shaft at constant speed by TMRx0, TMRx1 and TMRx3.

    Every second count is a B edge. Only the first edge after arming is captured.
    """

    speed: float  # counts per second, signed, not 0
    start: float = 0.0  # position at time 0 [counts]
    stamp: int = 0  # TMRx1 at time 0

    def __post_init__(self) -> None:
        self._sign = 1 if self.speed > 0 else -1
        x = self.start / 2.0
        self._next = math.floor(x) + 1 if self.speed > 0 else math.ceil(x) - 1  # the next B edge is at twice this count
        self._last = -1.0  # time of the last captured edge [s]

    def _time_of(self, edge: int) -> float:
        return (2 * edge - self.start) / self.speed

    def take(self, now: float) -> tuple[int, int] | None:
        """Count and time stamp of the first edge since the last call, or None; then arm again."""
        if self._time_of(self._next) > now:
            return None
        count, self._last = 2 * self._next, self._time_of(self._next)
        while self._time_of(self._next) <= now:
            self._next += self._sign
        wrapped = int(math.fmod(count, COUNTS))  # towards zero, as TMRx0 counts from rest
        return wrapped & 0xFFFF, (math.floor(self._last * TIMER_CLOCK) + self.stamp) & 0xFFFF

    def age(self, now: float) -> int:
        """Age of the last edge by TMRx3, saturated as in hal_edge_age."""
        if self._last < 0:
            return AGE_OVERFLOW
        return min(math.floor(now * TIMER_CLOCK) - math.floor(self._last * TIMER_CLOCK), AGE_OVERFLOW)
