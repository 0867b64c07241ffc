"""Limits the rate of log messages about events that repeat, and counts the events."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass


@dataclass
class Burst:
    """Events of one kind that follow each other."""

    text: str  # of the first one
    begin: float  # time of the first one [s]
    end: float  # time of the newest one [s]
    tokens: float  # messages that may be logged now
    count: int = 0
    suppressed: int = 0  # of them without a message


class Throttle:
    """Token bucket for each kind of event; a pause ends the burst and fills its bucket.

    Parameters
    ----------
    burst : int
        Messages without limitation.
    rate : float
        Rate after that [1/s].
    pause : float
        Time without an event that ends a burst [s].
    """

    def __init__(self, burst: int = 1, rate: float = 0.0, pause: float = 1.0) -> None:
        self._burst = float(burst)
        self._rate = rate
        self._pause = pause
        self._bursts: dict[Hashable, Burst] = {}

    def admit(self, key: Hashable, now: float, text: str = "") -> bool:
        """Count an event at a time [s]; returns whether it may be logged."""
        burst = self._bursts.get(key)
        if burst is None or now - burst.end > self._pause:
            burst = self._bursts[key] = Burst(text, now, now, self._burst)
        burst.tokens = min(self._burst, burst.tokens + (now - burst.end) * self._rate)
        burst.end = now
        burst.count += 1
        if burst.tokens < 1.0:
            burst.suppressed += 1
            return False
        burst.tokens -= 1.0
        return True

    def ended(self, now: float) -> list[Burst]:
        """Remove the bursts that have ended before a time [s]; returns those with suppressed messages."""
        ended = [key for key, one in self._bursts.items() if now - one.end > self._pause]
        return [burst for burst in map(self._bursts.pop, ended) if burst.suppressed]
