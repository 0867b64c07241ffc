"""Comparison of the figures of the experiments at both levels of the board."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.output_file import write_file
from servo_msgs_py.table_text import aligned

from servo_twin.level import Level
from servo_twin.validation.experiments.outcome import Bound, Outcome, Row

NOT_COMPARED: Final = frozenset({"motor-campaign", "hidden-change", "resonance"})
"""Experiments that have been measured at one level only, or whose number of figures depends on oscillations that grow
from noise."""

HELP: Final = """\
All experiments on the ideal chip with the averaged plant, and again on the registers with the switching plant. A
figure agrees if it is within its bound at each level, and the difference of the levels is not larger than the width of
the bound, or its absolute value if it is one-sided; a few figures define their own tolerance for effects that only one
of the plants has."""

LEVELS: Final[tuple[Level, Level]] = ("ideal", "registers")
FILE: Final = "levels.json"
_HEAD: Final = ("figure", *LEVELS, "difference", "unit", "bound", "agrees")


def permitted_difference(bound: Bound) -> float:
    """Permitted difference of two values for a bound, in its unit."""
    if bound.minimum is not None and bound.maximum is not None:
        return bound.maximum - bound.minimum
    return math.inf if bound.maximum is None else abs(bound.maximum)


@dataclass(frozen=True)
class Pair:
    """A figure at both levels."""

    experiment: str
    figure: str
    ideal: Row | None  # row at level ideal; None: the experiment failed
    registers: Row | None  # row at level registers; None: the experiment failed

    @property
    def unit(self) -> str:
        return next((row.unit for row in (self.ideal, self.registers) if row is not None), "")

    @property
    def difference(self) -> float | None:
        """Value at level registers minus value at level ideal, in the unit of the figure."""
        first = self.ideal.measured if self.ideal is not None else None
        second = self.registers.measured if self.registers is not None else None
        return None if first is None or second is None else second - first

    @property
    def difference_max(self) -> float | None:
        """Permitted difference, in the unit of the figure."""
        rows = [row for row in (self.ideal, self.registers) if row is not None]
        if len(rows) < len(LEVELS):
            return None
        return max(permitted_difference(row.bound) if row.apart is None else row.apart for row in rows)

    @property
    def relative_difference(self) -> float:
        """Difference relative to the permitted one; 0 without a value or a limit."""
        difference, maximum = _finite(self.difference), _finite(self.difference_max)
        if not difference or maximum is None:
            return 0.0
        return abs(difference) / maximum if maximum > 0.0 else math.inf

    @property
    def agrees(self) -> bool:
        rows = (self.ideal, self.registers)
        difference, maximum = self.difference, self.difference_max
        if difference is None or maximum is None:
            return False
        return all(row is not None and row.agrees for row in rows) and abs(difference) <= maximum

    def as_dict(self) -> dict[str, Any]:
        """Entry of ``levels.json``."""

        def side(row: Row | None) -> dict[str, Any] | None:
            if row is None:
                return None
            return {"measured": _finite(row.measured), "bound": str(row.bound), "agrees": row.agrees}

        return {
            "experiment": self.experiment,
            "figure": self.figure,
            "unit": self.unit,
            "ideal": side(self.ideal),
            "registers": side(self.registers),
            "difference": _finite(self.difference),
            "difference_max": _finite(self.difference_max),
            "agrees": self.agrees,
        }


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def pairs(ideal: Outcome, registers: Outcome) -> list[Pair]:
    """Figures of one experiment at both levels, matched by their names."""
    first, second = ({row.name: row for row in outcome.rows} for outcome in (ideal, registers))
    names = [*first, *(name for name in second if name not in first)]
    return [Pair(ideal.name, name, first.get(name), second.get(name)) for name in names]


def _cells(pair: Pair) -> tuple[str, ...]:
    rows = (pair.ideal, pair.registers)
    values = [_text(row.measured if row is not None else None) for row in rows]
    bounds = dict.fromkeys(str(row.bound) if row is not None else "none" for row in rows)
    agrees = "yes" if pair.agrees else "NO"
    return pair.figure, *values, _text(pair.difference), pair.unit, "; ".join(bounds), agrees


def _text(value: float | None) -> str:
    return "none" if value is None or not math.isfinite(value) else f"{value:.4g}"


def table(name: str, every: Sequence[Pair]) -> str:
    """Figures of one experiment as text; with different bounds the bound of level ideal comes first."""
    lines = [_HEAD, *(_cells(pair) for pair in every if pair.experiment == name)]
    return "\n".join([name, "", *(f"  {row}" for row in aligned(lines))]) + "\n"


def overview(every: Sequence[Pair]) -> str:
    """Markdown table: figures of each experiment, and the one with the largest difference relative to the permitted."""
    rows = ["| experiment | figures | agree | largest difference | ideal | registers | bound |"]
    rows.append("|---|---:|---:|---|---|---|---|")
    for name in dict.fromkeys(pair.experiment for pair in every):
        own = [pair for pair in every if pair.experiment == name]
        measured = [pair for pair in own if _finite(pair.difference) is not None]
        largest = max(measured, key=lambda pair: (pair.relative_difference, abs(pair.difference or 0.0)), default=None)
        figure, cells = "none has values at both levels", [""] * 3
        if largest is not None and largest.difference == 0.0:
            figure = "none differs"
        elif largest is not None:
            figure, sides = largest.figure, [row for row in (largest.ideal, largest.registers) if row is not None]
            cells = [f"{_text(side.measured)} {largest.unit}".strip() for side in sides]
            cells.append("; ".join(dict.fromkeys(str(side.bound) for side in sides)))
        agree = sum(pair.agrees for pair in own)
        rows.append(f"| `{name}` | {len(own)} | {agree} | {figure} | {' | '.join(cells)} |")
    agree = sum(pair.agrees for pair in every)
    rows.append(f"| all | {len(every)} | {agree} | | | | |")
    return "\n".join(rows) + "\n"


def write(folder: Path, every: Sequence[Pair]) -> Path:
    """Write ``levels.json``, and the `overview` as ``levels.md``; returns the path of the first."""
    path = folder / FILE
    write_file(
        path, json.dumps([pair.as_dict() for pair in every], indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    )
    write_file(path.with_suffix(".md"), overview(every))
    return path
