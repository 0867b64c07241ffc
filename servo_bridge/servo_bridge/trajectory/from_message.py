"""A path from a message trajectory_msgs/JointTrajectory, with the rules of joint_trajectory_controller.

As there: positions always; velocities, accelerations and effort for all joints of a point or for none; joints in any
order; what does not fit is refused as a whole. Better than there: a stamp in the
future is waited for, while the running path goes on; a trajectory that has begun is joined without a step; and NaN
and joints named twice are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from servo_bridge.trajectory.blend import joined
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.spline import START_TOLERANCE, path_through
from servo_bridge.trajectory.waypoints import Waypoints, check_joints

_STANDING = float(np.finfo(np.float32).eps)
"""Velocity that joint_trajectory_controller takes for zero at the end [rad/s]."""


def from_message(
    message: Any,
    running: Path,
    now: float,
    origin_ns: int,
    *,
    source: str = "joint_trajectory",
    start_tolerance: float = START_TOLERANCE,
    may_end_moving: bool = False,
) -> Path:
    """Path of the joints of a message, from the state that the running path has.

    Parameters
    ----------
    message : trajectory_msgs/JointTrajectory
        Anything with its fields.
    running : Path
        What all known joints do now; `Path.hold` if they rest. It goes on until the new path begins, and joints that
        the message does not name stay with it.
    now : float
        On the clock of the paths [s]; no stamp, or 0, means now.
    origin_ns : int
        Stamp at which this clock is 0 [ns].
    source : str
        Topic or action, for refusals.
    start_tolerance : float
        How far a point at the start time may be from the joint [rad]; see `path_through`.
    may_end_moving : bool
        Allow a velocity at the last point.

    Returns
    -------
    Path
        Joints of the message, in the order of `running`. It begins now or at the stamp, whichever is later.

    Raises
    ------
    TrajectoryError
        If the trajectory is refused.
    """
    try:
        names = list(message.joint_names)
        _check_known(names, running.joints)
        check_joints(names)
        stamp_ns = _nanoseconds(message.header.stamp)
        begin = (stamp_ns - origin_ns) * 1.0e-9 if stamp_ns else now
        path = _path(_waypoints(message, names, begin), running, begin, now, start_tolerance, may_end_moving)
        return path.select([joint for joint in running.joints if joint in names])
    except TrajectoryError as error:
        raise TrajectoryError(f"{source}: {error}", error.code) from None


def _path(
    waypoints: Waypoints, running: Path, begin: float, now: float, start_tolerance: float, may_end_moving: bool
) -> Path:
    if not may_end_moving:
        for joint, velocity in zip(waypoints.joints, waypoints.velocities[-1], strict=True):
            if abs(velocity) > _STANDING:
                raise TrajectoryError(
                    f"velocity of {joint} at the last point, #{len(waypoints.times) - 1}, is {velocity:g} rad/s; give "
                    "0, or add a point with velocity 0"
                )
    old = running.select(waypoints.joints)
    start = max(begin, now)
    if waypoints.times[-1] <= now and begin < now:
        raise TrajectoryError(
            f"the trajectory ended {now - waypoints.times[-1]:g} s ago; send it earlier, or with stamp 0 for now",
            ErrorCode.OLD_HEADER_TIMESTAMP,
        )
    if waypoints.times[0] <= now and begin < now:
        return joined(old.state(now), now, path_through(waypoints))
    return path_through(waypoints, old.state(start), start, start_tolerance)


def _waypoints(message: Any, names: list[str], begin: float) -> Waypoints:
    points = list(message.points)
    for k, point in enumerate(points):
        if _nanoseconds(point.time_from_start) < 0:
            raise TrajectoryError(f"time_from_start of point #{k} is negative; give 0 or more")
    times = [begin + _nanoseconds(point.time_from_start) * 1.0e-9 for point in points]
    rows = ([list(getattr(p, field)) or None for p in points] for field in _FIELDS)
    return Waypoints.of(names, times, *rows)


_FIELDS = ("positions", "velocities", "accelerations", "effort")


def _check_known(names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise TrajectoryError(
                f"joint {name!r} does not exist; the joints are {', '.join(known)}", ErrorCode.INVALID_JOINTS
            )


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)
