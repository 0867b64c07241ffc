"""The topic ``joint_commands``: single set-points of joints, and streams of positions with velocities."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence

from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_msgs_py.runtime.qos import command_qos

from servo_bridge.arbiter import Arbiter
from servo_bridge.setpoint_topics import SetPointTopics
from servo_bridge.setpoints import NotReady, Rejected, Repeats, from_joint_command, requests_of
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.streamer import Streamer, require_within
from servo_msgs_py import topics

_SOURCE = topics.JOINT_COMMANDS


class JointCommands:
    """Subscription of ``joint_commands``.

    Parameters
    ----------
    node : Node
        Owner.
    joints : sequence of str
        Joint names in the order of the axes.
    arbiter : Arbiter
        Lets a set-point through or not.
    streamer : Streamer
        Gets positions that come with a velocity or an effort.
    set_points : SetPointTopics
        Counts what is accepted and rejected, and says why.
    interfaces : mapping of str to collection of str, optional
        Arrays that a joint is in, where the sender leaves joints out of some.
    limits : callable
        Limits of every joint in force; None while the board has not told them.
    offset_ns : callable
        Time of the steady clock at which the board was at tick 0 [ns]; None before the first sample.
    wall_ns : callable
        ROS time at a time of the steady clock [ns].
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        arbiter: Arbiter,
        streamer: Streamer,
        set_points: SetPointTopics,
        *,
        interfaces: Mapping[str, Collection[str]] | None,
        limits: Callable[[], Sequence[Limits] | None],
        offset_ns: Callable[[], float | None],
        wall_ns: Callable[[int], int],
    ) -> None:
        self._joints = joints
        self._arbiter = arbiter
        self._streamer = streamer
        self._set_points = set_points
        self._interfaces = interfaces
        self._limits = limits
        self._offset_ns = offset_ns
        self._wall_ns = wall_ns
        self._repeats = Repeats()
        node.create_subscription(JointState, _SOURCE, self._on_command, command_qos())

    def advance(self) -> None:
        """Hand on what is due of the streams."""
        now = self._board_time(time.monotonic_ns())
        if now is not None:
            self._streamer.advance(now)

    def _on_command(self, message: JointState) -> None:
        try:
            moves = self._request(message, time.monotonic_ns())
        except Rejected as error:
            self._set_points.reject(_SOURCE, error)
        else:
            if moves:
                self._set_points.accept()

    def _request(self, message: JointState, now_ns: int) -> bool:
        """Carry a message out; False if it leaves every joint alone."""
        arrays = {"position": message.position, "velocity": message.velocity, "effort": message.effort}
        points = from_joint_command(_SOURCE, self._joints, message.name, arrays, self._interfaces)
        if not points:
            return False
        try:
            self._arbiter.check_ready(_SOURCE, points)
        except NotReady:
            self._repeats.refused(now_ns * 1e-9, points)
            raise
        points = self._repeats.fresh(now_ns * 1e-9, points)
        if not points:
            raise Rejected(
                f"{_SOURCE}: it repeats a set-point from before the axes were enabled; it has no effect until it "
                "changes, or pauses for 1 s"
            )
        streamed = {axis: point for axis, point in points.items() if point.streamed}
        limits, arrival = self._limits(), self._board_time(now_ns)
        if streamed and (limits is None or arrival is None):
            raise Rejected(f"{_SOURCE}: the board has not reported its limits yet; try again in a second")
        for axis, point in streamed.items():
            assert limits is not None
            require_within(_SOURCE, self._joints[axis], point, limits[axis])
        self._arbiter.submit(*requests_of(_SOURCE, points))
        if streamed:
            assert limits is not None
            assert arrival is not None
            self._arbiter.admit(_SOURCE, streamed)
            self._streamer.take(streamed, self._stamp(message, arrival), arrival, limits)
            self._streamer.advance(arrival)
        return True

    def _board_time(self, now_ns: int) -> float | None:
        offset = self._offset_ns()
        return None if offset is None else (now_ns - offset) * 1e-9

    def _stamp(self, message: JointState, arrival: float) -> float:
        """Time at which the message was made [s], on the clock of its sender."""
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        offset = self._offset_ns()
        return (stamp_ns - self._wall_ns(round(offset))) * 1e-9 if stamp_ns and offset is not None else arrival
