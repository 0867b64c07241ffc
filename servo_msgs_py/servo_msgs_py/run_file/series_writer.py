"""Writer of a recording with a bounded size: segments, the oldest of which are removed."""

from __future__ import annotations

import errno
import os
import shutil
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

from servo_msgs_py.run_file.series import Limits, segment, segments
from servo_msgs_py.run_file.topic import Topic
from servo_msgs_py.run_file.writer import RunWriter

SEGMENTS: Final = 8
"""Number of segments of a recording at its largest size or duration."""

RESERVE: Final = 100_000_000
"""Free space of the disk at which a recording ends, for others and to complete its file [bytes]."""


class SeriesWriter:
    """A new recording. Each segment can be read alone: it begins with the last messages of the latched topics.

    Parameters
    ----------
    path : Path
        Its first segment; no segment of it must exist.
    limits : Limits, optional
        Default: none.
    free : callable, optional
        Free space of the disk of a folder [bytes].

    Raises
    ------
    OSError
        If it exists or cannot be written; with its name. So do all methods, after which only `close` is useful.
    """

    def __init__(
        self,
        path: Path,
        limits: Limits | None = None,
        free: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        if segments(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        self.path = path
        self._limits = limits or Limits()
        self._free = free
        self._latched: dict[Topic, bytes] = {}
        self._finished: deque[tuple[Path, int, float]] = deque()  # path, size [bytes] and time of the end [s]
        self._number = 0
        self._begun: float | None = None
        self._writer = RunWriter(path)

    @property
    def size(self) -> int:
        """Bytes of all files up to the last `flush`."""
        return sum(size for _, size, _ in self._finished) + self._writer.size

    def write(self, topic: Topic, data: bytes, time_ns: int) -> None:
        """As `RunWriter.write`."""
        self._writer.write(topic, data, time_ns)
        if topic.latched:
            self._latched[topic] = data

    def flush(self, now: float, time_ns: int) -> None:
        """As `RunWriter.flush`; begins a new segment if it is due.

        Parameters
        ----------
        now : float
            Time with any origin [s].
        time_ns : int
            Time since the epoch, for the messages that are repeated in a new segment [ns].

        Raises
        ------
        OSError
            Also if the disk is nearly full.
        """
        self._writer.flush()
        if self._free(self.path.parent) < RESERVE:
            raise OSError(errno.ENOSPC, f"less than {RESERVE / 1e6:.0f} MB are free", str(self.path))
        self._begun = now if self._begun is None else self._begun
        size, duration = self._limits.size / SEGMENTS, self._limits.duration / SEGMENTS
        if self._writer.size >= size or now - self._begun >= duration:
            self._next(now, time_ns)

    def close(self) -> None:
        """As `RunWriter.close`."""
        self._writer.close()

    def _next(self, now: float, time_ns: int) -> None:
        self._writer.close()
        self._finished.append((segment(self.path, self._number), self._writer.size, now))
        while self._finished and self._excess(now):
            self._finished.popleft()[0].unlink(missing_ok=True)
        self._number += 1
        self._begun = now
        self._writer = RunWriter(segment(self.path, self._number))
        for topic, data in self._latched.items():
            self._writer.write(topic, data, time_ns)

    def _excess(self, now: float) -> bool:
        """Whether the oldest segment has to go."""
        size = sum(size for _, size, _ in self._finished)
        ended = self._finished[0][2]
        return size > self._limits.size * (1 - 1 / SEGMENTS) or now - ended >= self._limits.duration
