"""The topic ``joint_commands``: single set-points and streams of positions with velocities."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping

from sensor_msgs.msg import JointState
from servo_msgs_py.answers import Answer, Phase
from servo_msgs_py.runtime.qos import command_qos

from servo_bridge.answers import Answers
from servo_bridge.command_context import CommandContext
from servo_bridge.set_points import REPEAT_PAUSE, NotReady, Rejected, RepeatedSetPoints, from_joint_command, requests_of
from servo_bridge.trajectory.streamer import Streamer, require_within
from servo_msgs_py import topics

_SOURCE = topics.JOINT_COMMANDS


class JointCommands:
    """Subscription of ``joint_commands``.

    Parameters
    ----------
    context : CommandContext
        Checks and counts the messages.
    streamer : Streamer
        Receives positions with a velocity or an effort.
    answers : Answers
        Publisher of the answers to messages with a ticket.
    interfaces : mapping of str to collection of str, optional
        Arrays with each joint, if the sender omits joints in some arrays.
    offset_ns : callable
        Steady clock at tick 0 of the board [ns]; None before the first sample.
    wall_ns : callable
        Converts steady clock to ROS time [ns].
    """

    def __init__(
        self,
        context: CommandContext,
        streamer: Streamer,
        answers: Answers,
        *,
        interfaces: Mapping[str, Collection[str]] | None,
        offset_ns: Callable[[], float | None],
        wall_ns: Callable[[int], int],
    ) -> None:
        self._context = context
        self._streamer = streamer
        self._answers = answers
        self._interfaces = interfaces
        self._offset_ns = offset_ns
        self._wall_ns = wall_ns
        self._repeats = RepeatedSetPoints()
        context.node.create_subscription(JointState, _SOURCE, self._on_command, command_qos())

    def advance(self) -> None:
        """Send the due points of the streams."""
        now = self._board_time(time.monotonic_ns())
        if now is not None:
            self._streamer.advance(now)

    def _on_command(self, message: JointState) -> None:
        try:
            moves = self._request(message, time.monotonic_ns())
        except Rejected as error:
            self._context.reject(_SOURCE, error)
            self._answers.publish(Answer(message.header.frame_id, _SOURCE, Phase.REFUSED, str(error)))
        else:
            if moves:
                self._context.accept()
                self._answers.publish(Answer(message.header.frame_id, _SOURCE, Phase.ACCEPTED))

    def _request(self, message: JointState, now_ns: int) -> bool:
        """Execute a message; returns False if it has no set-point."""
        context = self._context
        arrays = {"position": message.position, "velocity": message.velocity, "effort": message.effort}
        points = from_joint_command(_SOURCE, context.joints, message.name, arrays, self._interfaces)
        if not points:
            return False
        try:
            context.arbiter.check_ready(_SOURCE, points)
        except NotReady:
            self._repeats.refused(now_ns * 1e-9, points)
            raise
        points = self._repeats.without_repeats(now_ns * 1e-9, points)
        if not points:
            raise Rejected(
                f"{_SOURCE}: repeats a set-point from before the axes were enabled; it is accepted when it changes, or"
                f" after a pause of {REPEAT_PAUSE:g} s"
            )
        streamed = {axis: point for axis, point in points.items() if point.streamed}
        if not streamed:
            context.arbiter.submit(*requests_of(_SOURCE, points))
            return True
        limits, arrival = context.limits(), self._board_time(now_ns)
        if limits is None or arrival is None:
            raise Rejected(f"{_SOURCE}: the board has not reported its limits yet; try again in 1 s")
        for axis, point in streamed.items():
            require_within(_SOURCE, context.joints[axis], point, limits[axis])
        context.arbiter.submit(*requests_of(_SOURCE, points))
        context.arbiter.admit(_SOURCE, streamed)
        self._streamer.take(streamed, self._stamp(message, arrival), arrival, limits)
        self._streamer.advance(arrival)
        return True

    def _board_time(self, now_ns: int) -> float | None:
        offset = self._offset_ns()
        return None if offset is None else (now_ns - offset) * 1e-9

    def _stamp(self, message: JointState, arrival: float) -> float:
        """Time stamp of the message in the time of the board [s]; without a stamp, the arrival."""
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        offset = self._offset_ns()
        return (stamp_ns - self._wall_ns(round(offset))) * 1e-9 if stamp_ns and offset is not None else arrival
