"""Figures of a step, with the range in which they are plausible."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from servo_msgs_py.table_text import aligned


@dataclass(frozen=True)
class Figure:
    """A measured number; plausible within its range, ends included. A number that is not finite is not plausible."""

    name: str
    value: float
    unit: str = ""
    low: float = -math.inf  # in the unit of the value
    high: float = math.inf
    remedy: str = ""  # what to check if it is not plausible

    @property
    def plausible(self) -> bool:
        return math.isfinite(self.value) and self.low <= self.value <= self.high

    @property
    def span(self) -> str:
        """Text of the range; empty without one."""
        if math.isinf(self.low):
            return "" if math.isinf(self.high) else f"at most {self.high:.4g}"
        return f"at least {self.low:.4g}" if math.isinf(self.high) else f"{self.low:.4g} .. {self.high:.4g}"

    def cells(self) -> list[str]:
        """Cells of a table: name, value, range, unit."""
        return [self.name, f"{self.value:.4g}", self.span, self.unit]

    def document(self) -> dict[str, Any]:
        """The figure for JSON, which has no infinite numbers."""
        ends = {name: end for name, end in (("low", self.low), ("high", self.high)) if math.isfinite(end)}
        value = self.value if math.isfinite(self.value) else None
        return {"name": self.name, "value": value, "unit": self.unit, **ends, "remedy": self.remedy}

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Figure:
        """The figure of `document`."""
        value = document["value"]
        return cls(**{**document, "value": math.nan if value is None else value})


class ImplausibleError(Exception):
    """A step has a figure outside its range; the text has name, value, range and remedy."""


def require(figures: Iterable[Figure]) -> None:
    """Check that all figures are plausible.

    Raises
    ------
    ImplausibleError
        With the first one that is not.
    """
    for one in figures:
        if not one.plausible:
            remedy = f": {one.remedy}" if one.remedy else ""
            raise ImplausibleError(f"{one.name} is {one.value:.4g} {one.unit}, not {one.span}".rstrip(", ") + remedy)


def lines(figures: Iterable[Figure]) -> list[str]:
    """Table of figures."""
    return aligned([one.cells() for one in figures], "<><")
