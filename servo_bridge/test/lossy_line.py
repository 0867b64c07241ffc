"""A line in simulated time that loses, delays and damages what it carries. For tests."""

from __future__ import annotations

import random
from collections.abc import Callable

from fake_transport import FakeTransport

MS = 1_000_000


class LossyLine(FakeTransport):
    """A target at the end of a bad line; like a real one it answers one request after the other.

    Parameters
    ----------
    feed : callable
        The target.
    baud : int
        Speed of the line [bit/s].
    seed : int
        Of all that is random.
    """

    def __init__(self, feed: Callable[[bytes], bytes], baud: int = 115_200, seed: int = 1) -> None:
        super().__init__(self._carried)
        self.feed = feed
        self.random = random.Random(seed)
        self.byte_ns = 10_000_000_000 // baud
        self.turnaround_ns: Callable[[], int] = lambda: MS // 5
        self.lose_request = 0.0
        self.lose_answer = 0.0
        self.damage = 0.0
        self.lost = 0
        self.damaged = 0
        self._busy_until = 0

    def _carried(self, request: bytes) -> list[tuple[int, bytes]]:
        arrived = self.now + len(request) * self.byte_ns
        if self.random.random() < self.lose_request:
            self.lost += 1
            return []
        answer = self.feed(self._damaged(request))
        if not answer or self.random.random() < self.lose_answer:
            self.lost += bool(answer)
            return []
        self._busy_until = max(arrived, self._busy_until) + self.turnaround_ns() + len(answer) * self.byte_ns
        return [(self._busy_until - self.now, self._damaged(answer))]

    def _damaged(self, frame: bytes) -> bytes:
        """Change one byte, or drop it."""
        if self.random.random() >= self.damage:
            return frame
        self.damaged += 1
        place, byte = self.random.randrange(len(frame)), bytes([self.random.randrange(256)])
        return frame[:place] + (byte if self.random.randrange(4) else b"") + frame[place + 1 :]
