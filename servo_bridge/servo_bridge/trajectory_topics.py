"""The topic that takes trajectories: form, limits, and a sentence for everything that is refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rclpy.node import Node
from servo_msgs_py.runtime.qos import command_qos
from trajectory_msgs.msg import JointTrajectory

from servo_bridge.arbiter import Arbiter
from servo_bridge.setpoint_topics import SetPointTopics
from servo_bridge.setpoints import NotReady, Rejected
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.follower import Follower, Plan
from servo_bridge.trajectory.from_message import from_message
from servo_bridge.trajectory.path import Path
from servo_msgs_py import topics

_STOP_DELAY = 0.1
"""Until a stop takes effect on the board, and the shaft has followed it [s]."""


class TrajectoryTopics:
    """Subscription of trajectories.

    Parameters
    ----------
    node : Node
        Owner.
    joints : sequence of str
        Joint names in the order of the axes.
    arbiter : Arbiter
        Lets a trajectory through or not.
    follower : Follower
        Brings it to the board.
    set_points : SetPointTopics
        Counts what is accepted and rejected, and says why.
    limits : callable
        Limits of every joint in force; None while the board has not told them.
    origin_ns : callable
        ROS time at which the board was at tick 0 [ns]; None before the first sample.
    say : callable
        Gets a sentence for the log.
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        arbiter: Arbiter,
        follower: Follower,
        set_points: SetPointTopics,
        *,
        limits: Callable[[], Sequence[Limits] | None],
        origin_ns: Callable[[], int | None],
        say: Callable[[str], None],
    ) -> None:
        self._joints = joints
        self._arbiter = arbiter
        self._follower = follower
        self._set_points = set_points
        self._limits = limits
        self._origin_ns = origin_ns
        self._say = say
        node.create_subscription(JointTrajectory, topics.JOINT_TRAJECTORY, self._on_trajectory, command_qos())

    def _on_trajectory(self, message: JointTrajectory) -> None:
        source = topics.JOINT_TRAJECTORY
        try:
            if not len(message.points):
                self.stop(source, message.joint_names)
                return
            self.follow(source, message, refused=lambda error: self._set_points.reject(source, error))
        except Rejected as error:
            self._set_points.reject(source, error)

    def stop(self, source: str, names: Sequence[str], reason: str = "") -> float:
        """Have joints stop at the acceleration limit and hold.

        Parameters
        ----------
        source : str
            Topic or action that asks for it.
        names : sequence of str
            Joints; none: all.
        reason : str
            For paths that end by it; by default that an empty trajectory came.

        Returns
        -------
        float
            When they have stopped, at the latest [s of board time].

        Raises
        ------
        Rejected
            If a joint does not exist, or the axes obey nothing.
        """
        for name in names:
            if name not in self._joints:
                known = ", ".join(self._joints)
                raise TrajectoryError(
                    f"{source}: joint {name!r} does not exist; the joints are {known}", ErrorCode.INVALID_JOINTS
                )
        joints = [joint for joint in self._joints if joint in names or not len(names)]
        axes = [self._joints.index(joint) for joint in joints]
        self._arbiter.check_ready(source, axes)
        limits = self._limits()
        if limits is None:
            raise NotReady(f"{source}: the board has not reported its limits yet; call quick_stop to stop now")
        speeds = self._follower.running().select(joints).state(self._follower.now).velocity
        times = [abs(speed) / limits[axis].acceleration_max for speed, axis in zip(speeds, axes, strict=True)]
        self._arbiter.queue.halt(axes, reason or f"an empty trajectory on {source} stopped it")
        self._set_points.accept()
        self._say(f"stopping {', '.join(joints)} for {source}")
        return float(self._follower.now + max(times) + _STOP_DELAY)

    def follow(
        self,
        source: str,
        message: JointTrajectory,
        *,
        refused: Callable[[TrajectoryError], None],
        begun: Callable[[float], None] | None = None,
        abandoned: Callable[[str], None] | None = None,
        takes_over: str | None = None,
    ) -> Plan:
        """Check a trajectory and have it followed.

        Parameters
        ----------
        source : str
            Topic or action that it came from.
        message : JointTrajectory
            The trajectory.
        refused : callable
            Called when it turns out that it cannot begin.
        begun : callable, optional
            Called with the end of its path [s of board time] when it begins.
        abandoned : callable, optional
            Called with the reason when it has begun, but is not followed to its end.
        takes_over : str, optional
            This reason for what it replaces; by default that a trajectory from this source took over.

        Returns
        -------
        Plan
            For `Follower.withdraw`.

        Raises
        ------
        Rejected
            If it is refused at once; nothing has changed then.
        """
        joints = [joint for joint in self._joints if joint in message.joint_names or not message.joint_names]
        axes = [self._joints.index(joint) for joint in joints]
        self._arbiter.check_ready(source, axes)
        limits, origin_ns = self._limits(), self._origin_ns()
        if limits is None or origin_ns is None:
            raise TrajectoryError(f"{source}: the board has not reported its limits yet; try again in a second")
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec

        def plan(running: Path, now: float) -> Path:
            return from_message(message, running, now, origin_ns, source=source)

        def told(end: float) -> None:
            self._say(f"following a trajectory of {', '.join(joints)} until board time {end:.3f} s")
            if begun is not None:
                begun(end)

        # What is wrong with it by itself is said at once, and not when the axes are ready for it.
        running = self._follower.running()
        plan(running, running.start_time)
        self._arbiter.admit(source, axes)
        self._follower.request(
            joints,
            plan,
            begun=told,
            refused=refused,
            start=(stamp_ns - origin_ns) * 1.0e-9 if stamp_ns else 0.0,
            abandoned=abandoned,
            takes_over=takes_over or f"a trajectory on {source} took over",
        )
        self._set_points.accept()
        return plan
