"""Path from a message trajectory_msgs/JointTrajectory, with the rules of joint_trajectory_controller.

Same rules: positions are required; velocities, accelerations and effort for all joints of a point or none; joints in
any order; invalid messages are refused as a whole. Differences: the present path continues until a stamp in the future;
a trajectory that has begun is joined without a step; NaN and repeated joints are refused. For joints that wrap the same
rule as there: the whole trajectory is moved by turns, so that its begin is closest to the joint.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from servo_bridge.trajectory.blend import joined
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.message import TrajectoryMessage
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.spline import START_TOLERANCE, path_through
from servo_bridge.trajectory.waypoints import Waypoints, check_joints

_STANDING = float(np.finfo(np.float32).eps)
"""Velocity that joint_trajectory_controller accepts as zero at the end [rad/s]."""


def from_message(
    message: TrajectoryMessage,
    running: Path,
    now: float,
    origin_ns: int,
    *,
    source: str = "joint_trajectory",
    start_tolerance: float = START_TOLERANCE,
    may_end_moving: bool = False,
    wrapping: Collection[str] = (),
) -> Path:
    """Return the path of the joints of a message, starting with the state of the present path.

    Parameters
    ----------
    message : TrajectoryMessage
        Its points are read here.
    running : Path
        Present path of all joints (`Path.hold` at rest). It continues until the new path begins; joints that are not in
        the message keep it.
    now : float
        Present time of the paths [s]; used if there is no stamp, or 0.
    origin_ns : int
        Stamp at time 0 of the paths [ns].
    source : str
        Topic or action, for refusals.
    start_tolerance : float
        Largest distance between a point at the start time and the joint [rad]; see `path_through`.
    may_end_moving : bool
        Permit a velocity at the last point.
    wrapping : collection of str
        Joints whose positions are angles; `running` counts their turns.

    Returns
    -------
    Path
        Joints of the message, in the order of `running`. It begins at the later of now and the stamp.

    Raises
    ------
    TrajectoryError
        If the trajectory is refused.
    """
    try:
        names = list(message.joint_names)
        _check_known(names, running.joints)
        check_joints(names)
        begin = (message.stamp_ns - origin_ns) * 1.0e-9 if message.stamp_ns else now
        waypoints = _waypoints(message, names, begin)
        path = _path(waypoints, running, begin, now, start_tolerance, may_end_moving, wrapping)
        return path.select([joint for joint in running.joints if joint in names])
    except TrajectoryError as error:
        raise TrajectoryError(f"{source}: {error}", error.code) from None


def _path(
    waypoints: Waypoints,
    running: Path,
    begin: float,
    now: float,
    start_tolerance: float,
    may_end_moving: bool,
    wrapping: Collection[str],
) -> Path:
    if not may_end_moving:
        for joint, velocity in zip(waypoints.joints, waypoints.velocities[-1], strict=True):
            if abs(velocity) > _STANDING:
                raise TrajectoryError(
                    f"velocity of {joint} at the last point, #{len(waypoints.times) - 1}, is {velocity:g} rad/s; write "
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
        state = old.state(now)
        waypoints = waypoints.unwrapped(path_through(waypoints).state(now).position, state.position, wrapping)
        return joined(state, now, path_through(waypoints))
    state = old.state(start)
    waypoints = waypoints.unwrapped(waypoints.positions[0], state.position, wrapping)
    return path_through(waypoints, state, start, start_tolerance)


def _waypoints(message: TrajectoryMessage, names: list[str], begin: float) -> Waypoints:
    points = message.points()
    since_start = np.array(points.times_ns, dtype=np.int64)
    if (since_start < 0).any():
        k = int(np.argmax(since_start < 0))
        raise TrajectoryError(f"time_from_start of point #{k} is negative; write 0 or more")
    return Waypoints.of(names, begin + since_start * 1.0e-9, *points.rows)


def _check_known(names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise TrajectoryError(
                f"joint {name!r} does not exist; the joints are {', '.join(known)}", ErrorCode.INVALID_JOINTS
            )
