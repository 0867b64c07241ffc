"""Buffers: curves at full rate, shaft angles of the 3D view at 30 Hz."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD

_Array = NDArray[np.float64]

_GAP: Final = 0.5  # gap of the data that interrupts a curve [s]
_FRAME: Final = 1.0 / 30.0  # interval of shaft angles [s]


class Curves:
    """Curves of one source, with common times."""

    def __init__(self) -> None:
        self._points: dict[str, tuple[list[_Array], list[_Array]]] = {}
        self._last: float | None = None

    def add(self, times: _Array, points: Mapping[str, _Array]) -> None:
        """Append points; the curves are interrupted at a gap of `_GAP` and at a step back in time.

        Parameters
        ----------
        times : ndarray
            Times, not empty [s].
        points : mapping
            Values of every curve at these times.
        """
        last = self._last
        gap = last is not None and not -_GAP < times[0] - last < _GAP
        self._last = float(times[-1])
        for name, values in points.items():
            pending = self._points.setdefault(name, ([], []))
            if gap and last is not None:
                pending[0].append(np.array([last + PERIOD]))
                pending[1].append(np.array([np.nan]))
            pending[0].append(times)
            pending[1].append(values)

    def take(self) -> dict[str, tuple[_Array, _Array]]:
        """Times [s] and values [SI], each (points,), of all curves with new points since the last call."""
        taken = {
            name: (np.concatenate(times), np.concatenate(values)) for name, (times, values) in self._points.items()
        }
        self._points.clear()
        return taken


class ShaftAngle:
    """Decimated angle of a shaft."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._angles: list[float] = []
        self._next = -np.inf

    def add(self, times: _Array, angles: _Array) -> None:
        """Add angles [rad]; one per `_FRAME` is stored."""
        if times[0] < self._next - 2.0 * _FRAME:
            self._next = -np.inf  # step back in time
        position = 0
        while (position := position + int(np.searchsorted(times[position:], self._next))) < len(times):
            self._times.append(float(times[position]))
            self._angles.append(float(angles[position]))
            self._next = float(times[position]) + _FRAME

    def take(self) -> tuple[_Array, _Array]:
        """Times [s] and angles [rad], each (points,), since the last call."""
        taken = np.array(self._times), np.array(self._angles)
        self._times.clear()
        self._angles.clear()
        return taken
