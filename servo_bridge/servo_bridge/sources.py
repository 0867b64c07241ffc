"""Sources of set-points: finds two sources that command it by turns, and gives one of them precedence. Pure.

A source is a topic and a quantity, as in position on ``joint_commands``. rclpy does not tell which publisher a message
came from, so publishers of one topic and quantity are one source.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Final

from servo_bridge.setpoints import Rejected

FRESH: Final = 1.0
"""How long a source counts as active after its last set-point [s]."""


@dataclass(frozen=True)
class Source:
    """Where set-points come from."""

    topic: str  # relative name
    quantity: str  # ``position``, ``velocity``, ``effort`` or ``trajectory``


@dataclass(frozen=True)
class Conflict:
    """Two sources that command one axis by turns."""

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
        self._conflict: tuple[float, Conflict] | None = None

    def conflict(self) -> Conflict | None:
        """The latest conflict, while it is fresh."""
        if self._conflict is None or self._clock() - self._conflict[0] >= FRESH:
            return None
        return self._conflict[1]

    def claim(self, source: Source, axes: Iterable[int], joints: Collection[str], following: Collection[int]) -> None:
        """Note a command of some axes.

        Parameters
        ----------
        source : Source
            Where it comes from.
        axes : iterable of int
            The axes.
        joints : collection of str
            Names of all joints.
        following : collection of int
            Axes that follow a trajectory: the source that moved them last is active until its end.

        Raises
        ------
        Rejected
            If another source has precedence; then nothing has changed.
        """
        now, names, axes = self._clock(), list(joints), list(axes)
        active = {axis: self._active(axis, now, axis in following) for axis in axes}
        for axis, sources in active.items():
            topics = {each.topic for each in sources}
            if self.preferred != source.topic and self.preferred in topics:
                raise Rejected(
                    f"{source.topic}: {self.preferred} commands {names[axis]} and has precedence (parameter "
                    f"preferred_source); stop it and wait {FRESH:g} s"
                )
        for axis, sources in active.items():
            last = next(reversed(sources), source)
            # A take-over is no conflict; a source that comes back within the time is.
            if last != source and source in sources:
                pair = sorted((last, source), key=lambda each: (each.topic, each.quantity))
                self._conflict = now, Conflict(names[axis], *pair)
            sources.pop(source, None)
            sources[source] = now
            self._seen[axis] = sources

    def _active(self, axis: int, now: float, following: bool) -> dict[Source, float]:
        seen = self._seen.get(axis, {})
        last = next(reversed(seen), None) if following else None
        return {each: when for each, when in seen.items() if each == last or now - when < FRESH}
