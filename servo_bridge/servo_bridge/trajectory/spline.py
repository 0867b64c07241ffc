"""Path through waypoints: cubic or quintic pieces, starting from the state of the joints."""

from __future__ import annotations

import numpy as np

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.waypoints import Array, Waypoints, check_duration

START_TOLERANCE = 0.01
"""Largest distance between a waypoint at the start time and the joint [rad]: ``allowed_start_tolerance`` of MoveIt."""

_COUPLING_MIN = 1.0e-18
"""Coupling of two waypoints below which they are independent, relative to the diagonal."""


def path_through(
    waypoints: Waypoints,
    start: State | None = None,
    start_time: float = 0.0,
    start_tolerance: float = START_TOLERANCE,
) -> Path:
    """Return the path through waypoints.

    Pieces are cubic if positions and velocities are given at both ends, quintic with accelerations. Missing velocities
    are those of the C2 cubic spline through the positions, 0 at the first and last waypoint.

    A start state gives position, velocity and acceleration of the begin; the first piece is then quintic. It replaces a
    waypoint at the start time, whose position must be close to it, because the distance would be a step.

    Parameters
    ----------
    waypoints : Waypoints
        At least two, or one with a start state.
    start : State, optional
        State of shape (joints,) at `start_time`; default: the path begins at the first waypoint.
    start_time : float
        Begin of the path with a start state [s].
    start_tolerance : float
        Largest distance of a waypoint at the start time [rad].

    Raises
    ------
    TrajectoryError
        If a waypoint is before the start, one at the start is too far from the joint, the path is too long, or a single
        waypoint leaves no time for a motion.
    """
    times, positions, velocities = waypoints.times, waypoints.positions, waypoints.velocities
    accelerations, efforts = waypoints.accelerations, waypoints.efforts
    if start is not None:
        if times[0] < start_time:
            raise TrajectoryError(
                f"point #0 is {start_time - times[0]:g} s before the start of the motion; use a later time"
            )
        if times[0] == start_time:
            _check_near(waypoints, start, start_tolerance)
            if len(times) == 1:
                return _resting(waypoints, start, start_time)
        after = times > start_time
        times = np.concatenate(([start_time], times[after]))
        check_duration(times)
        positions = np.vstack((start.position, positions[after]))
        velocities = np.vstack((start.velocity, velocities[after]))
        accelerations = np.vstack((start.acceleration, accelerations[after]))
        efforts = np.vstack((start.effort, efforts[after]))
    if len(times) == 1:
        raise TrajectoryError("a single waypoint needs a start state; add a second waypoint")
    velocities = _spline_velocities(times, positions, velocities)
    h = np.diff(times)[:, None]
    coefficients = cubic(h, positions[:-1], velocities[:-1], positions[1:], velocities[1:])
    fifth = quintic(
        h, positions[:-1], velocities[:-1], accelerations[:-1], positions[1:], velocities[1:], accelerations[1:]
    )
    if start is not None and np.isnan(accelerations[1]).any():
        # The acceleration at the begin of the next piece; 0 at the end of a path of one piece.
        end = 2.0 * coefficients[1, :, 2] if len(times) > 2 else np.zeros_like(start.position)
        fifth[0] = quintic(h[0], positions[0], velocities[0], start.acceleration, positions[1], velocities[1], end)
    coefficients = np.where(np.isnan(fifth).any(axis=(1, 2), keepdims=True), coefficients, fifth)
    return Path(waypoints.joints, times, coefficients, positions[-1], efforts)


def cubic(h: Array, p0: Array, v0: Array, p1: Array, v1: Array) -> Array:
    """Coefficients of cubic Hermite pieces of length `h` [s], constant term first, padded to `DEGREE` of a path."""
    d = (p1 - p0) / h
    zero = np.zeros_like(p0)
    terms = (p0, v0, (3.0 * d - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * d) / h**2, zero, zero)
    result: Array = np.stack(terms, axis=-1)
    return result


