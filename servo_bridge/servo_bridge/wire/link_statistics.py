"""Figures of the link: rates, round trips, errors."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Final

from servo_bridge.freemaster.line import ClientStatistics

_WINDOW_NS: Final = 2_000_000_000
_ROUND_TRIPS: Final = 2000


@dataclass(frozen=True)
class Silence:
    """Time between two successive commands or keep-alives that the board has acknowledged, and its cause."""

    duration: float = 0.0  # [s]
    waited: float = 0.0  # part of it in which the bridge waited for responses of the board [s]
    withheld: str = ""  # reason for which keep-alives were withheld; else empty

    @property
    def cause(self) -> str:
        """The program that was late, in words."""
        if self.withheld:
            return f"the bridge was late: {self.withheld}"
        if self.waited > 0.5 * self.duration:
            return f"the board or its line was late: no response for {self.waited:.2f} s"
        return (
            f"the process of the bridge was late: for {self.duration - self.waited:.2f} s it did not run (the computer "
            "is overloaded or was suspended, or the process was stopped)"
        )


@dataclass(frozen=True)
class LinkStatistics:
    """Figures of the link."""

    samples: int = 0  # telemetry samples since the start
    connections: int = 0  # times connected since the start
    resets: int = 0  # board resets since the start
    sample_rate: float = 0.0  # over the last 2 s [1/s]
    bytes_out_rate: float = 0.0  # over the last 2 s [bytes/s]
    bytes_in_rate: float = 0.0  # over the last 2 s [bytes/s]
    timeouts: int = 0  # unanswered requests
    crc_errors: int = 0  # responses with a wrong checksum
    damaged: int = 0  # damaged responses, for any reason
    retries: int = 0  # repeated requests
    refused: int = 0  # requests that the board refused
    stray_bytes: int = 0  # bytes without a request
    round_trip_p50: float = 0.0  # time from request to response of the latest samples, median [s]
    round_trip_p99: float = 0.0  # 99th percentile of that time [s]
    round_trip_max: float = 0.0  # maximum of that time [s]
    writes: int = 0  # acknowledged writes
    waiting: int = 0  # jobs in the queue
    clock_disagreements: int = 0  # samples whose tick disagreed with the host clock, although the board was not reset
    clock_disagreement_max: float = 0.0  # largest disagreement, beyond what is normal [s]
    silence: Silence = Silence()  # longest one that ended in the last 2 s


class StatisticsCollector:
    """Collects in the thread of the link; reports can be requested by any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counters = ClientStatistics()
        self._marks: deque[tuple[int, int, int, int]] = deque()  # time, samples, bytes out, bytes in
        self._trips: deque[int] = deque(maxlen=_ROUND_TRIPS)
        self._samples = 0
        self._connections = 0
        self._resets = 0
        self._writes = 0
        self._disagreements = 0
        self._disagreement_ns = 0
        self._fed: tuple[int, int] | None = None  # last command or keep-alive: time and waiting time until then [ns]
        self._withheld = ""  # since then
        self._silences: deque[tuple[int, Silence]] = deque()  # of the last 2 s, with their ends [ns]

    @property
    def counters(self) -> ClientStatistics:
        """Counters of the client; kept if the client is replaced."""
        return self._counters

    def connected(self) -> None:
        """Count a connection and restart the rates."""
        with self._lock:
            self._connections += 1
            self._marks.clear()
            self._fed, self._withheld = None, ""

    def reset_seen(self) -> None:
        """Count a reset of the board."""
        with self._lock:
            self._resets += 1

    def clocks_disagree(self, disagreement_ns: int) -> None:
        """Count a disagreement of the clocks of board and host [ns]."""
        with self._lock:
            self._disagreements += 1
            self._disagreement_ns = max(self._disagreement_ns, disagreement_ns)

    def wrote(self) -> None:
        """Count an acknowledged write."""
        with self._lock:
            self._writes += 1

    def withheld(self, reason: str) -> None:
        """A keep-alive is due but is not sent, for this reason."""
        with self._lock:
            self._withheld = reason

    def fed(self, now_ns: int) -> None:
        """The board has acknowledged a command or a keep-alive, at a monotonic time [ns]."""
        with self._lock:
            waited_ns = self._counters.waited_ns
            if self._fed is not None:
                duration, waited = now_ns - self._fed[0], waited_ns - self._fed[1]
                self._silences.append((now_ns, Silence(duration * 1e-9, waited * 1e-9, self._withheld)))
                while now_ns - self._silences[0][0] > _WINDOW_NS:
                    self._silences.popleft()
            self._fed, self._withheld = (now_ns, waited_ns), ""

    def sampled(self, request_ns: int, response_ns: int) -> None:
        """Count a sample."""
        with self._lock:
            self._samples += 1
            self._trips.append(response_ns - request_ns)
            self._marks.append((response_ns, self._samples, self._counters.bytes_out, self._counters.bytes_in))
            while response_ns - self._marks[0][0] > _WINDOW_NS:
                self._marks.popleft()

    def report(self, now_ns: int, waiting: int) -> LinkStatistics:
        """Present figures.

        Parameters
        ----------
        now_ns : int
            Monotonic time [ns]; rates are zero without samples for 2 s.
        waiting : int
            Jobs in the queue.
        """
        with self._lock:
            trips = sorted(self._trips)
            c = self._counters
            rates = (0.0, 0.0, 0.0)
            if len(self._marks) > 1 and now_ns - self._marks[-1][0] < _WINDOW_NS:
                first, last = self._marks[0], self._marks[-1]
                span = (last[0] - first[0]) * 1e-9
                rates = ((last[1] - first[1]) / span, (last[2] - first[2]) / span, (last[3] - first[3]) / span)
            return LinkStatistics(
                self._samples, self._connections, self._resets, *rates,
                c.timeouts, c.crc_errors, c.damaged, c.retries, c.refused, c.stray_bytes,
                _percentile(trips, 50), _percentile(trips, 99), _percentile(trips, 100),
                self._writes, waiting, self._disagreements, self._disagreement_ns * 1e-9,
                max((each for _, each in self._silences), key=lambda each: each.duration, default=Silence()),
            )  # fmt: skip


def _percentile(ordered: list[int], percent: int) -> float:
    """Percentile of sorted times [ns] by the nearest-rank method, in seconds."""
    return ordered[-(-len(ordered) * percent // 100) - 1] * 1e-9 if ordered else 0.0
