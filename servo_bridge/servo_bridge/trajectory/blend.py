"""Transition between paths without a step of position, velocity or acceleration."""

from __future__ import annotations

import numpy as np
from servo_msgs_py.units import PERIOD

from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import DEGREE, Path, State
from servo_bridge.trajectory.spline import cubic, quintic
from servo_bridge.trajectory.timed_points import TimedPoints

BLEND_TIME = 0.1
"""Shortest transition to a path that has begun, if the path is long enough [s]."""


def joined(start: State, start_time: float, path: Path) -> Path:
    """Return the path from a state to a path that has begun before.

    A quintic piece ends at the first breakpoint that is at least `BLEND_TIME` later (or at the last one) with the state
    of the path there.

    Parameters
    ----------
    start : State
        State of shape (joints,) at `start_time`.
    start_time : float
        Before the end of the path [s].
    path : Path
        Path to join.

    Raises
    ------
    TrajectoryError
        If the path has ended at that time.
    """
    if path.end_time <= start_time:
        raise TrajectoryError(
            f"the trajectory ended {start_time - path.end_time:g} s ago; send it earlier, or with a later start",
            ErrorCode.OLD_HEADER_TIMESTAMP,
        )
    last = len(path.times) - 1
    meet = min(int(np.searchsorted(path.times, start_time + BLEND_TIME)), last)
    h = np.array(path.times[meet] - start_time)
    there = path.state(path.times[meet])
    begin = (start.position, start.velocity, start.acceleration)
    first = quintic(h, *begin, there.position, there.velocity, there.acceleration)
    return Path(
        path.joints,
        np.concatenate(([start_time], path.times[meet:])),
        np.concatenate((first[None], path.coefficients[meet:])),
        path.end,
        np.vstack((start.effort, path.efforts[meet:])),
    )


def spliced(old: Path, new: Path, since: float) -> Path:
    """Return the path along `old` from a time, and along `new` from the start of `new`.

    If `old` ends before `new` begins, the result holds in between.

    Parameters
    ----------
    old, new : Path
        Paths of the same joints; `new` begins with the state of `old` at its start.
    since : float
        Begin of the result [s]; breakpoints of `old` before it are removed except the last.
    """
    if since >= new.start_time:
        return new
    times, coefficients, efforts = old.times, old.coefficients, old.efforts
    if old.end_time < new.start_time:
        hold = np.zeros((1, len(old.joints), DEGREE + 1))
        hold[0, :, 0] = old.end
        times = np.append(times, new.start_time)
        coefficients, efforts = np.concatenate((coefficients, hold)), np.concatenate((efforts, efforts[-1:]))
    first = max(int(np.searchsorted(times, since, side="right")) - 1, 0)
    cut = int(np.searchsorted(times, new.start_time))
    if cut <= first:
        return new
    return Path(
        old.joints,
        np.concatenate((times[first:cut], new.times)),
        np.concatenate((coefficients[first:cut], new.coefficients)),
        new.end,
        np.concatenate((efforts[first:cut], new.efforts)),
    )


def extended(old: Path, points: TimedPoints, since: float) -> Path:
    """Return the path of one joint, extended along timed points as interpolated by the board.

    Parameters
    ----------
    old : Path
        Path of one joint.
    points : TimedPoints
        At least two; one is enough if it is after the end of `old`, which is then the first point.
    since : float
        Breakpoints of `old` before this time are removed except the last [s].
    """
    times = points.periods * PERIOD
    columns = np.stack((points.positions, points.velocities, points.efforts))
    if times[0] > old.end_time:
        last = old.continued(old.end_time)
        times = np.concatenate(([old.end_time], times))
        columns = np.column_stack(([last.position[0], last.velocity[0], last.effort[0]], columns))
    p, v, effort = columns
    pieces = cubic(np.diff(times), p[:-1], v[:-1], p[1:], v[1:])
    return spliced(old, Path(old.joints, times, pieces[:, None], p[-1:], effort[:, None]), since)
