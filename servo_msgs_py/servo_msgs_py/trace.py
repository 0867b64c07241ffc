"""Samples of several quantities at the same instants: recordings of a board, of a twin, and of true values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Trace:
    """Samples of all columns at the same instants; the columns cannot be changed.

    Raises
    ------
    ValueError
        If there is no column, or their lengths differ.
    """

    step: float  # time between two samples [s]; 0: not known or not constant, and `time` counts samples
    columns: Mapping[str, NDArray[Any]]  # by name of the variable, each (samples,); SI, or the raw words of flags
    first: int = 0  # number of the first sample; sample 0 is at time zero
    units: Mapping[str, str] = field(default_factory=dict)  # of columns whose unit is not given by their names

    def __post_init__(self) -> None:
        if len({column.shape for column in self.columns.values()}) != 1:
            shapes = {name: column.shape for name, column in self.columns.items()}
            raise ValueError(f"a trace needs columns of the same length, not {shapes}")
        columns = {name: column.view() for name, column in self.columns.items()}
        for column in columns.values():
            column.flags.writeable = False
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return next(iter(self.columns.values())).size

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Column of a variable, shape (samples,)."""
        return self.columns[name]

    @cached_property
    def time(self) -> NDArray[np.float64]:
        """Time of every sample [s], shape (samples,); its number if `step` is not known."""
        return (self.step or 1.0) * np.arange(self.first, self.first + len(self), dtype=np.float64)

    def part(self, start: float, end: float | None = None) -> Trace:
        """Samples after `start` and up to `end` [s]; `time` is not shifted."""
        begin, stop = (None if at is None else max(round(at / self.step) + 1 - self.first, 0) for at in (start, end))
        return self.samples(begin or 0, stop)

    def samples(self, begin: int, end: int | None = None) -> Trace:
        """Samples from index `begin` to before `end`; `time` is not shifted."""
        columns = {name: column[begin:end] for name, column in self.columns.items()}
        return replace(self, columns=columns, first=self.first + begin)

    def changed(self, **columns: NDArray[Any]) -> Trace:
        """The same samples with other or additional columns."""
        return replace(self, columns={**self.columns, **columns})

    def table(self, names: Iterable[str] | None = None) -> NDArray[np.float64]:
        """Columns side by side, by default all, shape (samples, names)."""
        chosen = self.columns if names is None else names
        return np.column_stack([self.columns[name].astype(np.float64) for name in chosen])

    def head(self, name: str) -> str:
        """Name of a column with its unit."""
        return with_unit(name, self.units.get(name, ""))


def with_unit(name: str, unit: str) -> str:
    """Heading of a column, label of a curve: ``axis1.i_q [A]``."""
    return f"{name} [{unit}]" if unit else name
