"""Timed points of one axis that wait for their transmission; they become words only when they are sent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.timed_points import TimedPoint

from servo_bridge.trajectory.waypoints import Array


@dataclass
class _Block:
    """Points from `first` to before `end` of the columns."""

    periods: NDArray[np.int64]  # (n,), extended ticks [PWM periods]
    positions: Array  # (n,), of the motor [rad]
    velocities: Array  # (n,) [rad/s]
    currents: Array  # (n,), feed-forward i_q [A]
    replaces: bool  # the first point of the columns replaces those on the board from its tick on
    end: int  # index after the last waiting point
    first: int = 0  # index of the next point


class PointQueue:
    """Waiting points of an axis, in the order of their ticks; of any number, without work per point.

    Parameters
    ----------
    axis : int
        Index of the axis.
    """

    def __init__(self, axis: int) -> None:
        self._axis = axis
        self._blocks: deque[_Block] = deque()

    def __bool__(self) -> bool:
        return bool(self._blocks)

    @property
    def tick(self) -> int:
        """Tick of the next point."""
        block = self._blocks[0]
        return int(block.periods[block.first])

    @property
    def replaces(self) -> bool:
        """Whether the next point replaces points of the board."""
        return self._blocks[0].replaces and self._blocks[0].first == 0

    @property
    def ticks(self) -> NDArray[np.int64]:
        """Ticks of all waiting points."""
        parts = [block.periods[block.first : block.end] for block in self._blocks]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def put(
        self, periods: NDArray[np.int64], positions: Array, velocities: Array, currents: Array, *, replaces: bool
    ) -> None:
        """Append points; their ticks are after those that wait."""
        self._blocks.append(_Block(periods, positions, velocities, currents, replaces, len(periods)))

    def drop_from(self, tick: int) -> None:
        """Remove the points from a tick on."""
        while self._blocks:
            block = self._blocks[-1]
            block.end = min(block.end, int(np.searchsorted(block.periods, tick)))
            if block.end > block.first:
                return
            self._blocks.pop()

    def pop(self) -> tuple[int, TimedPoint]:
        """Remove the next point; returns its extended tick and the point."""
        block = self._blocks[0]
        k = block.first
        period = int(block.periods[k])
        point = TimedPoint(
            self._axis,
            period % (1 << 32),
            float(block.positions[k]),
            float(block.velocities[k]),
            float(block.currents[k]),
            replaces=self.replaces,
        )
        block.first += 1
        if block.first == block.end:
            self._blocks.popleft()
        return period, point
