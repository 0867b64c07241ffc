"""Compares the mean difference of each signal with a healthy pair; also detects changes without an equation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.lockstep.twin import Pair

MONITORED: Final = {"position": "rad", "speed": "rad/s", "i_q": "A", "u_q": "V", "u_d": "V"}
"""Variables of an axis and units, referred to the motor."""

NAMES: Final = tuple(f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in MONITORED)
"""Names of the variables, in the order of `SignalMeans` read row by row."""

_TIME: Final = 0.2  # time constant of the mean [s]
_SETTLING: Final = 2.0  # settling time of the mean [_TIME]

_Array = NDArray[np.float64]


class SignalMeans:
    """Running means of the differences of both axes."""

    def __init__(self) -> None:
        self._means = np.zeros((AXES, len(MONITORED)))
        self.interrupt()

    def interrupt(self) -> None:
        """The next pair does not follow on the last one."""
        self._means[:] = 0.0
        self._age = 0.0
        self._tick: int | None = None

    def update(self, pair: Pair) -> _Array | None:
        """Means, shape (axes, signals), in the units of `MONITORED`; None while settling. Missing signals are 0."""
        if pair.difference or pair.fault:
            self.interrupt()
            return None
        before, self._tick = self._tick, pair.tick
        if before is None:
            return None
        seconds = (pair.tick - before) * PERIOD_NS * 1e-9
        self._age += seconds
        share = 1.0 - math.exp(-seconds / _TIME)
        real, twin = pair.real, pair.twin
        difference = np.array([real[name] - twin[name] if name in twin else 0.0 for name in NAMES])
        difference = difference.reshape(self._means.shape)
        difference[list(pair.stopping), 0] = 0.0  # the boards stop at different positions
        self._means += share * (difference - self._means)
        return self._means if self._age > _SETTLING * _TIME else None


class SignalMonitor:
    """Compares the means with those of a healthy pair.

    Parameters
    ----------
    limits : ndarray, shape (axes, signals)
        Largest mean of a healthy pair.
    """

    def __init__(self, limits: Sequence[Sequence[float]]) -> None:
        self._limits = np.array(limits)
        self._means = SignalMeans()
        self.beyond: tuple[str, ...] = ()  # variables whose mean is beyond its limit
        self.deviation: tuple[int, str] | None = None  # axis, and the deviation as text; None: no deviation

    def interrupt(self) -> None:
        """The next pair does not follow on the last one."""
        self._means.interrupt()
        self.beyond, self.deviation = (), None

    def update(self, pair: Pair) -> None:
        """Evaluate a pair."""
        means = self._means.update(pair)
        self.beyond, self.deviation = (), None
        if means is None:
            return
        excess = np.abs(means) / self._limits
        self.beyond = tuple(NAMES[k] for k in np.flatnonzero(excess > 1.0))
        axis, signal = (int(k) for k in np.unravel_index(int(np.argmax(excess)), excess.shape))
        if excess[axis, signal] > 1.0:
            name, unit = list(MONITORED.items())[signal]
            text = f"{name} differs by {means[axis, signal]:+.3g} {unit} on average, limit "
            self.deviation = axis, f"{text}{self._limits[axis, signal]:.3g}"
