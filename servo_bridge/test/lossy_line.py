"""A line in simulated time that loses, delays and damages frames."""

from __future__ import annotations

import random
from collections.abc import Callable

from fake_transport import FakeTransport

MS = 1_000_000


class LossyLine(FakeTransport):
    """A target on a bad line; it answers requests one after the other.

    Parameters
    ----------
    feed : callable
        Maps a request to the answer of the target.
    baud : int
        Speed of the line [bit/s].
    seed : int
        Seed of the random numbers.
    """

    def __init__(self, feed: Callable[[bytes], bytes], baud: int = 115_200, seed: int = 1) -> None:
        super().__init__(self._transfer)
        self.feed = feed
        self.random = random.Random(seed)
        self.byte_ns = 10_000_000_000 // baud
        self.turnaround_ns: Callable[[], int] = lambda: MS // 5
        self.lose_request = 0.0
        self.lose_answer = 0.0
        self.damage = 0.0
        self.half_duplex = False  # whether the target ignores a request that arrives while it sends an answer
        self.lost = 0
        self.damaged = 0
        self._busy_until = 0
        self._answer_begin = 0  # time of its first byte [ns]

    def _transfer(self, request: bytes) -> list[tuple[int, bytes]]:
        arrived = self.now + len(request) * self.byte_ns
        if self.random.random() < self.lose_request:
            self.lost += 1
            return []
        if self.half_duplex and self.now < self._busy_until and self._answer_begin < arrived:
            return []
        answer = self.feed(self._damaged(request))
        if not answer or self.random.random() < self.lose_answer:
            self.lost += bool(answer)
            return []
        self._answer_begin = max(arrived, self._busy_until) + self.turnaround_ns()
        self._busy_until = self._answer_begin + len(answer) * self.byte_ns
        return [(self._busy_until - self.now, self._damaged(answer))]

    def _damaged(self, frame: bytes) -> bytes:
        """Change or drop one byte, with probability `damage`."""
        if self.random.random() >= self.damage:
            return frame
        self.damaged += 1
        index, byte = self.random.randrange(len(frame)), bytes([self.random.randrange(256)])
        return frame[:index] + (byte if self.random.randrange(4) else b"") + frame[index + 1 :]
