"""How long to wait for an answer, from how long the answers before took. Pure."""

from __future__ import annotations

from typing import Final

_FLOOR_NS: Final = 1_500_000
"""Least margin: what a computer and an adapter in low-latency mode may be late."""

_PEAK_LIFE: Final = 64
"""Answers after which a late one is forgotten by two thirds: on a busy computer few are late, and those by far."""


class RoundTrip:
    """Running estimate of what the target and the adapters add to the time on the wire.

    Mean and mean deviation are smoothed as those of TCP are (RFC 6298); the time on the wire is known and is not part
    of them, so that one estimate serves requests of every length. The latest of the last answers counts as well. Every
    loss doubles the wait, until an answer comes.

    Parameters
    ----------
    limit_ns : int
        Longest wait beyond the time on the wire [ns]; also the first one, while nothing is known.
    """

    def __init__(self, limit_ns: int) -> None:
        self.limit_ns = limit_ns
        self._mean: int | None = None
        self._deviation = 0
        self._peak = 0
        self._shift = 0

    @property
    def allowance_ns(self) -> int:
        """How long to wait beyond the time on the wire [ns]."""
        if self._mean is None:
            return self.limit_ns
        usual = self._mean + max(4 * self._deviation, _FLOOR_NS)
        return min(max(usual, self._peak) << self._shift, self.limit_ns)

    def stalled(self) -> None:
        """Wait as long as possible next time: the target seems to be slow, or the line to be bad."""
        while self.allowance_ns < self.limit_ns:
            self._shift += 1

    def answered(self, extra_ns: int) -> None:
        """Take the time beyond that on the wire [ns] after which an answer to a single request was complete."""
        extra_ns = min(max(extra_ns, 0), self.limit_ns)
        if self._mean is None:
            self._mean, self._deviation = extra_ns, extra_ns // 2
        else:
            self._deviation += (abs(extra_ns - self._mean) - self._deviation) // 4
            self._mean += (extra_ns - self._mean) // 8
        self._peak = max(extra_ns, self._peak - self._peak // _PEAK_LIFE)
        self._shift = 0

    def lost(self) -> None:
        """Wait twice as long next time: an answer has not come."""
        if self.allowance_ns < self.limit_ns:
            self._shift += 1
