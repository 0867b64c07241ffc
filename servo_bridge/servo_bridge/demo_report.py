"""Figures of the demonstration as a table for people and as JSON. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from servo_msgs_py.units import COUNTS_PER_TURN

from servo_bridge.move_metrics import MoveFigures

__all__ = ["Residual", "Row", "passed", "report", "table"]

_COUNTS = COUNTS_PER_TURN / (2.0 * math.pi)
_COLUMNS = (
    "move", "axis", "commanded", "reached", "error", "settling", "overshoot", "tracking rms", "max",
    "twin rms", "max", "",
)  # fmt: skip
_UNITS = ("", "", "turns", "turns", "counts", "ms", "counts", "counts", "", "counts", "", "")


@dataclass(frozen=True)
class Residual:
    """Real minus twin position over a move [rad]."""

    rms: float
    max: float
    samples: int


@dataclass(frozen=True)
class Row:
    """One axis in one move."""

    move: str
    axis: str
    figures: MoveFigures
    residual: Residual | None


def table(rows: Sequence[Row]) -> str:
    """Rows laid out in columns, with a line of units below the heading."""
    cells = [_COLUMNS, _UNITS, *(tuple(_cells(row)) for row in rows)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(_COLUMNS))]
    lines = [
        "  ".join(
            cell.ljust(width) if k < 2 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    ]
    return "\n".join([*lines[:2], "-" * max(map(len, lines)), *lines[2:]])


def _cells(row: Row) -> Iterable[str]:
    f = row.figures
    yield row.move
    yield row.axis
    yield f"{_turns(f.commanded):.4f}"
    yield f"{_turns(f.reached):.4f}"
    yield f"{f.error * _COUNTS:+.1f}"
    yield "never" if f.settling_time is None else f"{f.settling_time * 1e3:.0f}"
    yield f"{f.overshoot * _COUNTS:.1f}"
    yield _counts(f.tracking_rms)
    yield _counts(f.tracking_max)
    yield _counts(None if row.residual is None else row.residual.rms)
    yield _counts(None if row.residual is None else row.residual.max)
    yield "ok" if f.arrived else "NOT REACHED"


def _turns(angle: float) -> float:
    return angle / (2.0 * math.pi)


def _counts(angle: float | None) -> str:
    return "-" if angle is None else f"{angle * _COUNTS:.1f}"


def passed(rows: Sequence[Row], *, twin: bool) -> bool:
    """True when there are rows, every axis got there, and the twin, if there is one, sent data for every move."""
    return bool(rows) and all(row.figures.arrived and (row.residual is not None or not twin) for row in rows)


def report(rows: Sequence[Row], *, tolerance_counts: float, twin: bool) -> dict[str, Any]:
    """Everything as plain numbers, SI, ready for JSON."""
    return {
        "passed": passed(rows, twin=twin),
        "twin": twin,
        "tolerance_counts": tolerance_counts,
        "counts_per_turn": COUNTS_PER_TURN,
        "moves": [
            {
                "move": row.move,
                "axis": row.axis,
                **asdict(row.figures),
                "residual": None if row.residual is None else asdict(row.residual),
            }
            for row in rows
        ],
    }
