"""Arbiter, limits, counters and log of all command topics."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from rclpy.node import Node

from servo_bridge.arbiter import Arbiter
from servo_bridge.health import CommandFigures
from servo_bridge.set_point_sources import Source
from servo_bridge.set_points import Rejected
from servo_bridge.throttle import Throttle
from servo_bridge.trajectory.check import Limits


class CommandContext:
    """Checks and counters of all topics of commands.

    Parameters
    ----------
    node : Node
        Owner of the topics.
    joints : sequence of str
        Joint names in the order of the axes.
    arbiter : Arbiter
        Checks set-points.
    limits : callable
        Present limits of every joint; None if the board has not reported them yet.
    accepted : callable
        Called after every accepted set-point.
    info, warn : callable
        Receive messages for the log.
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        arbiter: Arbiter,
        limits: Callable[[], Sequence[Limits] | None],
        accepted: Callable[[], None],
        info: Callable[[str], None],
        warn: Callable[[str], None],
    ) -> None:
        self.node = node
        self.joints = joints
        self.arbiter = arbiter
        self.limits = limits
        self.figures = CommandFigures()
        self._accepted = accepted
        self._info = info
        self._warn = warn
        self._throttle = Throttle(burst=20, rate=2.0)
        self._repetitions = Throttle()
        self._conflicts = Throttle(rate=0.2, pause=5.0)

    def accept(self) -> None:
        """Count an accepted set-point and start its transmission."""
        self.figures.accepted += 1
        conflict = self.arbiter.sources.conflict()
        if conflict is not None and self._conflicts.admit(conflict.joint, time.monotonic()):
            self._warn(self.conflict())
        self._accepted()

    def conflict(self) -> str:
        """Text of two sources that command one axis alternately; empty if there are none."""
        conflict = self.arbiter.sources.conflict()
        if conflict is None:
            return ""
        first, second = (self._named(source) for source in (conflict.first, conflict.second))
        return (
            f"{conflict.joint} is commanded alternately by {first} and {second}; stop one of them, or give one "
            "precedence with the parameter preferred_source"
        )

    def report_repetitions(self) -> None:
        """Log the number of rejections of bursts that were not logged completely; called once a second."""
        now = time.monotonic()
        for one in (*self._repetitions.ended(now), *self._throttle.ended(now)):
            self._info(
                f"{one.count} set-points were rejected within {one.end - one.begin:.1f} s, the first: {one.text}"
            )

    def _named(self, source: Source) -> str:
        """Text of a source, with the nodes that publish on its topic."""
        found = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(source.topic))
        nodes = sorted({f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in found})
        return f"{source.quantity} on {source.topic} ({' or '.join(nodes) or 'publisher unknown'})"

    def reject(self, source: str, error: Rejected, *, repeats: bool = False) -> None:
        """Count a rejected set-point and log the reason; `repeats`: once for those of one kind that follow each other.

        Their number is logged by `report_repetitions`.
        """
        self.figures.rejected += 1
        self.figures.last_rejection = str(error)
        repeated = repeats and error.kind
        throttle, key = (self._repetitions, (source, error.kind)) if repeated else (self._throttle, source)
        if throttle.admit(key, time.monotonic(), str(error)):
            self._warn(f"rejected, no motion: {error}")
