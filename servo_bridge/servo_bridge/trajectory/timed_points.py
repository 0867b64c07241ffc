"""Timed points for the board, whose cubic Hermite interpolation approximates a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.spline import cubic
from servo_bridge.trajectory.waypoints import Array

SEGMENT_PERIODS_MIN = 16
"""Shortest distance of two points, 1 ms [PWM periods]."""

SEGMENT_PERIODS_MAX = 960_000
"""Longest distance of two points, 60 s [PWM periods]."""

TOLERANCE = 0.2 * 2.0 * math.pi / COUNTS_PER_TURN
"""Largest deviation of the interpolation from the path: 0.2 counts of the motor [rad]."""

_KINK_SHARE = 0.1
"""Fraction of the tolerance for the rounding of a breakpoint at each end of a segment."""

_ACCELERATION_SHARE = 0.04
"""Largest deviation of the acceleration from the path, over its peak: the board limits the acceleration."""

_REST = 1.0e-6
"""Speed of the motor at the end below which a path counts as ending at rest [rad/s]."""

_SAMPLES = 16
"""Times per segment at which a segment across a breakpoint is compared with the path."""


@dataclass(frozen=True, eq=False)
class TimedPoints:
    """Points of one joint."""

    periods: NDArray[np.int64]  # (n,), PWM periods since time 0 of the path
    positions: Array  # (n,) [rad]
    velocities: Array  # (n,) [rad/s]
    efforts: Array  # (n,), torque added to that of the controller [N m]

    def interpolated(self, t: Array) -> Array:
        """Position as interpolated by the board [rad], at times [s] within the points."""
        k = np.clip(np.searchsorted(self.periods * PERIOD, t, side="right") - 1, 0, len(self.periods) - 2)
        h = np.diff(self.periods)[k] * PERIOD
        p, v = self.positions, self.velocities
        c = cubic(h, p[k], v[k], p[k + 1], v[k + 1])
        s = np.asarray(t) - self.periods[k] * PERIOD
        result: Array = ((c[..., 3] * s + c[..., 2]) * s + c[..., 1]) * s + c[..., 0]
        return result


def concatenated(parts: Sequence[TimedPoints]) -> TimedPoints:
    """Concatenate consecutive points of one joint."""
    columns = zip(*((part.periods, part.positions, part.velocities, part.efforts) for part in parts), strict=True)
    return TimedPoints(*map(np.concatenate, columns))


def timed_points(
    path: Path, tolerance: float = TOLERANCE, gear_ratios: Sequence[float] | None = None
) -> dict[str, TimedPoints]:
    """Return the points of every joint whose interpolation approximates the path.

    A cubic piece needs its ends only. Other pieces are divided evenly: the error of a cubic Hermite piece of length h
    is at most max|f''''| h^4 / 384 for an interpolated function f (C. de Boor, A Practical Guide to Splines, ch. IV),
    the error of its acceleration at most max|f''''| h^2 / 12. Each time is rounded to a PWM period separately, so that
    errors do not add up; position and velocity are those of the path at the rounded time. The last point of a path that
    ends at rest is exactly its end. Breakpoints less than 1 ms after another one are omitted, except the end.

    Parameters
    ----------
    path : Path
        Path of at least 1 ms.
    tolerance : float
        Tolerance at the motor [rad].
    gear_ratios : sequence of float, optional
        Turns of the motor per turn of each joint of the path; 1 by default.

    Returns
    -------
    dict of TimedPoints
        By joint. Points of different joints are independent: a holding joint has only two.

    Raises
    ------
    TrajectoryError
        If the path is too short, or changes too fast within 1 ms for the tolerance.
    """
    ratios = [1.0] * len(path.joints) if gear_ratios is None else gear_ratios
    return {
        joint: _points_of(path, axis, tolerance / ratio, _REST / ratio)
        for axis, (joint, ratio) in enumerate(zip(path.joints, ratios, strict=True))
    }


def _points_of(path: Path, axis: int, tolerance: float, rest: float) -> TimedPoints:
    knots = _knots(path, axis, _KINK_SHARE * tolerance, rest)
    fourth = _fourth_derivative_max(path, axis)
    peak = _acceleration_max(path, axis)
    begin, length = knots[:-1], np.diff(knots)
    # Pieces of the path that overlap the segment by more than rounding.
    first = np.maximum(np.searchsorted(path.times, (begin + 0.5) * PERIOD) - 1, 0)
    last = np.searchsorted(path.times, (knots[1:] - 0.5) * PERIOD)
    size = _largest(fourth, first, last)
    bound = 384.0 * (1.0 - 2.0 * _KINK_SHARE) * tolerance
    parts = np.ceil(length * PERIOD * (size / bound) ** 0.25)
    if peak > 0.0:
        parts = np.maximum(parts, np.ceil(length * PERIOD * np.sqrt(size / (12.0 * _ACCELERATION_SHARE * peak))))
    parts = np.minimum(parts, length // SEGMENT_PERIODS_MIN).astype(np.int64)
    parts = np.maximum(parts, np.maximum(-(-length // SEGMENT_PERIODS_MAX), 1))
    ends = np.cumsum(parts)
    number = np.arange(1, ends[-1] + 1) - np.repeat(ends - parts, parts)  # of the part in its segment
    inner = np.repeat(begin, parts) + number * np.repeat(length, parts) // np.repeat(parts, parts)
    periods = np.concatenate((knots[:1], inner))
    points = _sampled(path, axis, periods, rest)
    _check_deviation(path, axis, points, tolerance)
    return points


def _sampled(path: Path, axis: int, periods: NDArray[np.int64], rest: float) -> TimedPoints:
    """Points of a path at PWM periods."""
    state = path.continued(periods * PERIOD)
    positions, velocities, efforts = (x[:, axis].copy() for x in (state.position, state.velocity, state.effort))
    if _ends_at_rest(path, axis, rest):
        positions[-1], velocities[-1] = path.end[axis], 0.0
    return TimedPoints(periods, positions, velocities, efforts)


def _largest(values: Array, first: NDArray[np.int64], last: NDArray[np.int64]) -> Array:
    """Largest of the values from `first` to before `last`, for each pair; 0 for an empty range."""
    pairs = np.column_stack((first, np.maximum(last, first))).reshape(-1)
    result: Array = np.maximum.reduceat(np.append(values, 0.0), pairs)[::2]
    return np.where(last > first, result, 0.0)


def _ends_at_rest(path: Path, axis: int, rest: float) -> bool:
    return bool(abs(path.state(path.end_time).velocity[axis]) < rest)


def _knots(path: Path, axis: int, kink: float, rest: float) -> NDArray[np.int64]:
    """Breakpoints in PWM periods, at least one segment apart, with additional points 1 ms from sharp ones.

    A breakpoint that is rounded into one piece has the velocity of that piece. If the acceleration steps there, the
    other piece has a velocity error of step times rounding, and a cubic Hermite piece of length h deviates by 4/27 h
    times this error. A short adjacent segment keeps the deviation small.
    """
    periods = np.rint(path.times / PERIOD).astype(np.int64)
    if periods[-1] - periods[0] < SEGMENT_PERIODS_MIN:
        raise TrajectoryError(f"the path of {path.joints[axis]} is shorter than 1 ms; give the motion more time")
    kept = _apart(periods)
    error = _velocity_errors(path, axis, periods, rest)[kept]
    knots = periods[kept]
    begin, end = knots[:-1], knots[1:]
    threshold = kink / (4.0 / 27.0 * (end - begin) * PERIOD)
    after = (error[:-1] < -threshold) & (begin + 2 * SEGMENT_PERIODS_MIN <= end)
    before = (error[1:] > threshold) & (begin + (2 + after) * SEGMENT_PERIODS_MIN <= end)
    rows = np.column_stack((begin + SEGMENT_PERIODS_MIN, end - SEGMENT_PERIODS_MIN, end))
    added = np.column_stack((after, before, np.ones_like(after)))
    result: NDArray[np.int64] = np.concatenate((knots[:1], rows[added]))
    return result


def _apart(periods: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of the first and the last period, and of those between that are a segment apart from the others."""
    if np.diff(periods).min() >= SEGMENT_PERIODS_MIN:
        return np.arange(len(periods))
    ticks = periods.tolist()
    kept = [0]
    for k in range(1, len(ticks) - 1):
        if min(ticks[k] - ticks[kept[-1]], ticks[-1] - ticks[k]) >= SEGMENT_PERIODS_MIN:
            kept.append(k)
    return np.array([*kept, len(ticks) - 1])


