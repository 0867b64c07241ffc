"""Figures of the demonstration as text tables and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from servo_measurement.step_response import StepFigures
from servo_msgs_py.table_text import aligned
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_bridge.path_metrics import PathFigures

_COUNTS = COUNTS_PER_TURN / (2.0 * math.pi)
_COLUMNS = (
    "move", "axis", "commanded", "reached", "error", "settling", "overshoot", "tracking rms", "max",
    "twin rms", "max", "",
)  # fmt: skip
_UNITS = ("", "", "turns", "turns", "counts", "ms", "counts", "counts", "", "counts", "", "")
_PATH_COLUMNS = (
    "path", "axis", "duration", "following rms", "max", "max", "at the end", "axes apart", "twin rms", "max", "",
)  # fmt: skip
_PATH_UNITS = ("", "", "s", "counts", "counts", "mrad", "counts", "ticks", "counts", "", "")


@dataclass(frozen=True)
class Residual:
    """Real minus twin position over a move [rad]."""

    rms: float  # [rad]
    max: float  # largest magnitude [rad]
    samples: int


@dataclass(frozen=True)
class Row:
    """One axis in one move."""

    move: str
    axis: str
    figures: StepFigures
    residual: Residual | None


@dataclass(frozen=True)
class PathRow:
    """All axes on one path."""

    path: str  # title
    axes: tuple[str, ...]  # joints of the path
    figures: PathFigures  # of the motion along it
    error_max: float  # permitted distance from the path [rad]
    tolerance: float  # permitted error of the mean position after the end [rad]
    residuals: tuple[Residual, ...]  # per joint; empty without a twin

    def followed(self, axis: int) -> bool:
        """True if an axis followed the path, started synchronously, and stayed at the end."""
        f = self.figures
        near = f.error_max[axis] <= self.error_max and abs(f.end_error[axis]) <= self.tolerance
        return near and f.ticks_apart == 0


def table(rows: Sequence[Row]) -> str:
    """Table of moves, with a line of units below the heading."""
    return _laid_out([_COLUMNS, _UNITS, *(tuple(_cells(row)) for row in rows)])


def path_table(rows: Sequence[PathRow]) -> str:
    """Table of paths, one line per axis."""
    lines = [tuple(_path_cells(row, axis)) for row in rows for axis in range(len(row.axes))]
    return _laid_out([_PATH_COLUMNS, _PATH_UNITS, *lines])


def _laid_out(cells: Sequence[Sequence[str]]) -> str:
    lines = aligned(cells, "<<>")
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


def _path_cells(row: PathRow, axis: int) -> Iterable[str]:
    f = row.figures
    residual = row.residuals[axis] if row.residuals else None
    yield row.path
    yield row.axes[axis]
    yield f"{f.duration:.2f}"
    yield _counts(f.error_rms[axis])
    yield _counts(f.error_max[axis])
    yield f"{f.error_max[axis] * 1e3:.1f}"
    yield f"{f.end_error[axis] * _COUNTS:+.1f}"
    yield str(f.ticks_apart)
    yield _counts(None if residual is None else residual.rms)
    yield _counts(None if residual is None else residual.max)
    yield "ok" if row.followed(axis) else "NOT FOLLOWED"


def _turns(angle: float) -> float:
    return angle / (2.0 * math.pi)


def _counts(angle: float | None) -> str:
    return "-" if angle is None else f"{angle * _COUNTS:.1f}"


def passed(rows: Sequence[Row], paths: Sequence[PathRow], *, twin: bool) -> bool:
    """True if every axis reached its targets and followed its paths, and the twin, if any, sent data for every row."""
    moved = bool(rows) and all(row.figures.arrived and (row.residual is not None or not twin) for row in rows)
    followed = all(all(map(row.followed, range(len(row.axes)))) and (bool(row.residuals) or not twin) for row in paths)
    return moved and bool(paths) and followed


def report(
    rows: Sequence[Row], paths: Sequence[PathRow], *, tolerance_counts: float, twin: bool, speed: float
) -> dict[str, Any]:
    """All figures as numbers in SI units, for JSON; `speed` is board time per real time."""
    return {
        "passed": passed(rows, paths, twin=twin),
        "twin": twin,
        "board_time_per_real_time": speed,
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
        "paths": [
            {
                "path": row.path,
                "axes": row.axes,
                **asdict(row.figures),
                "residuals": [asdict(residual) for residual in row.residuals],
            }
            for row in paths
        ],
    }
