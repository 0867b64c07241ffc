"""Limits the rate of log messages about refused commands."""

from __future__ import annotations


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
