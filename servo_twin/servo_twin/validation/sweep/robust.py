"""Robust tuning for a set of plants: multi-objective optimisation of gains with Optuna.

Two objectives: a figure on the nominal plant, and its worst value over all plants. Constraint: not more violations (a
figure outside its bound, or a failed experiment) than with the present gains. The result is the Pareto front.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from servo_twin.level import Level
from servo_twin.runner import Runner, run_in_order
from servo_twin.simulation import SimulationError
from servo_twin.validation.sweep.space import Space, Varied
from servo_twin.validation.sweep.trial import Trial, trial_at
from servo_twin.validation.sweep.variant import Base

BATCH: Final = 8
"""Candidates per batch. The sampler is updated per batch, so that the result does not depend on the workers."""

Candidate = Mapping[str, float]


@dataclass(frozen=True)
class Objective:
    """The figure to minimise or maximise."""

    figure: str  # name of a row of the experiment
    direction: Literal["minimize", "maximize"] = "minimize"

    @property
    def worst_of(self) -> Callable[[Sequence[float]], float]:
        """Function that returns the worst of several figures."""
        return max if self.direction == "minimize" else min

    @property
    def absent(self) -> float:
        """Value of a missing figure: worse than every number."""
        return math.inf if self.direction == "minimize" else -math.inf

    def better(self, one: float, other: float) -> bool:
        """True if figure `one` is better than `other` (same unit)."""
        return one < other if self.direction == "minimize" else one > other


@dataclass(frozen=True)
class Score:
    """Results of a candidate."""

    candidate: Candidate  # values by name; empty: present gains
    nominal: float  # figure on the nominal plant; infinite: missing
    mean: float  # mean of the figure over all plants; infinite: missing
    worst: float  # worst figure of all plants; infinite: missing
    violations: int  # trials with a figure outside its bound, or failed

    @classmethod
    def of(cls, candidate: Candidate, objective: Objective, trials: Sequence[Trial]) -> Score:
        """Score from the trials on the nominal plant (first) and on the other plants."""

        def value(trial: Trial) -> float:
            figure = trial.figures.get(objective.figure)
            return objective.absent if figure is None or figure.value is None else figure.value

        values = [value(trial) for trial in trials]
        violations = sum(bool(t.problem) or not all(f.inside for f in t.figures.values()) for t in trials)
        return cls(candidate, values[0], sum(values) / len(values), objective.worst_of(values), violations)


@dataclass(frozen=True)
class Candidates:
    """All candidates on all plants: trial number = candidate * plants + plant; plant 0 is the nominal one."""

    measure: str  # name of an experiment
    base: Base  # nominal plant and configuration
    plants: Space  # the other plants
    level: Level
    candidates: tuple[Candidate, ...]

    @property
    def each(self) -> int:
        """Trials per candidate."""
        return self.plants.count + 1

    def run(self, number: int) -> Trial:
        candidate, plant = divmod(number, self.each)
        point = {**self.candidates[candidate], **(self.plants.point(plant - 1) if plant else {})}
        return trial_at(number, self.measure, self.base, point, self.plants.seed, self.level)

    def scores(self, objective: Objective, runner: Runner, what: str) -> list[Score]:
        """Score of each candidate.

        Raises
        ------
        SimulationError
            If a trial cannot be distributed or fails.
        """
        trials = run_in_order(runner, self, range(len(self.candidates) * self.each), what)
        parts = [trials[k : k + self.each] for k in range(0, len(trials), self.each)]
        return [Score.of(c, objective, part) for c, part in zip(self.candidates, parts, strict=True)]


def search(
    evaluate: Callable[[Sequence[Candidate]], Sequence[Score]],
    tuned: Sequence[Varied],
    objective: Objective,
    present: Score,
    count: int,
    seed: int,
) -> Iterator[Score]:
    """Optimise: yields the scores of `count` candidates.

    Parameters
    ----------
    evaluate : callable
        Scores of candidates.
    tuned : sequence of Varied
        Values to tune: levels or ranges.
    objective : Objective
    present : Score
        Score of the present gains; more violations are not permitted.
    count : int
    seed : int
        Seed of the sampler.

    Raises
    ------
    SimulationError
        If Optuna is not installed.
    """
    try:
        optuna: Any = importlib.import_module("optuna")
    except ImportError:
        raise SimulationError("tune-robust needs Optuna: `make extras`, or pip install 'servo_twin[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)

    sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
    study = optuna.create_study(directions=[objective.direction] * 2, sampler=sampler)
    for first in range(0, count, BATCH):
        suggestions = [study.ask() for _ in range(min(BATCH, count - first))]
        scores = evaluate([{one.name: _suggest(trial, one) for one in tuned} for trial in suggestions])
        for trial, score in zip(suggestions, scores, strict=True):
            trial.set_constraint("violations", score.violations - present.violations)
            study.tell(trial, [score.nominal, score.worst])
            yield score


def _suggest(trial: Any, one: Varied) -> float:
    if one.levels:
        return float(trial.suggest_categorical(one.name, one.levels))
    return float(trial.suggest_float(one.name, one.low, one.high, log=one.kind == "log"))


def front(scores: Sequence[Score], objective: Objective, present: Score) -> list[Score]:
    """Pareto front of the scores without additional violations, sorted by the worst figure."""
    permitted = [s for s in scores if s.violations <= present.violations and math.isfinite(s.worst)]
    pareto: list[Score] = []
    for score in sorted(permitted, key=lambda s: (s.worst, s.nominal), reverse=objective.direction == "maximize"):
        if not pareto or objective.better(score.nominal, pareto[-1].nominal):
            pareto.append(score)
    return pareto
