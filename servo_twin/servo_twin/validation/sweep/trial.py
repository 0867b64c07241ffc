"""One trial of a sweep: an experiment on a variant of the plant and the configuration."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from servo_msgs_py.catalogue import AXES

from servo_twin.level import Level
from servo_twin.plant import PlantConfig, PlantError
from servo_twin.simulation import SimulationError, enable, move, turns
from servo_twin.validation.experiments import EXPERIMENTS
from servo_twin.validation.experiments.outcome import BEYOND, Bound, Outcome, Row
from servo_twin.validation.experiments.rig import at_level, fresh_board, prepared
from servo_twin.validation.sweep.space import Space
from servo_twin.validation.sweep.variant import Base

MOVE: Final = "move"
MOVE_TURNS: Final = 1.0
MOVE_TIME: Final = 0.5  # [s]
OPEN: Final = Bound()


def _move(plant: PlantConfig, seed: int) -> Outcome:
    """Move of both axes by one revolution, without bounds, except that all figures must have a value."""
    with fresh_board(plant, seed) as board:
        search = enable(board)
        results, _ = move(board, {axis: turns(MOVE_TURNS) for axis in range(AXES)}, MOVE_TIME)
    rows = [Row("both rotors found", BEYOND, 1e3 * search, "ms", OPEN)]
    for r in results:
        settling = None if r.settling_time is None else 1e3 * r.settling_time
        rows += [
            Row(f"{r.axis} settling time", BEYOND, settling, "ms", OPEN),
            Row(f"{r.axis} overshoot", BEYOND, float(r.overshoot), "counts", OPEN),
            Row(f"{r.axis} steady state", BEYOND, float(r.steady_state), "counts", OPEN),
            Row(f"{r.axis} largest speed", BEYOND, r.speed_max, "rad/s", OPEN),
            Row(f"{r.axis} largest i_q", BEYOND, r.i_q_max, "A", OPEN),
        ]
    return Outcome(MOVE, tuple(rows), ())


MEASURES: Final[Mapping[str, Callable[[PlantConfig, int], Outcome]]] = {
    MOVE: _move,
    **{name: entry.run for name, entry in EXPERIMENTS.items()},
}
"""Measurements of a trial, by name: a short move, or an experiment."""


@dataclass(frozen=True)
class Figure:
    """A measured figure."""

    value: float | None  # None: no value
    unit: str
    slack: float | None  # relative distance to the nearer limit; < 0: outside; None: no bound

    @property
    def inside(self) -> bool:
        """True within the bound."""
        return self.slack is None or self.slack >= 0.0

    @classmethod
    def of(cls, row: Row) -> Figure:
        """Figure of a row; without a value the slack is -infinity."""
        value = row.measured if row.measured is not None and math.isfinite(row.measured) else None
        if value is None:
            return cls(None, row.unit, -math.inf)
        ends = ((row.bound.minimum, 1.0), (row.bound.maximum, -1.0))
        slacks = [sign * (value - end) / (abs(end) or 1.0) for end, sign in ends if end is not None]
        return cls(float(value), row.unit, float(min(slacks)) if slacks else None)


@dataclass(frozen=True)
class Trial:
    """Result of a trial."""

    number: int
    point: Mapping[str, float]  # varied values, by name
    figures: Mapping[str, Figure]  # by name; empty if the trial failed
    problem: str = ""  # error of a failed trial

    def as_dict(self) -> dict[str, Any]:
        """Convert for the results file."""
        return dataclasses.asdict(self)

    @classmethod
    def of_dict(cls, entry: Mapping[str, Any]) -> Trial:
        """Create from an entry of the results file."""
        figures = {name: Figure(**figure) for name, figure in entry["figures"].items()}
        return cls(entry["number"], entry["point"], figures, entry["problem"])


def outcome_at(measure: str, base: Base, point: Mapping[str, float], seed: int, level: Level) -> Outcome:
    """Run an experiment with varied values.

    Raises
    ------
    SimulationError, PlantError
        If the experiment cannot be run.
    """
    variant = base.variant(point)
    with at_level(level), prepared(variant.prepare):
        return MEASURES[measure](variant.plant, seed)


def trial_at(number: int, measure: str, base: Base, point: Mapping[str, float], seed: int, level: Level) -> Trial:
    """Run a trial; an error is stored in `Trial.problem`."""
    try:
        rows = outcome_at(measure, base, point, seed, level).rows
    except (SimulationError, PlantError) as error:
        return Trial(number, point, {}, str(error))
    return Trial(number, point, {row.name: Figure.of(row) for row in rows})


@dataclass(frozen=True)
class Sweep:
    """All trials of a sweep; can be pickled."""

    measure: str  # name of `MEASURES`
    base: Base  # nominal plant and configuration
    space: Space  # points of the trials
    level: Level  # level of the boards

    def outcome(self, number: int) -> Outcome:
        """Complete outcome of the experiment in a trial; see `outcome_at`."""
        return outcome_at(self.measure, self.base, self.space.point(number), self.space.seed, self.level)

    def run(self, number: int) -> Trial:
        return trial_at(number, self.measure, self.base, self.space.point(number), self.space.seed, self.level)
