"""Comparison of a run with another one, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.trace import Trace

from servo_twin.lockstep.samples import PER_BOARD
from servo_twin.runs.curves import TIME, Curves
from servo_twin.runs.recorded import RunError

_Array = NDArray[np.float64]

Watch = Callable[[Trace, Mapping[str, _Array]], None]
"""Gets a block of the reference and the other run at its times, NaN outside it."""


@dataclass
class Difference:
    """Largest difference of one variable."""

    variable: str
    unit: str
    noise: float  # largest difference of a healthy pair [SI]; 0: not known
    size: float = 0.0  # reference minus other run, of the largest magnitude [SI]
    time: float = 0.0  # of the reference then [s]
    beyond: float | None = None  # first time beyond the noise [s]; None: never, or not known

    @property
    def ratio(self) -> float:
        """Size in units of the noise; 0 if that is not known."""
        return abs(self.size) / self.noise if self.noise else 0.0


@dataclass
class Compared:
    """Result of a comparison."""

    differences: list[Difference]  # largest first, in units of the noise; then those without known noise
    shift: float  # added to the times of the other run [s]
    samples: int  # of the reference that were compared
    start: float  # first compared time of the reference [s]
    end: float  # last one [s]

    @property
    def beyond_noise(self) -> bool:
        """Whether a variable differs by more than a healthy pair."""
        return any(one.ratio > 1.0 for one in self.differences)


def compare(
    reference: Curves, other: Curves, shift: float, bands: Mapping[str, float], watch: Watch | None = None
) -> Compared:
    """Compare a run at the times of the reference.

    Parameters
    ----------
    reference, other : Curves
    shift : float
        Added to the times of `other` [s].
    bands : mapping
        Noise by variable [SI].
    watch : callable, optional
        Gets everything, for output.

    Raises
    ------
    RunError
        If the runs have no time or no variable in common.
    """
    catalogue = Catalogue.load()
    found: dict[str, Difference] = {}
    resampled = _Resampled(other, shift, catalogue)
    samples, start, end = 0, np.inf, -np.inf
    for block in reference.blocks():
        time = block[TIME]
        values = resampled.at(time)
        inside = resampled.inside(time)
        if watch is not None:
            watch(block, values)
        if not inside.any():
            continue
        samples += int(inside.sum())
        start, end = min(start, float(time[inside][0])), float(time[inside][-1])
        for name, column in values.items():
            if name not in block.columns:
                continue
            if name not in found:
                variable = catalogue.variables.get(name.partition("[")[0])
                found[name] = Difference(name, variable.unit if variable else "", bands.get(name, 0.0))
            _note(found[name], time[inside], (block[name] - column)[inside])
    if not found:
        raise RunError(f"{reference.path} and {other.path} have no time in common with a shift of {shift:.4f} s")
    order = sorted(found.values(), key=lambda one: (-one.ratio, -abs(one.size)))
    return Compared(order, shift, samples, start, end)


def _note(found: Difference, time: _Array, difference: _Array) -> None:
    largest = int(np.argmax(np.abs(difference)))
    if abs(difference[largest]) > abs(found.size):
        found.size, found.time = float(difference[largest]), float(time[largest])
    if found.noise and found.beyond is None:
        beyond = np.flatnonzero(np.abs(difference) > found.noise)
        found.beyond = float(time[beyond[0]]) if len(beyond) else None


class _Resampled:
    """A run at the times of another one: linear between samples; the last value of states and flags."""

    def __init__(self, run: Curves, shift: float, catalogue: Catalogue) -> None:
        self._blocks = _moved(run.blocks(), shift)
        self._catalogue = catalogue
        self._present: Trace | None = next(self._blocks, None)

    def at(self, time: _Array) -> dict[str, _Array]:
        """Values at rising times, all later than those of the last call; NaN outside the run and in its gaps."""
        self._fetch(time)
        present = self._present
        if present is None:
            return {}
        inside = self.inside(time)
        return {
            name: np.where(inside, self._column(name, present, time), np.nan)
            for name in present.columns
            if name != TIME and name not in PER_BOARD
        }

    def inside(self, time: _Array) -> NDArray[np.bool_]:
        """Which of the times of the last call are within the run, and not in a gap of it."""
        if self._present is None:
            return np.zeros(len(time), np.bool_)
        own = self._present[TIME]
        before = np.maximum(np.searchsorted(own, time + _ROUNDING, side="right") - 1, 0)
        after = np.minimum(np.searchsorted(own, time - _ROUNDING), len(own) - 1)
        steps = np.diff(own)[np.diff(own) > 0.0]
        gap = _GAP * np.median(steps) if len(steps) else np.inf
        within = (time >= own[0] - _ROUNDING) & (time <= own[-1] + _ROUNDING)
        return np.asarray(within & (own[after] - own[before] <= gap))

    def _column(self, name: str, present: Trace, time: _Array) -> _Array:
        variable = self._catalogue.variables.get(name.partition("[")[0])
        own = present[TIME]
        if variable is not None and (variable.enum or variable.flags):
            index = np.searchsorted(own, time + _ROUNDING, side="right") - 1
            return np.asarray(present[name][np.clip(index, 0, len(own) - 1)], np.float64)
        return np.asarray(np.interp(time, own, present[name]))

    def _fetch(self, time: _Array) -> None:
        """Read on until the present samples reach beyond these times, and forget earlier ones."""
        parts = [] if self._present is None else [self._present]
        while parts and parts[-1][TIME][-1] < time[-1]:
            following = next(self._blocks, None)
            if following is None:
                break
            parts.append(following)
        if not parts:
            return
        names = [name for name in parts[0].columns if all(name in part.columns for part in parts)]
        whole = Trace(0.0, {name: np.concatenate([part[name] for part in parts]) for name in names})
        begin = int(np.searchsorted(whole[TIME], time[0] - _ROUNDING, side="right")) - 1
        self._present = whole.samples(max(begin, 0))


_ROUNDING: Final = 1e-7  # of sums of times [s]
_GAP: Final = 1.5  # smallest gap, in which nothing is compared, in usual distances of two samples


def _moved(blocks: Iterator[Trace], shift: float) -> Iterator[Trace]:
    return (block.changed(**{TIME: block[TIME] + shift}) for block in blocks)


def table(compared: Compared, count: int = 10) -> list[Sequence[str]]:
    """Rows of the largest differences."""
    rows: list[Sequence[str]] = [["variable", "largest", "at [s]", "in noise", "beyond noise from [s]"]]
    for one in compared.differences[:count]:
        ratio = f"{one.ratio:.2g}" if one.noise else ""
        beyond = "" if one.beyond is None else f"{one.beyond:.3f}"
        rows.append([one.variable, f"{one.size:+.3g} {one.unit}".rstrip(), f"{one.time:.3f}", ratio, beyond])
    return rows