def quintic(h: Array, p0: Array, v0: Array, a0: Array, p1: Array, v1: Array, a1: Array) -> Array:
    """Coefficients of quintic Hermite pieces of length `h` [s], shape (..., 6), constant term first."""
    # Differences at the end if position, velocity and acceleration of the begin were continued.
    p = (p1 - p0 - h * (v0 + 0.5 * h * a0)) / h**3
    v = (v1 - v0 - h * a0) / h**2
    a = (a1 - a0) / h
    fourth, fifth = (-15.0 * p + 7.0 * v - a) / h, (6.0 * p - 3.0 * v + 0.5 * a) / h**2
    terms = (p0, v0, 0.5 * a0, 10.0 * p - 4.0 * v + 0.5 * a, fourth, fifth)
    result: Array = np.stack(terms, axis=-1)
    return result


def _spline_velocities(times: Array, positions: Array, velocities: Array) -> Array:
    """Velocities whose missing values (NaN) make the acceleration continuous.

    Row k of the tridiagonal system: the cubics left and right of waypoint k have the same second derivative. Rows of
    given velocities are the identity.
    """
    given: Array = np.array(velocities)
    given[[0, -1]] = np.nan_to_num(given[[0, -1]])
    free = np.isnan(given)
    if not free.any():
        return given
    inverse = 1.0 / np.diff(times)[:, None]
    slope = np.diff(positions, axis=0) * inverse
    left, right = np.zeros_like(given), np.zeros_like(given)
    left[1:-1], right[1:-1] = np.where(free[1:-1], inverse[:-1], 0.0), np.where(free[1:-1], inverse[1:], 0.0)
    diagonal = np.where(free, 2.0 * (left + right), 1.0)
    value = given.copy()
    value[1:-1] = np.where(free[1:-1], 3.0 * (slope[:-1] * inverse[:-1] + slope[1:] * inverse[1:]), given[1:-1])
    return _solved(left / diagonal, right / diagonal, value / diagonal)


def _solved(left: Array, right: Array, value: Array) -> Array:
    """Solution x of ``left[k] x[k - 1] + x[k] + right[k] x[k + 1] = value[k]`` for every column.

    Cyclic reduction in parallel: every step eliminates the neighbours at a distance, which doubles. The couplings of a
    diagonally dominant system decrease quadratically, so that few steps are needed for any number of rows.
    """
    distance = 1
    while distance < len(value) and max(np.abs(left).max(), np.abs(right).max()) > _COUPLING_MIN:
        before, after = _moved((left, right, value), distance), _moved((left, right, value), -distance)
        scale = 1.0 / (1.0 - left * before[1] - right * after[0])
        value = scale * (value - left * before[2] - right * after[2])
        left, right = -scale * left * before[0], -scale * right * after[1]
        distance *= 2
    return value


def _moved(columns: tuple[Array, ...], by: int) -> list[Array]:
    """Columns moved by a number of rows, with zeros in the free ones."""
    result = [np.zeros_like(column) for column in columns]
    for moved, column in zip(result, columns, strict=True):
        if by > 0:
            moved[by:] = column[:-by]
        else:
            moved[:by] = column[-by:]
    return result


def _check_near(waypoints: Waypoints, start: State, tolerance: float) -> None:
    for joint, target, actual in zip(waypoints.joints, waypoints.positions[0], start.position, strict=True):
        if abs(target - actual) > tolerance:
            raise TrajectoryError(
                f"{joint} is at {actual:g} rad, but point #0 at the start time is at {target:g} rad; use a "
                f"time_from_start above 0, or a position within {tolerance:g} rad of the joint"
            )


def _resting(waypoints: Waypoints, start: State, start_time: float) -> Path:
    if start.velocity.any():
        raise TrajectoryError("the joints move, and the only point is at the start time; use a time_from_start above 0")
    return Path.hold(waypoints.joints, start.position, start_time)
