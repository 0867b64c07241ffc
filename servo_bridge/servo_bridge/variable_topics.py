"""One Float64 topic per variable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from servo_msgs_py.catalogue import Value, Variable, axis_name
from servo_msgs_py.convert import columns, row
from servo_msgs_py.runtime.qos import telemetry_qos
from std_msgs.msg import Float64

from servo_bridge.board_context import BoardContext
from servo_bridge.outcome import error_of
from servo_bridge.part import Part
from servo_bridge.telemetry import Snapshot
from servo_msgs_py import topics


class VariableTopics(Part):
    """Publishes variables of the telemetry, and reads the other ones one at a time.

    Elements of an array have one topic each: ``var/cmd/position/<joint>``.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    node : Node
        Owner.
    joints : sequence of str
        Joint names in the order of the axes; used in the names of the topics.
    variables : sequence of Variable
        Variables to publish.
    sampled : sequence of str
        Columns of the telemetry.
    rate : float
        Of the topics [Hz].
    """

    def __init__(
        self,
        context: BoardContext,
        node: Node,
        joints: Sequence[str],
        variables: Sequence[Variable],
        sampled: Sequence[str],
        rate: float,
    ) -> None:
        self._context = context
        self._publishers: dict[str, Any] = {}
        for variable in variables:
            ends = [""] if variable.count == 1 else [f".{axis_name(k)}" for k in range(variable.count)]
            for column, end in zip(columns([variable]), ends, strict=True):
                topic = topics.variable_topic(variable.name + end, joints)
                self._publishers[column] = node.create_publisher(Float64, topic, telemetry_qos())
        self._outside = _cycle([variable for variable in variables if columns([variable])[0] not in sampled])
        self._pending: Future[Value] | None = None
        self._newest: Snapshot | None = None
        if variables:
            node.create_timer(1.0 / rate, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def on_sample(self, snapshot: Snapshot) -> None:
        """Keep the newest sample."""
        self._newest = snapshot

    def publish(self) -> None:
        """Publish the values of the newest sample, and start to read the next variable that is not in it."""
        if self._newest is None:
            return
        self._publish(self._newest.values)
        if self._pending is None and (variable := next(self._outside, None)) is not None:
            self._pending = self._context.read(variable.name)
            self._context.when_done(self._pending, partial(self._arrived, variable))

    def lost(self, reason: str) -> None:
        """Forget the sample, and discard the pending read."""
        self._newest = self._pending = None

    def _arrived(self, variable: Variable, done: Future[Value]) -> None:
        if done is self._pending:
            self._pending = None
        if error_of(done) is None:  # the loss of the link is reported elsewhere
            values = row([variable], {variable.name: done.result()})
            self._publish(dict(zip(columns([variable]), values, strict=True)))

    def _publish(self, values: Mapping[str, float]) -> None:
        for column, publisher in self._publishers.items():
            if column in values:
                publisher.publish(Float64(data=float(values[column])))


def _cycle(variables: Sequence[Variable]) -> Iterator[Variable]:
    """Repeat the variables endlessly; empty if there are none."""
    while variables:
        yield from variables
