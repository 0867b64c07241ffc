"""Topics of position set-points, and the counters and log messages of all set-point topics."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from rclpy.node import Node
from servo_msgs_py.runtime.qos import command_qos
from std_msgs.msg import Float64, Float64MultiArray

from servo_bridge.arbiter import Arbiter
from servo_bridge.health import CommandFigures
from servo_bridge.set_point_sources import Source
from servo_bridge.set_points import Rejected, SetPointRequest, from_array, from_single
from servo_bridge.throttle import Throttle
from servo_msgs_py import topics


class SetPointTopics:
    """Subscriptions of the position topics; counts accepted and rejected set-points of all topics.

    Parameters
    ----------
    node : Node
        Owner.
    joints : sequence of str
        Joint names in the order of the axes.
    arbiter : Arbiter
        Checks set-points.
    accepted : callable
        Called after every accepted set-point.
    warn : callable
        Receives messages for the log.
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        arbiter: Arbiter,
        accepted: Callable[[], None],
        warn: Callable[[str], None],
    ) -> None:
        self._joints = joints
        self._arbiter = arbiter
        self._accepted = accepted
        self._warn = warn
        self._throttle = Throttle(burst=20, rate=2.0)
        self._conflicts = Throttle(burst=1, rate=0.2)
        self._publishers = node.get_publishers_info_by_topic
        self._resolve = node.resolve_topic_name
        self.figures = CommandFigures()
        qos = command_qos()
        node.create_subscription(Float64MultiArray, topics.COMMANDS, self._on_commands, qos)
        for axis, joint in enumerate(joints):
            topic = topics.joint_position_topic(joint)
            node.create_subscription(Float64, topic, partial(self._on_position, topic, axis), qos)

    def _on_commands(self, message: Float64MultiArray) -> None:
        self._take(topics.COMMANDS, lambda: from_array(topics.COMMANDS, self._joints, message.data))

    def _on_position(self, topic: str, axis: int, message: Float64) -> None:
        self._take(topic, lambda: from_single(topic, axis, message.data))

    def _take(self, source: str, parse: Callable[[], SetPointRequest]) -> None:
        try:
            self._arbiter.submit(parse())
        except Rejected as error:
            self.reject(source, error)
        else:
            self.accept()

    def accept(self) -> None:
        """Count an accepted set-point and start its transmission."""
        self.figures.accepted += 1
        conflict = self._arbiter.sources.conflict()
        if conflict is not None and self._conflicts.admit(conflict.joint, time.monotonic()) is not None:
            self._warn(self.conflict())
        self._accepted()

    def conflict(self) -> str:
        """Text of two sources that command one axis alternately; empty if there are none."""
        conflict = self._arbiter.sources.conflict()
        if conflict is None:
            return ""
        first, second = (self._named(source) for source in (conflict.first, conflict.second))
        return (
            f"{conflict.joint} is commanded alternately by {first} and {second}; stop one of them, or give one "
            "precedence with the parameter preferred_source"
        )

    def _named(self, source: Source) -> str:
        """Text of a source, with the nodes that publish on its topic."""
        found = self._publishers(self._resolve(source.topic))
        nodes = sorted({f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in found})
        return f"{source.quantity} on {source.topic} ({' or '.join(nodes) or 'publisher unknown'})"

    def reject(self, source: str, error: Rejected) -> None:
        """Count a rejected set-point and log the reason."""
        self.figures.rejected += 1
        self.figures.last_rejection = str(error)
        held = self._throttle.admit(source, time.monotonic())
        if held is not None:
            more = f" ({held} more rejections before this one)" if held else ""
            self._warn(f"rejected, no motion: {error}{more}")
