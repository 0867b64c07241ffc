"""One Float64 topic per variable, for users of a single number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

from rclpy.node import Node
from servo_msgs_py.catalogue import Value, Variable, axis_name
from servo_msgs_py.convert import columns, row
from servo_msgs_py.runtime.qos import telemetry_qos
from std_msgs.msg import Float64

from servo_bridge.outcome import error_of
from servo_msgs_py import topics


class VariableTopics:
    """Publishes variables of the telemetry, and reads the others one at a time.

    The elements of an array have a topic each: ``var/cmd/position/<joint>``.

    Parameters
    ----------
    node : Node
        Owner.
    joints : sequence of str
        Joint names in the order of the axes; they stand in the names of the topics.
    variables : sequence of Variable
        What to publish.
    sampled : sequence of str
        Columns of the telemetry.
    read : callable
        Starts to read a variable by name.
    post : callable
        Calls a function in the executor's thread.
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        variables: Sequence[Variable],
        sampled: Sequence[str],
        read: Callable[[str], Future[Value]],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._read = read
        self._post = post
        self._publishers: dict[str, Any] = {}
        for variable in variables:
            ends = [""] if variable.count == 1 else [f".{axis_name(k)}" for k in range(variable.count)]
            for column, end in zip(columns([variable]), ends, strict=True):
                topic = topics.variable_topic(variable.name + end, joints)
                self._publishers[column] = node.create_publisher(Float64, topic, telemetry_qos())
        self._outside = _endless([variable for variable in variables if columns([variable])[0] not in sampled])
        self._under_way: Future[Value] | None = None

    def publish(self, sample: Mapping[str, float]) -> None:
        """Publish from a sample [SI] and start to read the next variable that is not in it."""
        self._publish(sample)
        if self._under_way is None and (variable := next(self._outside, None)) is not None:
            future = self._under_way = self._read(variable.name)
            future.add_done_callback(lambda done: self._post(lambda: self._arrived(variable, done)))

    def link_lost(self) -> None:
        """Wait no longer for what is under way."""
        self._under_way = None

    def _arrived(self, variable: Variable, done: Future[Value]) -> None:
        if done is self._under_way:
            self._under_way = None
        if error_of(done) is None:  # a lost link shows up by itself
            values = row([variable], {variable.name: done.result()})
            self._publish(dict(zip(columns([variable]), values, strict=True)))

    def _publish(self, values: Mapping[str, float]) -> None:
        for column, publisher in self._publishers.items():
            if column in values:
                publisher.publish(Float64(data=float(values[column])))


def _endless(variables: Sequence[Variable]) -> Iterator[Variable]:
    """Variables in turn, for ever; nothing when there are none."""
    while variables:
        yield from variables
