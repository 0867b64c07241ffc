"""What an experiment hands back: judged figures and the curves of its picture. Plain data, no drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["BEYOND", "Bound", "Curve", "Outcome", "Panel", "Row"]

BEYOND: Final = "beyond the reference design"
"""`Row.seed` of what it does not have."""


@dataclass(frozen=True)
class Bound:
    """Interval that a measured value has to lie in; an end that is None is open.

    Attributes
    ----------
    least, most : float or None
        Smallest and largest value that agrees, in the unit of the row.
    """

    least: float | None = None
    most: float | None = None

    def holds(self, value: float | None) -> bool:
        """Whether a value lies within; None (there was nothing to measure) and NaN never do."""
        if value is None or math.isnan(value):
            return False
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)

    def __str__(self) -> str:
        if self.least is None and self.most is None:
            return "none"
        if self.least is not None and self.most is not None:
            same = self.least == self.most
            return f"= {self.most:.6g}" if same else f"{self.least:.6g} .. {self.most:.6g}"
        return f">= {self.least:.6g}" if self.least is not None else f"<= {self.most:.6g}"


@dataclass(frozen=True)
class Row:
    """One measured figure against its bound.

    Attributes
    ----------
    name : str
        What was measured.
    seed : str
        What the reference design states or shows about it.
    measured : float or None
        None: it did not happen, which never agrees.
    unit : str
        Unit of `measured` and `bound`.
    bound : Bound
        Where `measured` has to lie.
    apart : float or None
        How far the two levels of a board may be apart; None: as far as the bound allows.
    """

    name: str
    seed: str
    measured: float | None
    unit: str
    bound: Bound
    apart: float | None = None

    @property
    def agrees(self) -> bool:
        return self.bound.holds(self.measured)

    def as_dict(self, experiment: str, level: str = "") -> dict[str, Any]:
        """Entry of ``summary.json``."""
        usable = self.measured is not None and math.isfinite(self.measured)
        return {
            "name": f"{experiment}: {self.name}",
            "seed": self.seed,
            "measured": float(self.measured) if usable and self.measured is not None else None,
            "unit": self.unit,
            "bound": str(self.bound),
            "agrees": self.agrees,
            "level": level,
        }


@dataclass(frozen=True)
class Curve:
    """One line of a panel; `style` is a matplotlib format string such as ``"o"``."""

    label: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    style: str = "-"


@dataclass(frozen=True)
class Panel:
    """One coordinate system of the picture."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of one experiment.

    Attributes
    ----------
    name : str
        Name of the experiment.
    rows : tuple of Row
        Measured figures.
    panels : tuple of Panel
        Its picture.
    notes : tuple of str
        What else there is to know: conditions, figures without a bound.
    level : str
        Of the boards that it ran on.
    """

    name: str
    rows: tuple[Row, ...]
    panels: tuple[Panel, ...]
    notes: tuple[str, ...] = ()
    level: str = ""

    @property
    def agrees(self) -> bool:
        return all(row.agrees for row in self.rows)

    def row(self, name: str) -> Row:
        """The row of a name; a `KeyError` names those that exist."""
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(f"{self.name} has no row {name!r}: {[row.name for row in self.rows]}")
