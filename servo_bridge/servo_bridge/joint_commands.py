"""The topic ``joint_commands``: single set-points and streams of positions with velocities."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

from sensor_msgs.msg import JointState
from servo_msgs_py.answers import TICKET, Answer, Phase
from servo_msgs_py.runtime.qos import command_qos

from servo_bridge.admission import Admission, NotJoined, Place
from servo_bridge.answers import Answers
from servo_bridge.command_context import CommandContext
from servo_bridge.part import Part
from servo_bridge.sample_clocks import SampleClocks
from servo_bridge.set_points import JointSetPoint, NotReady, Rejected, from_joint_command, requests_of
from servo_bridge.telemetry import Snapshot
from servo_bridge.trajectory.streamer import Streamer, require_within
from servo_msgs_py import topics

_SOURCE = topics.JOINT_COMMANDS


class JointCommands(Part):
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
    clocks : SampleClocks
        Converts times of messages to board time.
    """

    def __init__(
        self,
        context: CommandContext,
        streamer: Streamer,
        answers: Answers,
        *,
        interfaces: Mapping[str, Collection[str]] | None,
        clocks: SampleClocks,
    ) -> None:
        self._context = context
        self._streamer = streamer
        self._answers = answers
        self._interfaces = interfaces
        self._clocks = clocks
        wrapping = [axis for axis, joint in enumerate(context.arbiter.joints) if joint.wraps]
        self._admission = Admission(_SOURCE, wrapping)
        self._streamed: dict[int, float] = {}  # newest position of the stream of each axis [rad]
        self._arrivals_ns: dict[int, int] = {}  # of the newest message of each axis, steady clock [ns]
        context.node.create_subscription(JointState, _SOURCE, self._on_command, command_qos())

    def on_sample(self, snapshot: Snapshot) -> None:
        """Execute the set-points that are due."""
        now_ns = time.monotonic_ns()
        due = self._admission.advance(now_ns * 1e-9)
        for axis in list(due):
            holder = self._context.arbiter.sources.holder(axis)
            waited = (now_ns - self._arrivals_ns[axis]) * 1e-9
            if holder is not None and holder.topic != _SOURCE and self._context.arbiter.sources.age(axis) < waited:
                joint, newer = self._context.joints[axis], holder.topic
                self._context.reject(_SOURCE, Rejected(f"{_SOURCE}: {joint}: a set-point on {newer} was newer"))
                del due[axis]
        if due:
            self._take(lambda: self._submit(due))
        now = self._clocks.board_time(now_ns)
        if now is not None:
            self._streamer.advance(now)

    def _on_command(self, message: JointState) -> None:
        ticket = message.header.frame_id
        if self._answers.refused(ticket) or (self._answers.known(ticket) and len(message.position)):
            return  # repeated by its sender, which has not received the answer yet; velocities and efforts are renewed
        self._take(lambda: self._request(message, time.monotonic_ns()), ticket)

    def _take(self, execute: Callable[[], Rejected | None], ticket: str = "") -> None:
        """Execute and count set-points; `execute` returns the refusal of some of the joints, if any."""
        refused: Rejected | None
        try:
            refused = execute()
        except Rejected as error:
            refused = error
        if refused is not None:
            self._context.reject(_SOURCE, refused, repeats=not ticket.startswith(TICKET))
            self._answers.publish(Answer(ticket, _SOURCE, Phase.REFUSED, str(refused)))
        else:
            self._answers.publish(Answer(ticket, _SOURCE, Phase.ACCEPTED))

    def _request(self, message: JointState, now_ns: int) -> NotJoined | None:
        """Execute a message; returns the refusal of some joints."""
        context = self._context
        arrays = {"position": message.position, "velocity": message.velocity, "effort": message.effort}
        points = from_joint_command(_SOURCE, context.joints, message.name, arrays, self._interfaces)
        if not points:
            return None
        self._arrivals_ns |= dict.fromkeys(points, now_ns)
        arrival = self._clocks.board_time(now_ns)
        stamp = self._stamp(message, now_ns)
        try:
            self._require_ready(points)
            places = {
                axis: context.arbiter.place(_SOURCE, axis, streaming=self._streamer.streams(axis)) for axis in points
            }
            self._check(self._unwrapped(points, places), places)
        except Rejected:
            self._admission.observe(points, stamp)
            raise
        ticket = message.header.frame_id
        command = ticket.startswith(TICKET) and not self._answers.known(ticket)
        admitted = self._admission.decide(points, stamp, places, command=command)
        if admitted.stop:
            context.arbiter.queue.halt(admitted.stop, f"contradictory set-points on {_SOURCE} stopped it")
        if admitted.points:
            self._submit(self._unwrapped(admitted.points, places), stamp, arrival)
        return next(iter(admitted.refused), None)

    def _require_ready(self, points: Collection[int]) -> None:
        """Check that the joints of a message accept set-points, and stop those that this topic moves if one does not.

        The joints of a message move together: none of them goes on alone, and none stops without a log message.

        Raises
        ------
        NotReady
            If a joint does not.
        """
        arbiter = self._context.arbiter
        try:
            arbiter.check_ready(_SOURCE, points)
        except NotReady as error:
            holders = {axis: arbiter.sources.holder(axis) for axis in sorted(points)}
            moved = [axis for axis, holder in holders.items() if holder is not None and holder.topic == _SOURCE]
            if not moved:
                raise
            for axis in moved:
                arbiter.release_axis(axis, str(error))
            arbiter.queue.halt(moved, str(error))
            joints = " and ".join(self._context.joints[axis] for axis in moved)
            raise NotReady(f"{error}; {joints} of the same message stops, too", error.kind) from None

    def _check(self, points: Mapping[int, JointSetPoint], places: Mapping[int, Place]) -> None:
        """Check the values of set-points.

        Raises
        ------
        Rejected
            If a value exceeds its limit.
        """
        context = self._context
        context.arbiter.check(*requests_of(_SOURCE, points))
        streamed = {axis: point for axis, point in points.items() if point.streamed}
        if not streamed:
            return
        context.arbiter.check_source(_SOURCE, streamed)
        limits = context.limits()
        if limits is None:
            raise Rejected(f"{_SOURCE}: the board has not reported its limits yet; try again in 1 s")
        self._streamer.require_carried(_SOURCE, streamed)
        for axis, point in streamed.items():
            require_within(_SOURCE, context.joints[axis], point, limits[axis], places[axis].position)

    def _submit(self, points: Mapping[int, JointSetPoint], stamp: float = 0.0, arrival: float | None = None) -> None:
        """Execute admitted set-points; `stamp` and `arrival` of a path [s of board time]."""
        context = self._context
        streamed = {axis: point for axis, point in points.items() if point.streamed}
        context.arbiter.submit(*requests_of(_SOURCE, points))
        if streamed:
            limits = context.limits()
            assert limits is not None
            assert arrival is not None
            context.arbiter.admit_path(_SOURCE, streamed)
            self._streamer.take(streamed, stamp, arrival, limits)
            self._streamed |= {axis: point.position for axis, point in streamed.items() if point.position is not None}
            self._streamer.advance(arrival)
        context.accept()

    def _unwrapped(self, points: Mapping[int, JointSetPoint], places: Mapping[int, Place]) -> dict[int, JointSetPoint]:
        """Set-points with the angles of joints that wrap by the shortest way from the stream, or from the joint.

        The admission compares the angles as they were sent: unwrapped, a repeated one changes by a turn when its joint
        passes the opposite side.
        """
        result = dict(points)
        for axis, point in points.items():
            if point.position is not None:
                place = places[axis]
                reference = self._streamed[axis] if place.streaming else place.position
                position = self._context.arbiter.joints[axis].nearest(point.position, reference)
                result[axis] = replace(point, position=position)
        return result

    def _stamp(self, message: JointState, now_ns: int) -> float:
        """Time stamp of the message in the time of the board [s]; without a stamp, the arrival."""
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        if not stamp_ns:
            return self._clocks.board_time(now_ns) or now_ns * 1e-9
        return float(stamp_ns - (self._clocks.origin_ns or 0)) * 1e-9
