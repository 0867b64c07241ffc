"""Messages trajectory_msgs/JointTrajectory whose points are read where the path is planned.

rclpy needs 8 us per point to convert a message, and nothing else runs meanwhile. Here the serialised message is read:
the header at once, and the points at the first call of `TrajectoryMessage.points`, in any thread.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Final

import numpy as np
from servo_msgs_py.catalogue import AXES

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.waypoints import WAYPOINTS_MAX, Rows

BYTES_MAX: Final = WAYPOINTS_MAX * (4 * (8 + 8 * AXES) + 8) + 4096
"""Largest serialised message: `WAYPOINTS_MAX` points of all joints with all fields, and the header [bytes]."""

_FIELDS: Final = ("positions", "velocities", "accelerations", "effort")
_HEADER: Final = 4  # bytes before the values, of which the second is 0 (big endian) or 1 (little endian)


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a trajectory."""

    times_ns: tuple[int, ...]  # time_from_start [ns]
    rows: tuple[Rows, ...]  # positions, velocities, accelerations, effort


@dataclass(frozen=True, eq=False)
class TrajectoryMessage:
    """A trajectory; `read` or `converted` creates it."""

    frame_id: str
    stamp_ns: int
    joint_names: tuple[str, ...]
    size: int  # number of points
    points: Callable[[], Points]  # reads them once: 2 us per point


def read(data: bytes) -> TrajectoryMessage:
    """Read a serialised message (CDR, version 1).

    Raises
    ------
    TrajectoryError
        If it is not complete, or has more joints than there are. `TrajectoryMessage.points` raises it too.
    """
    reader = _Reader(data)
    stamp_ns = reader.time_ns()
    frame_id = reader.text()
    count = reader.number()
    if count > AXES:
        raise TrajectoryError(f"joint_names has {count} entries, more than {AXES}; send at most {AXES}")
    names = tuple(reader.text() for _ in range(count))
    size = reader.number()
    return TrajectoryMessage(frame_id, stamp_ns, names, size, cache(partial(reader.points, size)))


def converted(message: Any) -> TrajectoryMessage:
    """Return a message of rclpy, or any object with its fields."""

    def points() -> Points:
        return Points(
            tuple(nanoseconds(point.time_from_start) for point in message.points),
            tuple(Rows.of([list(getattr(point, field)) for point in message.points]) for field in _FIELDS),
        )

    header = message.header
    names = message.joint_names
    return TrajectoryMessage(
        header.frame_id, nanoseconds(header.stamp), tuple(names), len(message.points), cache(points)
    )


def check_size(message: TrajectoryMessage, source: str) -> None:
    """Refuse a message with more joints or points than can be planned, before any work on them.

    Raises
    ------
    TrajectoryError
        With the bound.
    """
    for name, size, most in (("joint_names", len(message.joint_names), AXES), ("points", message.size, WAYPOINTS_MAX)):
        if size > most:
            raise TrajectoryError(f"{source}: {name} has {size} entries, more than {most}; send at most {most}")


def nanoseconds(time: Any) -> int:
    """Convert a stamp or a duration."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


class _Reader:
    """Reads the values of a serialised message one after the other."""

    def __init__(self, data: bytes) -> None:
        if data[:2] not in (b"\0\0", b"\0\1"):
            raise TrajectoryError("the encoding of the message is not CDR version 1; use another middleware")
        order = "><"[data[1]]
        self._values = memoryview(data)[_HEADER:]
        self._number, self._time = struct.Struct(f"{order}I").unpack_from, struct.Struct(f"{order}iI").unpack_from
        self._double = np.dtype(f"{order}f8")
        self._at = 0  # position of the next value

    def number(self) -> int:
        self._at += -self._at % 4
        (value,) = self._read(self._number, 4)
        return int(value)

    def time_ns(self) -> int:
        self._at += -self._at % 4
        seconds, nanoseconds = self._read(self._time, 8)
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def text(self) -> str:
        size = self.number()  # with the zero at its end
        begin, self._at = self._at, self._at + size
        if self._at > len(self._values):
            raise _incomplete()
        return bytes(self._values[begin : self._at]).rstrip(b"\0").decode(errors="replace")

    def points(self, count: int) -> Points:
        at, end = self._at + -self._at % 4, len(self._values)
        number, time = self._number, self._time
        begins: list[list[int]] = [[] for _ in _FIELDS]
        sizes: list[list[int]] = [[] for _ in _FIELDS]
        times = []
        columns = tuple(zip(begins, sizes, strict=True))
        try:
            for _ in range(count):
                for begin, size in columns:
                    (values,) = number(self._values, at)
                    at += 4
                    if values:
                        at += -at % 8
                    begin.append(at)
                    size.append(values)
                    at += 8 * values
                    if at > end:
                        raise _incomplete()
                seconds, nanoseconds = time(self._values, at)
                times.append(seconds * 1_000_000_000 + nanoseconds)
                at += 8
        except struct.error:
            raise _incomplete() from None
        doubles = np.frombuffer(self._values[: end - end % 8], dtype=self._double)
        return Points(tuple(times), tuple(_rows(doubles, *each) for each in columns))

    def _read(self, unpack: Callable[..., tuple[Any, ...]], size: int) -> tuple[Any, ...]:
        begin, self._at = self._at, self._at + size
        if self._at > len(self._values):
            raise _incomplete()
        return unpack(self._values, begin)


def _rows(doubles: Any, begins: Sequence[int], sizes: Sequence[int]) -> Rows:
    """Rows that begin at these bytes."""
    lengths = np.array(sizes, dtype=np.int64)
    before = np.cumsum(lengths) - lengths  # values of earlier rows
    places = np.repeat(np.array(begins, dtype=np.int64) // 8 - before, lengths) + np.arange(lengths.sum())
    return Rows(lengths, doubles[places].astype(np.float64))


def _incomplete() -> TrajectoryError:
    return TrajectoryError("the message is not complete; send it again")
