"""Fewer timed points for the same path: neighbouring segments become one where its interpolation is close enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD

from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.spline import cubic
from servo_bridge.trajectory.timed_points import TOLERANCE, TimedPoints
from servo_bridge.trajectory.waypoints import Array

MERGED_MAX: Final = 16_000
"""Longest merged segment, 1 s [PWM periods]: it bounds the motion that waits in the queue of the board."""

_ACCELERATION_SHARE: Final = 0.04
"""Largest deviation of the acceleration from the path, over its peak."""

_EFFORT_SHARE: Final = 0.01
"""Largest deviation of the effort from the path, over its peak."""

_ROUNDING: Final = 1.0e-9
"""Tolerance of a peak for rounding, relative."""

_PLACES: Final = np.array([0.001, 1.0 / 3.0, 2.0 / 3.0, 0.999])
"""Compared places in every segment, relative to its length."""


def thinned(path: Path, points: Mapping[str, TimedPoints], gear_ratios: Mapping[str, float]) -> dict[str, TimedPoints]:
    """Return the points without those that the interpolation of the board does not need.

    With the remaining ones the position deviates from the path by at most `TOLERANCE` at the motor, the acceleration by
    at most 4 % of its peak; speed and acceleration do not exceed the peaks of the path.

    Parameters
    ----------
    path : Path
        The path.
    points : mapping of str to TimedPoints
        Points of its joints, by name.
    gear_ratios : mapping of str to float
        Turns of the motor per turn of the joint, by name.
    """
    return {
        joint: _Thinning(path, path.joints.index(joint), each, TOLERANCE / gear_ratios[joint]).result()
        for joint, each in points.items()
    }


class _Thinning:
    """Points of one joint, and the path at places between them."""

    def __init__(self, path: Path, axis: int, points: TimedPoints, tolerance: float) -> None:
        self._points, self._tolerance = points, tolerance
        begin, length = points.periods[:-1, None] * PERIOD, np.diff(points.periods)[:, None] * PERIOD
        self._times = begin + length * _PLACES
        state = path.continued(self._times)
        self._position, self._velocity, self._acceleration, self._effort = (
            x[..., axis] for x in (state.position, state.velocity, state.acceleration, state.effort)
        )
        self._speed_peak, self._acceleration_peak, self._effort_peak = (
            float(np.abs(x).max(initial=0.0)) for x in (self._velocity, self._acceleration, self._effort)
        )

    def result(self) -> TimedPoints:
        """Points that remain after all possible mergers of two neighbouring segments."""
        kept = np.arange(len(self._points.periods))
        merged = True
        while merged:
            merged = False
            for first in (0, 1):
                starts, ends = kept[first:-2:2], kept[first + 2 :: 2]
                if len(starts):
                    needless = kept[first + 1 : -1 : 2][self._fit(starts, ends)]
                    kept = kept[~np.isin(kept, needless)]
                    merged |= len(needless) > 0
        p = self._points
        return TimedPoints(p.periods[kept], p.positions[kept], p.velocities[kept], p.efforts[kept])

    def _fit(self, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether one segment can replace those from point `starts` to point `ends`; consecutive ranges."""
        p = self._points
        knots: Array = np.multiply(p.periods, PERIOD, dtype=np.float64)
        begin, length = knots[starts], knots[ends] - knots[starts]
        c = cubic(length, p.positions[starts], p.velocities[starts], p.positions[ends], p.velocities[ends])
        group = np.repeat(np.arange(len(starts)), ends - starts)
        rows = slice(int(starts[0]), int(ends[-1]))
        s = self._times[rows] - begin[group, None]
        c0, c1, c2, c3 = (c[group, k, None] for k in range(4))
        position = ((c3 * s + c2) * s + c1) * s + c0
        velocity = (3.0 * c3 * s + 2.0 * c2) * s + c1
        acceleration = 6.0 * c3 * s + 2.0 * c2
        slope = (p.efforts[ends] - p.efforts[starts]) / length
        effort = p.efforts[starts][group, None] + slope[group, None] * s
        good = (
            (np.abs(position - self._position[rows]) <= self._tolerance)
            & (np.abs(acceleration - self._acceleration[rows]) <= _ACCELERATION_SHARE * self._acceleration_peak)
            & (np.abs(effort - self._effort[rows]) <= _EFFORT_SHARE * self._effort_peak + _ROUNDING)
            & _below(velocity, self._speed_peak)
            & _below(acceleration, self._acceleration_peak)
        ).all(axis=1)
        ends_of = 2.0 * np.abs(np.stack((c[:, 2], c[:, 2] + 3.0 * c[:, 3] * length)))
        fit: NDArray[np.bool_] = np.logical_and.reduceat(good, starts - starts[0])
        return fit & _below(ends_of.max(axis=0), self._acceleration_peak) & (length <= MERGED_MAX * PERIOD)


def _below(values: Array, peak: float) -> NDArray[np.bool_]:
    """Whether magnitudes do not exceed a peak, except by rounding."""
    result: NDArray[np.bool_] = np.abs(values) <= peak * (1.0 + _ROUNDING) + _ROUNDING
    return result
