"""A path through waypoints: cubic or quintic pieces, from the state that the joints have."""

from __future__ import annotations

import numpy as np

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.waypoints import Array, Waypoints

START_TOLERANCE = 0.01
"""How far a waypoint at the very start may be from where the joint is [rad]: ``allowed_start_tolerance`` of MoveIt."""


def path_through(
    waypoints: Waypoints,
    start: State | None = None,
    start_time: float = 0.0,
    start_tolerance: float = START_TOLERANCE,
) -> Path:
    """Path through waypoints.

    What both ends of a piece carry decides: positions and velocities make it cubic, accelerations quintic. Velocities
    that are not given are those of the C2 cubic spline through these positions; at the first and last waypoint they
    are 0 then.

    With a start state the path begins there with this position, velocity and acceleration, and the first piece is
    quintic. A waypoint at the start time itself is replaced by the start state. Its position must be near: a motion
    of no duration would be a step.

    Parameters
    ----------
    waypoints : Waypoints
        At least two, or one after the start.
    start : State, optional
        State of shape (joints,) at `start_time`; without it the path begins at the first waypoint.
    start_time : float
        [s]
    start_tolerance : float
        For a waypoint at the start time [rad].

    Raises
    ------
    TrajectoryError
        If a waypoint lies before the start, one at the start is not where the joint is, or a single waypoint leaves
        no time for a motion.
    """
    times, positions, velocities = waypoints.times, waypoints.positions, waypoints.velocities
    accelerations, efforts = waypoints.accelerations, waypoints.efforts
    if start is not None:
        if times[0] < start_time:
            raise TrajectoryError(
                f"point #0 is {start_time - times[0]:g} s before the start of the motion; give it a later time"
            )
        if times[0] == start_time:
            _check_near(waypoints, start, start_tolerance)
            if len(times) == 1:
                return _resting(waypoints, start, start_time)
        after = times > start_time
        times = np.concatenate(([start_time], times[after]))
        positions = np.vstack((start.position, positions[after]))
        velocities = np.vstack((start.velocity, velocities[after]))
        accelerations = np.vstack((start.acceleration, accelerations[after]))
        efforts = np.vstack((start.effort, efforts[after]))
    if len(times) == 1:
        raise TrajectoryError("a single waypoint needs a state to start from; give a second waypoint")
    velocities = _spline_velocities(times, positions, velocities)
    h = np.diff(times)[:, None]
    coefficients = cubic(h, positions[:-1], velocities[:-1], positions[1:], velocities[1:])
    fifth = quintic(
        h, positions[:-1], velocities[:-1], accelerations[:-1], positions[1:], velocities[1:], accelerations[1:]
    )
    if start is not None and np.isnan(accelerations[1]).any():
        # The acceleration with which the next piece begins; a path of one piece ends without.
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
    # What the end lacks when position, velocity and acceleration of the beginning go on.
    p = (p1 - p0 - h * (v0 + 0.5 * h * a0)) / h**3
    v = (v1 - v0 - h * a0) / h**2
    a = (a1 - a0) / h
    fourth, fifth = (-15.0 * p + 7.0 * v - a) / h, (6.0 * p - 3.0 * v + 0.5 * a) / h**2
    terms = (p0, v0, 0.5 * a0, 10.0 * p - 4.0 * v + 0.5 * a, fourth, fifth)
    result: Array = np.stack(terms, axis=-1)
    return result


def _spline_velocities(times: Array, positions: Array, velocities: Array) -> Array:
    """Velocities with those not given (NaN) chosen so that the acceleration is continuous there.

    Row k of the tridiagonal system: the cubics left and right of waypoint k have the same second derivative. Thomas
    algorithm, all joints at once; the matrix is diagonally dominant.
    """
    given: Array = np.array(velocities)
    given[[0, -1]] = np.nan_to_num(given[[0, -1]])
    free = np.isnan(given)
    if not free.any():
        return given
    inverse = 1.0 / np.diff(times)[:, None]
    slope = np.diff(positions, axis=0) * inverse
    upper, right = np.zeros_like(given), np.array(given)
    for k in range(1, len(times) - 1):
        left, here = inverse[k - 1], inverse[k]
        pivot = 2.0 * (left + here) - left * upper[k - 1]
        value = (3.0 * (slope[k - 1] * left + slope[k] * here) - left * right[k - 1]) / pivot
        upper[k] = np.where(free[k], here / pivot, 0.0)
        right[k] = np.where(free[k], value, given[k])
    for k in range(len(times) - 2, 0, -1):
        right[k] -= upper[k] * right[k + 1]
    return right


def _check_near(waypoints: Waypoints, start: State, tolerance: float) -> None:
    for joint, wanted, actual in zip(waypoints.joints, waypoints.positions[0], start.position, strict=True):
        if abs(wanted - actual) > tolerance:
            raise TrajectoryError(
                f"{joint} is at {actual:g} rad and point #0 wants {wanted:g} rad at once; give point #0 a "
                f"time_from_start above 0, or begin within {tolerance:g} rad of the joint"
            )


def _resting(waypoints: Waypoints, start: State, start_time: float) -> Path:
    if start.velocity.any():
        raise TrajectoryError(
            "the joints move and point #0 is the only one, at once; give it a time_from_start above 0"
        )
    return Path.hold(waypoints.joints, start.position, start_time)
