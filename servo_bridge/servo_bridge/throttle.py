"""Limits the rate of log messages about refused commands."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass


class Throttle:
    """Token bucket for each key.

    Parameters
    ----------
    burst : int
        Messages without limitation.
    rate : float
        Rate after that [1/s].
    """

    def __init__(self, burst: int, rate: float) -> None:
        self._burst = float(burst)
        self._rate = rate
        self._buckets: dict[str, tuple[float, float, int]] = {}  # tokens, time, suppressed messages

    def admit(self, key: str, now: float) -> int | None:
        """Check whether a message may be logged.

        Parameters
        ----------
        key : str
            Subject of the message.
        now : float
            Steady time [s].

        Returns
        -------
        int or None
            None: suppress the message. Otherwise the number of suppressed messages since the last one.
        """
        tokens, last, held = self._buckets.get(key, (self._burst, now, 0))
        tokens = min(self._burst, tokens + (now - last) * self._rate)
        if tokens < 1.0:
            self._buckets[key] = (tokens, now, held + 1)
            return None
        self._buckets[key] = (tokens - 1.0, now, 0)
        return held


@dataclass
class Repetition:
    """Equal events that follow each other."""

    text: str  # of the first one
    begin: float  # time of the first one [s]
    end: float  # time of the newest one [s]
    count: int = 1


class Repetitions:
    """Reports the first of equal events, and their number when they have ended.

    Parameters
    ----------
    pause : float
        Time without an event that ends them [s].
    """

    def __init__(self, pause: float) -> None:
        self._pause = pause
        self._running: dict[Hashable, Repetition] = {}

    def admit(self, key: Hashable, now: float, text: str) -> bool:
        """Count an event at a time [s]; returns whether it is the first one of its kind."""
        running = self._running.get(key)
        if running is None or now - running.end > self._pause:
            self._running[key] = Repetition(text, now, now)
            return True
        running.count += 1
        running.end = now
        return False

    def ended(self, now: float) -> list[Repetition]:
        """Remove and return the events that have ended before a time [s]."""
        ended = [key for key, one in self._running.items() if now - one.end > self._pause]
        return [self._running.pop(key) for key in ended]
