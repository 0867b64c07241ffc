"""Whether a serial line carries the timed points of paths, beside the telemetry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.timed_points import POINT_WORDS, POINTS_PER_WRITE
from servo_msgs_py.units import PERIOD

from servo_bridge.trajectory.waypoints import Array

QUEUE: Final = 14
"""Points of an axis that are queued on the board; its queue has 16."""

_BOARD_LEAD: Final = 0.0015
"""Time before its tick at which the board must have a point [s]."""

_CHECK: Final = 0.005
"""Time in which the board checks the points of a full write [s]."""

_WRITE_BYTES: Final = 4 * POINT_WORDS * POINTS_PER_WRITE + 18
"""Request and response of a full write [bytes]; some bytes of the points are sent twice."""

SAMPLE_BYTES: Final = 12
"""Request of a sample, and its response without the variables [bytes]."""


@dataclass(frozen=True)
class PointLine:
    """Transmission of timed points over a line: writes of `POINTS_PER_WRITE` points, each followed by samples."""

    write_time: float  # of a full write with the sample that confirms it [s]
    text: str  # of the line, for messages

    @property
    def rate(self) -> float:
        """Points per second of all axes together."""
        return POINTS_PER_WRITE / self.write_time


def point_line(baud: int, sample_size: int, delay: float) -> PointLine:
    """Return the transmission over a serial line.

    Parameters
    ----------
    baud : int
        Line speed [bit/s].
    sample_size : int
        Variables of a sample of the telemetry [bytes].
    delay : float
        Measured time of an exchange in addition to the time of its bytes on the line [s].
    """
    line = (_WRITE_BYTES + SAMPLE_BYTES + sample_size) * 10 / baud
    return PointLine(line + 2.0 * delay + _CHECK, f"{baud} baud")


@dataclass(frozen=True)
class Demand:
    """What points need of a line."""

    lead: float  # time from the first write to the first point [s]; infinite: the line is too slow for any
    rate: int  # largest number of points of all axes in a second
    time: float  # begin of this second, since the first point [s]


def busiest_second(due: NDArray[np.floating[Any]]) -> tuple[int, float]:
    """Largest number of points in a second, and its begin [s]; `due`: increasing times of points [s]."""
    first = np.searchsorted(due, due - 1.0)
    counts = np.arange(1, len(due) + 1) - first
    most = int(np.argmax(counts))
    return int(counts[most]), float(due[first[most]])


def demand(ticks: Sequence[NDArray[np.int64]], line: PointLine) -> Demand:
    """Return what points need.

    Points are sent in the order of their ticks. A point can be sent when the queue of its axis on the board has room
    for it. It arrives in time if all points before it, sent one after the other since any of them, have been sent.

    Parameters
    ----------
    ticks : sequence of (n,) arrays
        Ticks of the points of every axis, increasing [PWM periods].
    line : PointLine
        The line.
    """
    due = np.concatenate(ticks) * PERIOD
    room = np.concatenate([_room(each) for each in ticks])
    order = np.argsort(due, kind="stable")
    due, room = due[order] - due[order[0]], room[order] - due[order[0]]
    step = np.arange(len(due)) / line.rate
    sent = step + np.maximum.accumulate(room - step)  # begin of its transmission, without the first ones
    late = sent + line.write_time + _BOARD_LEAD - due
    lead = math.inf if late.max() > 0.0 else float((step + line.write_time + _BOARD_LEAD - due).max())
    return Demand(lead, *busiest_second(due))


def _room(ticks: NDArray[np.int64]) -> Array:
    """Times at which the queue of the board has room for each point [s]; before the first ones there is room."""
    room = np.full(len(ticks), -math.inf)
    room[QUEUE:] = ticks[:-QUEUE] * PERIOD
    return room
