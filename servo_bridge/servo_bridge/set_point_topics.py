"""Topics of position set-points."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from servo_msgs_py.runtime.qos import command_qos
from std_msgs.msg import Float64, Float64MultiArray

from servo_bridge.command_context import CommandContext
from servo_bridge.set_points import Rejected, SetPointRequest, from_array, from_single
from servo_msgs_py import topics


class SetPointTopics:
    """Subscriptions of the position topics.

    Parameters
    ----------
    context : CommandContext
        Checks and counts the set-points.
    """

    def __init__(self, context: CommandContext) -> None:
        self._context = context
        node, qos = context.node, command_qos()
        node.create_subscription(Float64MultiArray, topics.COMMANDS, self._on_commands, qos)
        for axis, joint in enumerate(context.joints):
            topic = topics.joint_position_topic(joint)
            node.create_subscription(Float64, topic, partial(self._on_position, topic, axis), qos)

    def _on_commands(self, message: Float64MultiArray) -> None:
        self._take(topics.COMMANDS, lambda: from_array(topics.COMMANDS, self._context.joints, message.data))

    def _on_position(self, topic: str, axis: int, message: Float64) -> None:
        self._take(topic, lambda: from_single(topic, axis, message.data))

    def _take(self, source: str, parse: Callable[[], SetPointRequest]) -> None:
        try:
            self._context.arbiter.submit(parse())
        except Rejected as error:
            self._context.reject(source, error)
        else:
            self._context.accept()
