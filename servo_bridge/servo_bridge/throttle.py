"""Keeps a stream of wrong commands from flooding the log. Pure."""

from __future__ import annotations


class Throttle:
    """Token bucket per key.

    Parameters
    ----------
    burst : int
        Lines that may come at once.
    rate : float
        Lines per second after that [1/s].
    """

    def __init__(self, burst: int, rate: float) -> None:
        self._burst = float(burst)
        self._rate = rate
        self._buckets: dict[str, tuple[float, float, int]] = {}  # tokens, time, lines held back

    def admit(self, key: str, now: float) -> int | None:
        """Ask for a line.

        Parameters
        ----------
        key : str
            What the line is about.
        now : float
            Steady time [s].

        Returns
        -------
        int or None
            None: hold it back. Otherwise how many were held back since the last one that was let through.
        """
        tokens, last, held = self._buckets.get(key, (self._burst, now, 0))
        tokens = min(self._burst, tokens + (now - last) * self._rate)
        if tokens < 1.0:
            self._buckets[key] = (tokens, now, held + 1)
            return None
        self._buckets[key] = (tokens - 1.0, now, 0)
        return held
