"""Time shift between two runs: at a common event, or the one with which their speeds fit best."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace

from servo_twin.runs.curves import TIME, Curves, collected
from servo_twin.runs.recorded import RunError

FIT, RESET, START = "fit", "reset", "start"
"""Ways to align; another text is the name of a variable, whose first change is the event."""

_SPAN: Final = 120.0  # beginning of both runs that the fit uses [s]
_STEP: Final = 0.005  # of the correlation [s]
_FINE: Final = 0.0001  # of the fit [s]
_SPEEDS: Final = tuple(f"{axis_name(axis)}.speed" for axis in range(AXES))

_Array = NDArray[np.float64]


def shift_of(reference: Curves, other: Curves, way: str) -> float:
    """Time to add to those of `other` [s].

    Raises
    ------
    RunError
        If a run does not have the event, or nothing moves.
    """
    if way == RESET:
        return 0.0
    if way == FIT:
        return _fit(reference, other)
    return _event(reference, way) - _event(other, way)


def _event(run: Curves, way: str) -> float:
    if way == START:
        for block in run.blocks(_SPEEDS):
            return float(block[TIME][0])
        raise RunError(f"{run.path} contains no samples")
    first: float | None = None
    for block in run.blocks([way]):
        if way not in block.columns:
            raise RunError(f"{run.path} has no variable {way}; align at one that it has, or with {FIT}")
        column = block[way]
        first = float(column[0]) if first is None else first
        changed = np.flatnonzero(column != first)
        if len(changed):
            return float(block[TIME][changed[0]])
    raise RunError(f"{run.path}: {way} does not change; align at another variable, or with {FIT}")


def _fit(reference: Curves, other: Curves) -> float:
    """Shift of the best correlation of the speeds, refined by the smallest mean square."""
    first, second = _beginning(reference), _beginning(other)
    grids = [np.arange(each[TIME][0], each[TIME][-1], _STEP) for each in (first, second)]
    size = 1 << (len(grids[0]) + len(grids[1])).bit_length()
    correlation = np.zeros(size)
    for name in _SPEEDS:
        a, b = (np.interp(grid, each[TIME], each[name]) for grid, each in zip(grids, (first, second), strict=True))
        correlation += np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    if not correlation.max() > 0.0:
        raise RunError(f"{reference.path} and {other.path}: nothing moves in the first {_SPAN:g} s; align with {RESET}")
    lag = int(np.argmax(correlation))
    lag -= size if lag > size // 2 else 0
    coarse = float(grids[0][0] - grids[1][0]) + lag * _STEP
    return min(_candidates(coarse), key=lambda shift: _mean_square(first, second, shift))


def _candidates(coarse: float) -> Iterator[float]:
    """Shifts near the best correlation; first whole slow ticks, at which equal runs coincide."""
    span = 2.0 * _STEP
    tick = 0.0005
    return chain(
        (tick * k for k in range(round((coarse - span) / tick), round((coarse + span) / tick) + 1)),
        np.arange(coarse - span, coarse + span, _FINE).tolist(),
    )


def _mean_square(first: Trace, second: Trace, shift: float) -> float:
    time = first[TIME]
    moved = second[TIME] + shift
    common = (time >= moved[0]) & (time <= moved[-1])
    if not common.any():
        return float("inf")
    return sum(
        float(np.mean((first[name][common] - np.interp(time[common], moved, second[name])) ** 2)) for name in _SPEEDS
    )


def _beginning(run: Curves) -> Trace:
    """The speeds of the first `_SPAN`."""
    speeds = collected(run, _SPEEDS, _SPAN)
    missing = [name for name in _SPEEDS if name not in speeds.columns]
    if missing:
        raise RunError(f"{run.path} has no {', '.join(missing)}; align with {RESET} or {START}")
    return speeds