def _velocity_errors(path: Path, axis: int, periods: NDArray[np.int64], rest: float) -> Array:
    """Velocity error by rounding at each breakpoint [rad/s]; negative if it is in the following piece."""
    h = np.diff(path.times)[:, None]
    c = path.coefficients[:, axis] * np.array([0, 0, 2, 6, 12, 20])
    powers = h ** np.array([0, 0, 0, 1, 2, 3])
    begin, end = c[:, 2], (c * powers).sum(axis=1)
    step = np.zeros(len(path.times))
    step[1:-1] = np.abs(begin[1:] - end[:-1])
    error = step * (periods * PERIOD - path.times)
    if _ends_at_rest(path, axis, rest):
        # The last point is at rest in spite of its rounding.
        error[-1] = abs(end[-1] * (periods[-1] * PERIOD - path.times[-1]))
    result: Array = error
    return result


def _fourth_derivative_max(path: Path, axis: int) -> Array:
    """Largest magnitude of the fourth derivative, which is linear in each piece [rad/s^4]."""
    fourth, fifth = path.coefficients[:, axis, 4], path.coefficients[:, axis, 5]
    ends = np.abs([24.0 * fourth, 24.0 * fourth + 120.0 * fifth * np.diff(path.times)])
    result: Array = ends.max(axis=0)
    return result


def _acceleration_max(path: Path, axis: int) -> float:
    """Largest magnitude of the acceleration at breakpoints and between them [rad/s^2]."""
    t = path.times[:-1, None] + np.diff(path.times)[:, None] * (np.arange(5) / 4.0)
    return float(np.abs(path.continued(t).acceleration[..., axis]).max())


def _check_deviation(path: Path, axis: int, points: TimedPoints, tolerance: float) -> None:
    """Check segments that the error bound does not cover: with inner breakpoints, or of the smallest length."""
    ends = points.periods * PERIOD
    inside = np.diff(np.searchsorted(path.times, ends + 0.5 * PERIOD)) > 1
    short = np.diff(points.periods) < 2 * SEGMENT_PERIODS_MIN
    begin, length = ends[:-1][inside | short], np.diff(ends)[inside | short]
    t = begin[:, None] + length[:, None] * (np.arange(1, _SAMPLES) / _SAMPLES)
    if not t.size:
        return
    deviation = np.abs(points.interpolated(t) - path.continued(t).position[..., axis])
    if deviation.max() > tolerance:
        worst = t.flat[int(np.argmax(deviation))] - path.start_time
        raise TrajectoryError(
            f"{path.joints[axis]} changes too sharply at {worst:.6g} s: points of the board are 1 ms apart, and the "
            f"deviation between them would be {deviation.max():g} rad; use more time for the motion"
        )
