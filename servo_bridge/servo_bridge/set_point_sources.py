"""Sources of set-points: detection of two sources that command an axis alternately, and precedence of one topic.

A source is a topic and a quantity, such as position on ``joint_commands``. rclpy does not report the publisher of a
message, so all publishers of one topic and quantity are one source.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from servo_bridge.set_points import Rejected
from servo_msgs_py import topics

FRESH: Final = 1.0
"""Time for which a source counts as active after its last set-point [s]."""

_STOP: Final = {
    topics.JOINT_COMMANDS: "stop it (ros2_control: make the hardware inactive; without a controller it still publishes)"
}
"""How to stop a source, by topic."""


class Source(NamedTuple):
    """Topic and quantity of a set-point."""

    topic: str  # relative name
    quantity: str  # ``position``, ``velocity``, ``effort`` or ``trajectory``


@dataclass(frozen=True)
class Conflict:
    """Two sources that command one axis alternately."""

    joint: str
    first: Source
    second: Source


class Sources:
    """The active sources of every axis.

    Parameters
    ----------
    clock : callable
        Steady time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.preferred = ""
        """Topic with precedence: while it is active, other topics are refused for the same axis. Empty: none."""
        self._clock = clock
        self._seen: dict[int, dict[Source, float]] = {}  # the newest last
        self._holders: dict[int, tuple[Source, float]] = {}  # last source of each axis, and its time [s]
        self._conflict: tuple[float, Conflict] | None = None

    def conflict(self) -> Conflict | None:
        """Latest conflict, if it is not older than `FRESH`."""
        if self._conflict is None or self._clock() - self._conflict[0] >= FRESH:
            return None
        return self._conflict[1]

    def require(self, topic: str, axes: Iterable[int], joints: Sequence[str], follows: Callable[[int], bool]) -> None:
        """Check that a topic may command some axes; arguments as in `claim`.

        Raises
        ------
        Rejected
            If another topic has precedence.
        """
        if self.preferred in ("", topic):
            return
        for axis in axes:
            if any(each.topic == self.preferred for each in self._active(axis, follows)):
                stop = _STOP.get(self.preferred, "stop it")
                raise Rejected(
                    f"{topic}: {self.preferred} commands {joints[axis]} and has precedence (parameter "
                    f"preferred_source); {stop} and wait {FRESH:g} s"
                )

    def claim(self, source: Source, axes: Iterable[int], joints: Sequence[str], follows: Callable[[int], bool]) -> None:
        """Register a command of some axes.

        Parameters
        ----------
        source : Source
            Source of the command.
        axes : iterable of int
            The axes.
        joints : sequence of str
            Names of all joints.
        follows : callable
            Whether an axis follows a trajectory; its last source stays active until the end.
        """
        now = self._clock()
        for axis in axes:
            sources = self._active(axis, follows)
            last = next(reversed(sources), source)
            # A change of the source is no conflict; a source that returns while active is.
            if last != source and source in sources:
                self._conflict = now, Conflict(joints[axis], *sorted((last, source)))
            sources.pop(source, None)
            sources[source] = now
            self._seen[axis] = sources
            self._holders[axis] = source, now

    def holder(self, axis: int) -> Source | None:
        """Source that has commanded an axis last, since it was released; None: none."""
        return self._holders[axis][0] if axis in self._holders else None

    def age(self, axis: int) -> float:
        """Time since the last command of the holder of an axis [s]; infinite without one."""
        return self._clock() - self._holders[axis][1] if axis in self._holders else math.inf

    def release(self, axis: int) -> None:
        """Register that an axis has been stopped otherwise: a source must be admitted again."""
        self._holders.pop(axis, None)

    def _active(self, axis: int, follows: Callable[[int], bool]) -> dict[Source, float]:
        now, seen = self._clock(), self._seen.get(axis, {})
        active = {each: when for each, when in seen.items() if now - when < FRESH}
        if seen and not active and follows(axis):
            last = next(reversed(seen))
            active[last] = seen[last]
        return active
