"""Topics of position set-points."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

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
        node, qos, joints = context.node, command_qos(), context.joints
        both = partial(self._take, topics.COMMANDS, partial(from_array, topics.COMMANDS, joints))
        node.create_subscription(Float64MultiArray, topics.COMMANDS, both, qos)
        for axis, joint in enumerate(joints):
            topic = topics.joint_position_topic(joint)
            one = partial(self._take, topic, partial(from_single, topic, axis))
            node.create_subscription(Float64, topic, one, qos)

    def _take(self, source: str, parse: Callable[[Any], SetPointRequest], message: Float64 | Float64MultiArray) -> None:
        try:
            self._context.arbiter.submit(parse(message.data))
        except Rejected as error:
            self._context.reject(source, error)
        else:
            self._context.accept()
