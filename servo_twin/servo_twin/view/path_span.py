"""Time span of a motion path: from its first to its last timed point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.timed_points import decode_points

_WRAP = 1 << 32


class PathSpan:
    """Ticks of the newest path, from the points received so far.

    The board receives points before their ticks, so that the span is known before the telemetry.

    Parameters
    ----------
    catalogue : Catalogue
        Scales of the points.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._first = 0
        self._last = -1

    def applied(self, command: AppliedCommand) -> None:
        """Process an applied command: points start or extend a path, other commands end it."""
        if command.variable != "cmd.points":
            self._last = min(self._last, command.tick)
            return
        points = decode_points(self._catalogue, command.raw)
        ticks = [command.tick + _signed(point.tick - command.tick) for point in points]
        begins = [tick for tick, point in zip(ticks, points, strict=True) if point.replaces]
        if self._last < command.tick and begins:
            self._first = min(begins)
        self._last = max(ticks)

    def contains(self, ticks: NDArray[np.int64]) -> NDArray[np.bool_]:
        """True for ticks in the span; shape of `ticks`."""
        return (ticks >= self._first) & (ticks <= self._last)


def _signed(difference: int) -> int:
    """Difference of two ticks modulo 2^32 as a signed number."""
    return (difference + _WRAP // 2) % _WRAP - _WRAP // 2
