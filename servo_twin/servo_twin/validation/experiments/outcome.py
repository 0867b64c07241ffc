"""Result of an experiment: figures with bounds, and curves of its picture. Plain data, no drawing.

An experiment is a generator that yields its results in the order of table and picture: a `Row` for every figure with
its bound, a `Panel` for every coordinate system, a string for every note. The decorator `experiment` converts them to
an `Outcome`; `Judge` creates the rows of one subject.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, ParamSpec

import numpy as np
from numpy.typing import NDArray

BEYOND: Final = "beyond the reference design"
"""`Row.reference` of a property that the reference design does not have."""

NOT_SHOWN: Final = "not shown"
"""`Row.reference` of a property for which the reference design gives no figure."""


@dataclass(frozen=True)
class Bound:
    """Permitted interval of a measured value; None: unlimited."""

    minimum: float | None = None  # smallest permitted value, in the unit of the row
    maximum: float | None = None  # largest permitted value, in the unit of the row

    def holds(self, value: float | None) -> bool:
        """True if a value in the unit of the bound is within; false for None (no value) and NaN."""
        if value is None or math.isnan(value):
            return False
        return (self.minimum is None or value >= self.minimum) and (self.maximum is None or value <= self.maximum)

    def __str__(self) -> str:
        if self.minimum is None and self.maximum is None:
            return "none"
        if self.minimum is not None and self.maximum is not None:
            same = self.minimum == self.maximum
            return f"= {self.maximum:.6g}" if same else f"{self.minimum:.6g} .. {self.maximum:.6g}"
        return f">= {self.minimum:.6g}" if self.minimum is not None else f"<= {self.maximum:.6g}"


@dataclass(frozen=True)
class Row:
    """One measured figure against its bound."""

    name: str  # measured quantity
    reference: str  # value or description in the reference design
    measured: float | None  # None: no value, does not agree
    unit: str  # unit of `measured` and `bound`
    bound: Bound  # range for `measured`
    apart: float | None = None  # largest difference between the levels of a board; None: from the bound

    @property
    def agrees(self) -> bool:
        return self.bound.holds(self.measured)

    def as_dict(self, experiment: str, level: str = "") -> dict[str, Any]:
        """Entry of ``summary.json``."""
        usable = self.measured is not None and math.isfinite(self.measured)
        return {
            "experiment": experiment,
            "figure": self.name,
            "reference": self.reference,
            "measured": float(self.measured) if usable and self.measured is not None else None,
            "unit": self.unit,
            "bound": str(self.bound),
            "agrees": self.agrees,
            "level": level,
        }


@dataclass(frozen=True)
class Judge:
    """Creates the rows of one subject, whose name precedes the name of each figure."""

    subject: str = ""  # prefix including punctuation, such as ``"axis1, "``
    reference: str = BEYOND  # statement of the reference design, for rows without their own

    def __call__(
        self,
        name: str,
        measured: float | np.floating[Any] | None,
        unit: str = "",
        minimum: float | None = None,
        maximum: float | None = None,
        *,
        reference: str | None = None,
        apart: float | None = None,
    ) -> Row:
        """A figure with the bound `minimum` .. `maximum`, both in `unit`; None: unlimited."""
        value = None if measured is None else float(measured)
        return Row(
            self.subject + name,
            self.reference if reference is None else reference,
            value,
            unit,
            Bound(minimum, maximum),
            apart,
        )

    def near(
        self, name: str, measured: float, unit: str, target: float, tolerance: float, *, reference: str | None = None
    ) -> Row:
        """A figure with the bound `target` +/- `tolerance`, both in `unit`."""
        return self(name, measured, unit, target - tolerance, target + tolerance, reference=reference)

    def none(self, name: str, count: float, *, reference: str | None = None) -> Row:
        """A number of events that must be zero."""
        return self(name, count, "", 0.0, 0.0, reference=reference)

    def true(self, name: str, holds: bool, *, reference: str | None = None) -> Row:
        """A condition that must hold."""
        return self(name, holds, "", 1.0, 1.0, reference=reference)


@dataclass(frozen=True)
class Curve:
    """One line of a panel; `style` is a matplotlib format string such as ``"o"``."""

    label: str
    x: NDArray[np.float64]  # (n,)
    y: NDArray[np.float64]  # (n,)
    style: str = "-"


@dataclass(frozen=True)
class Panel:
    """One coordinate system of the picture."""

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of one experiment."""

    name: str  # name of the experiment
    rows: tuple[Row, ...]  # measured figures
    panels: tuple[Panel, ...]  # panels of the picture
    notes: tuple[str, ...] = ()  # conditions, and figures without a bound
    level: str = ""  # level of the boards

    @property
    def agrees(self) -> bool:
        return all(row.agrees for row in self.rows)

    def row(self, name: str) -> Row:
        """Row by name; raises `KeyError` if there is none."""
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(f"{self.name} has no row {name!r}: {[row.name for row in self.rows]}")


Item = Row | Panel | str
"""A figure, a coordinate system, or a note; empty notes are ignored."""

_P = ParamSpec("_P")


def experiment(name: str) -> Callable[[Callable[_P, Iterable[Item]]], Callable[_P, Outcome]]:
    """Decorator: converts a generator of items to an experiment of this name, which returns an `Outcome`."""

    def decorate(find: Callable[_P, Iterable[Item]]) -> Callable[_P, Outcome]:
        @functools.wraps(find)
        def run(*args: _P.args, **kwargs: _P.kwargs) -> Outcome:
            items = list(find(*args, **kwargs))
            rows = tuple(item for item in items if isinstance(item, Row))
            panels = tuple(item for item in items if isinstance(item, Panel))
            return Outcome(name, rows, panels, tuple(item for item in items if isinstance(item, str) and item))

        return run

    return decorate
