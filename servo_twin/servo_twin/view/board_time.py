"""Time line of a recording: board time since the start of the recording [s].

Telemetry is located by its tick. Data with only a ROS stamp are located by interpolation between rows of telemetry with
tick and stamp. After a reset of the board, which restarts the ticks, the time line continues.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD

_ROWS_MAX: Final = 20_000  # ten seconds of the fastest telemetry, more than the largest lag of a twin


class BoardTime:
    """Converts ticks and ROS stamps to the time line.

    Parameters
    ----------
    start_ns : int
        ROS time of the start of the recording [ns].
    """

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns
        self._zero: float | None = None  # time of tick 0 since the last reset [s]
        self._last_tick = 0
        self._stamps = np.empty(0, np.int64)
        self._times = np.empty(0)
        self.first = math.inf  # time of the first telemetry [s]; infinite before
        self.resets = 0  # number of detected resets of the board

    @property
    def newest(self) -> float:
        """Time of the newest telemetry [s]; 0 before the first."""
        return 0.0 if self._zero is None else self._zero + self._last_tick * PERIOD

    def telemetry(self, ticks: NDArray[np.int64], stamps: NDArray[np.int64] | None) -> NDArray[np.float64]:
        """Times of rows of telemetry, which define the time line.

        Parameters
        ----------
        ticks : ndarray
            PWM periods since reset, extended past 32 bits.
        stamps : ndarray, optional
            ROS times of the same rows [ns].

        Returns
        -------
        ndarray
            Times [s].
        """
        times = np.empty(len(ticks))
        # Ticks increase between two resets.
        cuts = [0, *(np.flatnonzero(np.diff(ticks) < 0) + 1), len(ticks)]
        for first, last in pairwise(cuts):
            if first < last:
                part = ticks[first:last]
                if self._zero is None or part[0] < self._last_tick:
                    self._start(int(part[0]), None if stamps is None else int(stamps[first]))
                assert self._zero is not None
                times[first:last] = self._zero + part * PERIOD
                self._last_tick = int(part[-1])
                if stamps is not None:
                    self._store(stamps[first:last], times[first:last])
        return times

    def _start(self, tick: int, stamp: int | None) -> None:
        """Start the time line at the first row, or at the first row after a reset."""
        if self._zero is None:
            first = 0.0 if stamp is None else max((stamp - self._start_ns) * 1e-9, 0.0)
        else:
            first = max(self.newest + PERIOD, -1.0 if stamp is None else self.of_stamp(stamp))
            self.resets += 1
        self.first = min(self.first, first)
        self._zero = first - tick * PERIOD

    def _store(self, stamps: NDArray[np.int64], times: NDArray[np.float64]) -> None:
        self._stamps = np.concatenate([self._stamps, stamps])[-_ROWS_MAX:]
        self._times = np.concatenate([self._times, times])[-_ROWS_MAX:]

    def of_ticks(self, ticks: NDArray[np.int64]) -> NDArray[np.float64]:
        """Times [s] of ticks since the last reset; requires telemetry."""
        assert self._zero is not None
        return self._zero + ticks.astype(np.float64) * PERIOD

    def of_stamps(self, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
        """Times [s] of ROS stamps [ns], interpolated between the stamps of the telemetry."""
        if not len(self._stamps):
            return (stamps - self._start_ns).astype(np.float64) * 1e-9
        base = int(self._stamps[-1])
        offsets = (stamps - base) * 1e-9
        known = (self._stamps - base) * 1e-9
        times: NDArray[np.float64] = np.interp(offsets, known, self._times)
        # Extrapolation with equal rates of both clocks.
        early, late = offsets < known[0], offsets > 0.0
        times[early] = self._times[0] + offsets[early] - known[0]
        times[late] = self._times[-1] + offsets[late]
        return times

    def of_stamp(self, stamp: int) -> float:
        """Time [s] of one ROS stamp [ns]."""
        return float(self.of_stamps(np.array([stamp], np.int64))[0])
