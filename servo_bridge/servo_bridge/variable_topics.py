"""One Float64 topic per variable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

from rclpy.node import Node
from servo_msgs_py.catalogue import Value, Variable, axis_name
from servo_msgs_py.convert import columns, row
from servo_msgs_py.runtime.qos import telemetry_qos
from std_msgs.msg import Float64

from servo_bridge.board_context import BoardContext
from servo_bridge.outcome import error_of
from servo_msgs_py import topics


class VariableTopics:
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
    """

    def __init__(
        self,
        context: BoardContext,
        node: Node,
        joints: Sequence[str],
        variables: Sequence[Variable],
        sampled: Sequence[str],
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

    def publish(self, sample: Mapping[str, float]) -> None:
        """Publish the values of a sample [SI], and start to read the next variable that is not in the sample."""
        self._publish(sample)
        if self._pending is None and (variable := next(self._outside, None)) is not None:
            self._pending = self._context.read(variable.name)
            self._context.when_done(self._pending, partial(self._arrived, variable))

    def link_lost(self) -> None:
        """Discard the pending read."""
        self._pending = None

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
