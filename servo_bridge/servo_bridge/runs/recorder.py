"""Writes a recording in a thread of its own, behind a bounded queue."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from servo_msgs_py.run_file.series import Limits
from servo_msgs_py.run_file.topic import Topic

from servo_bridge.outcome import Outcome

if TYPE_CHECKING:  # needs packages that only recordings need, and takes 0.2 s
    from servo_msgs_py.run_file.series_writer import SeriesWriter

QUEUE_MAX: Final = 32_000_000
"""Largest size of the waiting messages [bytes], more than a minute of telemetry; later ones are lost."""

_DRAIN: Final = 0.1
"""Period of the thread [s]. The queue does not wake it: a switch for every message would cost more than writing it."""

_FLUSH: Final = 0.7
"""Time after which everything is handed to the system [s]; a killed process loses less than the last second."""

_OVERHEAD: Final = 200
"""Memory of a waiting message beside its data [bytes]."""

_MISSING: Final = "a recording needs Python packages that are not installed: pip install 'servo_msgs_py[record]'"


@dataclass(frozen=True)
class RunReport:
    """State of a recording."""

    path: Path  # its first file
    size: int  # of all files [bytes]
    written: int  # messages
    lost: int  # messages that did not fit into the queue
    unknown: tuple[str, ...]  # topics that are not recorded because the definitions of their types are not known
    error: str  # reason why it has ended by itself; empty: it runs, or was stopped
    running: bool


class RunRecorder:
    """A recording, from its start in a thread to its end.

    Parameters
    ----------
    path : Path
        First file; must not exist.
    limits : Limits
        Beyond them the oldest messages are removed.
    latched : mapping
        Last messages of the latched topics, with which it begins.
    lost : Topic
        For the number of lost messages.
    begun, ended : callable
        Called in the thread of the recorder with the outcome of the start, and after a start with that of the
        recording.
    queue_max : int, optional
        See `QUEUE_MAX`.
    """

    def __init__(
        self,
        path: Path,
        limits: Limits,
        latched: Mapping[Topic, bytes],
        lost: Topic,
        begun: Callable[[Outcome], None],
        ended: Callable[[Outcome], None],
        queue_max: int = QUEUE_MAX,
    ) -> None:
        self._path, self._limits, self._lost_topic = path, limits, lost
        self._begun, self._ended = begun, ended
        self._queue_max = queue_max
        self._waiting: deque[tuple[Topic, bytes, int]] = deque()
        self._received = self._taken = 0  # bytes, each counted by one thread
        self._lost = self._lost_written = 0
        self._size = self._written = 0
        self._unknown: list[str] = []
        self._error = ""
        self._ending = threading.Event()
        now_ns = time.time_ns()
        for topic, data in latched.items():
            self.add(topic, data, now_ns)
        self._thread = threading.Thread(target=self._run, name="run recorder", daemon=True)
        self._thread.start()

    def add(self, topic: Topic, data: bytes, time_ns: int) -> None:
        """Record a message; in the thread of the executor.

        Parameters
        ----------
        topic : Topic
        data : bytes
            Serialised message.
        time_ns : int
            Time since the epoch [ns].
        """
        size = len(data) + _OVERHEAD
        if self._received - self._taken + size > self._queue_max:
            self._lost += not self._error
            return
        self._received += size
        self._waiting.append((topic, data, time_ns))

    def end(self) -> None:
        """Complete the recording, without waiting."""
        self._ending.set()

    def join(self, timeout: float = 5.0) -> None:
        """Wait for the end [s]."""
        self._thread.join(timeout)

    @property
    def report(self) -> RunReport:
        """Present state."""
        running = self._thread.is_alive() and not self._error
        return RunReport(self._path, self._size, self._written, self._lost, tuple(self._unknown), self._error, running)

    # ---- thread of the recorder
    def _run(self) -> None:
        try:
            from servo_msgs_py.run_file.series_writer import SeriesWriter

            writer = SeriesWriter(self._path, self._limits)
        except ImportError:
            self._fail(_MISSING)
            return
        except OSError as error:
            self._fail(f"{self._path} cannot be written ({error.strerror}); choose another path or name")
            return
        self._begun((True, f"recording to {self._path}"))
        try:
            self._write_all(writer)
        except OSError as error:
            self._error = f"{error}; free space on the disk, then start another recording"
        except Exception as error:  # the drive goes on, and its user learns of it
            self._error = f"internal error: {error!r}"
        finally:
            with contextlib.suppress(OSError):
                writer.close()
            self._size = writer.size
            self._waiting.clear()
        text = f"recorded {self._written} messages, {self._size / 1e6:.1f} MB, in {self._path}"
        self._ended((not self._error, f"{text}; {self._error}" if self._error else text))

    def _fail(self, reason: str) -> None:
        self._error = reason
        self._waiting.clear()
        self._begun((False, reason))

    def _write_all(self, writer: SeriesWriter) -> None:
        """Write until the end is requested."""
        ending, due = False, time.monotonic() + _FLUSH
        while not ending:
            ending = self._ending.wait(_DRAIN)
            self._drain(writer)
            now = time.monotonic()
            if now >= due:
                due = now + _FLUSH
                writer.flush(now, time.time_ns())
                self._size = writer.size

    def _drain(self, writer: SeriesWriter) -> None:
        from servo_msgs_py.run_file.writer import UnknownTypeError

        for _ in range(len(self._waiting)):
            topic, data, time_ns = self._waiting.popleft()
            self._taken += len(data) + _OVERHEAD
            try:
                writer.write(topic, data, time_ns)
                self._written += 1
            except UnknownTypeError:
                if topic.name not in self._unknown:
                    self._unknown.append(topic.name)
        if self._lost != self._lost_written:
            self._lost_written = self._lost
            data = b"\0\1\0\0" + self._lost_written.to_bytes(8, "little")  # little-endian CDR of std_msgs/UInt64
            writer.write(self._lost_topic, data, time.time_ns())
