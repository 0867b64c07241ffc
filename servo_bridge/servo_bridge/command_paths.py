"""Path commands of ``servo-command``: ``move``, ``follow`` and ``sine``; planning and execution."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np
from builtin_interfaces.msg import Duration
from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.robot_description import Motor
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from servo_bridge.trajectory.check import Limits, require
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.shapes import move, sine
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.waypoints import Waypoints
from servo_bridge.trajectory_limits import path_limits

_SAMPLES: Final = 4000  # of a path, to find its largest speed and acceleration


class PathUser(Protocol):
    """Interface of a client of the servo that follows paths."""

    def positions(self) -> dict[str, float]:
        """Positions of the joints [rad], by name."""

    def joints(self) -> list[Joint]:
        """Joints in the order of the axes."""

    def motors(self) -> list[Motor]:
        """Motors in the order of the axes; empty if their data are not known."""

    def parameters(self) -> RawParameters:
        """Raw parameters of the board."""


def path_message(path: Path) -> JointTrajectory:
    """Convert a path to a message, without its first point, where the joints are already."""
    times = path.times[1:]
    state = path.state(times)
    points = []
    for k, since in enumerate(times - path.start_time):
        whole, part = divmod(round(since * 1e9), 1_000_000_000)
        points.append(
            JointTrajectoryPoint(
                positions=state.position[k].tolist(),
                velocities=state.velocity[k].tolist(),
                accelerations=state.acceleration[k].tolist(),
                time_from_start=Duration(sec=whole, nanosec=part),
            )
        )
    return JointTrajectory(joint_names=list(path.joints), points=points)


def run_path(user: PathUser, args: argparse.Namespace, follow: Callable[[JointTrajectory, float], str]) -> str:
    """Plan and follow a path; returns the text to print.

    Parameters
    ----------
    user : PathUser
        Client of the servo.
    args : argparse.Namespace
        Arguments of one of the path commands.
    follow : callable
        Follows a trajectory of a duration [s] to its end; returns the text to print.

    Raises
    ------
    TrajectoryError
        If the path is invalid or exceeds the limits; nothing has moved then.
    """
    positions = user.positions()
    joints, motors, raw = user.joints(), user.motors(), user.parameters()
    names = joint_names(joints)
    limits = dict(zip(names, path_limits(Catalogue.load(), raw, joints, motors), strict=True))
    path = _plan(args, positions, limits, {joint.name: joint for joint in joints})
    require(path, [limits[joint] for joint in path.joints])
    report = _report(path, limits, _currents(joints, motors, raw))
    if args.dry_run:
        return report
    print(report, flush=True)
    return follow(path_message(path), path.duration)


def _currents(joints: Sequence[Joint], motors: Sequence[Motor], raw: RawParameters) -> dict[str, tuple[float, float]]:
    """Current per torque of every joint [A/(N m)], 0 if not known, and the current limit [A]."""
    lsb = Catalogue.load()["param.i_q_limit"].lsb
    return {
        joint.name: (1.0 / (motors[axis].torque_constant * joint.gear_ratio) if motors else 0.0, limit * lsb)
        for axis, (joint, limit) in enumerate(zip(joints, raw["param.i_q_limit"], strict=True))
    }


def _plan(
    args: argparse.Namespace, positions: dict[str, float], limits: dict[str, Limits], joints: dict[str, Joint]
) -> Path:
    if args.verb == "move":
        targets = dict(args.targets)
        _check_joints(targets, positions)
        start = [positions[joint] for joint in targets]
        goal = [joints[joint].nearest(targets[joint], positions[joint]) for joint in targets]
        return move(list(targets), start, goal, args.time, [limits[joint] for joint in targets])
    if args.verb == "sine":
        _check_joints([args.joint], positions)
        return sine(args.joint, positions[args.joint], args.amplitude, args.frequency, args.duration)
    waypoints: Waypoints = args.waypoints
    _check_joints(waypoints.joints, positions)
    state = State.at_rest([positions[joint] for joint in waypoints.joints])
    wrapping = [joint for joint in waypoints.joints if joints[joint].wraps]
    return path_through(waypoints.unwrapped(waypoints.positions[0], state.position, wrapping), state)


def _check_joints(names: Sequence[str] | dict[str, float], positions: dict[str, float]) -> None:
    unknown = [name for name in names if name not in positions]
    if unknown:
        raise TrajectoryError(f"joint {unknown[0]!r} does not exist; the joints are {', '.join(positions)}")


def _report(path: Path, limits: dict[str, Limits], currents: dict[str, tuple[float, float]]) -> str:
    """Speed, acceleration and current of a path, with limits; the current is for the acceleration only."""
    state = path.state(np.linspace(path.start_time, path.end_time, _SAMPLES))
    lines = [f"{path.duration:g} s"]
    for k, joint in enumerate(path.joints):
        speed, acceleration = (np.abs(x[:, k]).max() for x in (state.velocity, state.acceleration))
        per_torque, current_max = currents[joint]
        current = f"{acceleration * limits[joint].inertia * per_torque:.3g}" if per_torque else "an unknown current"
        lines.append(
            f"  {joint}: to {path.end[k]:g} rad, at most {speed:.4g} of {limits[joint].velocity_max:.4g} rad/s, "
            f"{acceleration:.4g} of {limits[joint].acceleration_max:.4g} rad/s^2, with {current} of "
            f"{current_max:.3g} A"
        )
    return "\n".join(lines)
