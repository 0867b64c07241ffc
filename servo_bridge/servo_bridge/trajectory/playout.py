"""When a set-point of a stream is due: clock offset, delay and jitter from stamps and arrival times."""

from __future__ import annotations

from bisect import insort
from collections import deque
from itertools import pairwise
from statistics import median

_WINDOW = 128
"""Messages that the estimates look back on."""

_QUANTILE = 0.95
"""Share of the messages that the measured jitter covers; the others are bridged by extrapolation."""

_SLEW = 0.05
"""Largest rate of change of the delay: velocities are off by this part while it changes."""

_STEP = 1.0
"""Farther than this a stamp is of another clock, or after a pause [s]."""

_STRANGE = 10
"""Messages in a row that are late by more than that, until the clock of the sender is taken to have been set back."""


class PlayoutClock:
    """Maps the time here to the stamp that is due.

    The message with the least delay in a window gives the offset of the clocks, which includes that delay; the spread
    of the others gives the jitter. A message is needed one period after the one before, so period plus jitter is the
    delay that bridges both. It changes slowly, so that the motion neither jumps nor stops.

    Parameters
    ----------
    lead : float
        How long before they are due points are fetched [s].
    delay_max : float, optional
        Bound of the delay besides the lead [s]; by default one period of the stream.
    """

    def __init__(self, lead: float, delay_max: float | None = None) -> None:
        self.lead = lead  # [s]; the delay follows a change slowly
        self._delay_max = delay_max
        self.received = self.lost = self.late = 0  # messages; missing in the order of stamps; after they were due
        self.reset()

    def reset(self) -> None:
        """Discard the clock of the sender; the counts stay."""
        self._transits: deque[float] = deque(maxlen=_WINDOW)
        self._recent: deque[float] = deque(maxlen=_WINDOW)
        self._pending: list[float] = []
        self._passed: float | None = None
        self._shift: float | None = None
        self._strange = 0
        self.offset = self.jitter = self.period = 0.0

    def belongs(self, stamp: float, arrival: float) -> bool:
        """False if the stamp [s] is from another clock than those before: then a `reset` is due."""
        if not self._transits:
            return True
        excess = arrival - stamp - self.offset
        self._strange = self._strange + 1 if excess > _STEP else 0
        return excess > -_STEP and self._strange < _STRANGE

    def heard(self, stamp: float, arrival: float) -> None:
        """Take a message into the estimates.

        Parameters
        ----------
        stamp, arrival : float
            On the clock of the sender and on the one here [s].
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
    def delay_wanted(self) -> float:
        """Delay besides the lead that the estimates ask for, within its bound [s]."""
        bound = self.period if self._delay_max is None else self._delay_max
        return min(self.period + self.jitter, bound)

    @property
    def delay(self) -> float:
        """Delay now, from the fastest message on, with the lead [s]."""
        return self.lead if self._shift is None else self._shift - self.offset

    def due(self, time: float, step: float) -> tuple[float, float]:
        """Stamp that is due at a time here, and how fast stamps pass; called once per step.

        Parameters
        ----------
        time, step : float
            Now, and since the call before [s].
        """
        target = self.offset + self.lead + self.delay_wanted
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
