"""Points that wait to be written: curves in full, the angles of hands as often as an eye can see. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

_GAP: Final = 0.5  # silence that a curve does not bridge [s]
_FRAME: Final = 1.0 / 30.0  # between two pictures of a hand [s]
_TICK: Final = 62.5e-6  # times are whole ticks [s]


class Curves:
    """Curves of one source, which have their times in common."""

    def __init__(self) -> None:
        self._points: dict[str, tuple[list[_Array], list[_Array]]] = {}
        self._last: float | None = None

    def add(self, times: _Array, points: Mapping[str, _Array]) -> None:
        """Append points; where there were none for a while, or time went back, the curves are broken.

        Parameters
        ----------
        times : ndarray
            Not empty [s].
        points : mapping
            Values of every curve at these times.
        """
        last = self._last
        gap = last is not None and not -_GAP < times[0] - last < _GAP
        self._last = float(times[-1])
        for name, values in points.items():
            waiting = self._points.setdefault(name, ([], []))
            if gap and last is not None:
                waiting[0].append(np.array([last + _TICK]))
                waiting[1].append(np.array([np.nan]))
            waiting[0].append(times)
            waiting[1].append(values)

    def take(self) -> dict[str, tuple[_Array, _Array]]:
        """Times [s] and values [SI], each (points,), of every curve that got new points since the last call."""
        taken = {
            name: (np.concatenate(times), np.concatenate(values)) for name, (times, values) in self._points.items()
        }
        self._points.clear()
        return taken


class Hand:
    """Angle of a shaft, thinned out."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._angles: list[float] = []
        self._next = -np.inf

    def add(self, times: _Array, angles: _Array) -> None:
        """Take those of the angles [rad] that are due."""
        if times[0] < self._next - 2.0 * _FRAME:
            self._next = -np.inf  # time went back
        position = 0
        while (position := position + int(np.searchsorted(times[position:], self._next))) < len(times):
            self._times.append(float(times[position]))
            self._angles.append(float(angles[position]))
            self._next = float(times[position]) + _FRAME

    def take(self) -> tuple[_Array, _Array]:
        """Times [s] and angles [rad], each (points,), that are due since the last call."""
        taken = np.array(self._times), np.array(self._angles)
        self._times.clear()
        self._angles.clear()
        return taken
