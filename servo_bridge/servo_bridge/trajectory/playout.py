"""Jitter buffer of a stream: clock offset, delay and jitter from time stamps and arrival times."""

from __future__ import annotations

from bisect import insort
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

JITTER_MAX = 0.02
"""Largest jitter that is compensated by default [s]."""

_WINDOW = 128
"""Number of messages in the estimates."""

_QUANTILE = 0.95
"""Fraction of the messages covered by the measured jitter; later ones are bridged by extrapolation."""

_SLEW = 0.05
"""Largest rate of change of the delay [s/s]; relative error of the velocities during a change."""

_STEP = 1.0
"""Larger jumps mean a new clock or a pause [s]."""

_LATE_MAX = 10
"""Consecutive messages later than `_STEP` until the clock of the sender counts as reset."""


@dataclass(frozen=True)
class PlayoutFigures:
    """State of a jitter buffer."""

    delay: float  # from the arrival of the fastest message to its use in the path [s]
    jitter: float  # spread of the transit times [s]
    period: float  # period of the stamps [s]
    received: int  # messages
    lost: int  # missing messages
    late: int  # messages after their due time


class PlayoutClock:
    """Jitter buffer: maps local time to the sender's time stamp that is due.

    The smallest transit time in a window is the clock offset (including the smallest delay); the spread of the other
    transit times is the jitter. Each message is needed one period after the previous one, so the delay is period plus
    jitter, within a bound. The delay changes slowly, so that the motion neither jumps nor stops.

    Parameters
    ----------
    lead : float
        Time before its due time at which a point is fetched [s].
    delay_max : float, optional
        Bound of the delay without the lead [s]; default: one period of the stream, and up to `JITTER_MAX` of jitter.
    """

    def __init__(self, lead: float, delay_max: float | None = None) -> None:
        self.lead = lead  # [s]; `delay` follows a change of it slowly
        self._delay_max = delay_max
        self.received = self.lost = self.late = 0  # numbers of messages
        self.reset()

    def reset(self) -> None:
        """Restart the estimates for another clock; the counters are kept."""
        self._transits: deque[float] = deque(maxlen=_WINDOW)
        self._recent: deque[float] = deque(maxlen=_WINDOW)
        self._pending: list[float] = []
        self._passed: float | None = None
        self._shift: float | None = None  # local time minus due stamp [s]
        self._late_in_a_row = 0
        self.offset = self.jitter = self.period = 0.0

    def belongs(self, stamp: float, arrival: float) -> bool:
        """False if the stamp [s] is from another clock than the previous ones; then call `reset`."""
        if not self._transits:
            return True
        excess = arrival - stamp - self.offset
        self._late_in_a_row = self._late_in_a_row + 1 if excess > _STEP else 0
        return excess > -_STEP and self._late_in_a_row < _LATE_MAX

    def add_message(self, stamp: float, arrival: float) -> None:
        """Update the estimates with a message.

        Parameters
        ----------
        stamp, arrival : float
            Times of the clock of the sender and of the local clock [s].
        """
        self.received += 1
        self._transits.append(arrival - stamp)
        again = stamp in self._recent
        self._recent.append(stamp)
        self.offset = min(self._transits)
        self.jitter = sorted(self._transits)[round(_QUANTILE * (len(self._transits) - 1))] - self.offset
        gaps = [after - before for before, after in pairwise(sorted(set(self._recent)))]
        self.period = median(gaps) if gaps else self.period
        if self._shift is not None and stamp < arrival - self._shift + self.lead:
            self.late += 1
        if self._passed is None or stamp > self._passed:
            insort(self._pending, stamp)
        elif self.lost and not again:
            self.lost -= 1

    @property
    def bound(self) -> float:
        """Bound of the delay without the lead [s]."""
        return self.period + min(self.jitter, JITTER_MAX) if self._delay_max is None else self._delay_max

    @property
    def delay_target(self) -> float:
        """Delay without the lead according to the estimates, within its bound [s]."""
        return min(self.period + self.jitter, self.bound)

    @property
    def delay(self) -> float:
        """Present delay with the lead, relative to the fastest message [s]."""
        return self.lead if self._shift is None else self._shift - self.offset

    @property
    def figures(self) -> PlayoutFigures:
        """Present state."""
        return PlayoutFigures(self.delay, self.jitter, self.period, self.received, self.lost, self.late)

    def due(self, time: float, step: float) -> tuple[float, float]:
        """Stamp that is due at a local time, and its rate of change; called once per step.

        Parameters
        ----------
        time, step : float
            Present time, and time since the previous call [s].
        """
        target = self.offset + self.lead + self.delay_target
        rate = 1.0
        if self._shift is None:
            self._shift = target
        else:
            change = min(max(target - self._shift, -_SLEW * step), _SLEW * step)
            self._shift += change
            rate = 1.0 - change / step
        stamp = time - self._shift
        self._count_losses(stamp)
        return stamp, rate

    def _count_losses(self, until: float) -> None:
        while self._pending and self._pending[0] <= until:
            stamp = self._pending.pop(0)
            gap = 0.0 if self._passed is None else stamp - self._passed
            if self.period and gap < _STEP:
                self.lost += max(round(gap / self.period) - 1, 0)
            self._passed = stamp
