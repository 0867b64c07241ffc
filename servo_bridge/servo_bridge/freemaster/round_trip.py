"""Timeout of a response, from the measured delays of previous ones."""

from __future__ import annotations

from typing import Final

_FLOOR_NS: Final = 1_500_000
"""Smallest margin: delays of a computer and of an adapter in low-latency mode."""

_PEAK_LIFE: Final = 64
"""Decay of a late response, in number of responses to a third: on a busy computer few are late, but by much."""


class RoundTrip:
    """Estimate of the delay of target and adapters in addition to the time on the line.

    Mean and mean deviation are smoothed as in TCP (RFC 6298). The time on the line is known and not included, so that
    one estimate applies to requests of all lengths. The peak of recent delays is used, too. Every loss doubles the
    timeout until the next response.

    Parameters
    ----------
    limit_ns : int
        Longest wait in addition to the time on the line [ns]; also the initial value.
    """

    def __init__(self, limit_ns: int) -> None:
        self.limit_ns = limit_ns
        self._mean: int | None = None
        self._deviation = 0
        self._peak = 0
        self._shift = 0

    @property
    def allowance_ns(self) -> int:
        """Timeout in addition to the time on the line [ns]."""
        if self._mean is None:
            return self.limit_ns
        usual = self._mean + max(4 * self._deviation, _FLOOR_NS)
        return min(max(usual, self._peak) << self._shift, self.limit_ns)

    def stalled(self) -> None:
        """Use the longest timeout next: the target is probably slow, or the line has errors."""
        while self.allowance_ns < self.limit_ns:
            self._shift += 1

    def answered(self, extra_ns: int) -> None:
        """Process the delay [ns] of a complete response to a single request, without the time on the line."""
        extra_ns = min(max(extra_ns, 0), self.limit_ns)
        if self._mean is None:
            self._mean, self._deviation = extra_ns, extra_ns // 2
        else:
            self._deviation += (abs(extra_ns - self._mean) - self._deviation) // 4
            self._mean += (extra_ns - self._mean) // 8
        self._peak = max(extra_ns, self._peak - self._peak // _PEAK_LIFE)
        self._shift = 0

    def late(self, delay_ns: int) -> None:
        """Process the delay [ns] of a response that came after its timeout: the next timeouts include it."""
        self._peak = max(self._peak, min(delay_ns, self.limit_ns))

    def lost(self) -> None:
        """Double the next timeout after a lost response."""
        if self.allowance_ns < self.limit_ns:
            self._shift += 1
