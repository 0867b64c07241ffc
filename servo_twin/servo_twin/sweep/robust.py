"""Gains that suit a set of plants: candidates from Optuna, each judged on the nominal plant and on the worst.

Two objectives, a figure on the nominal plant and the worst of it over all plants, and one constraint: in no more trials
than with today's gains may a figure leave its bound or the experiment fail. The answer is a front of candidates, of
which none is better in both.
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
from servo_twin.sweep.space import Space, Varied
from servo_twin.sweep.trial import Trial, trial_at
from servo_twin.sweep.variant import Base

BATCH: Final = 8
"""Candidates that are tried at once. The sampler learns from whole batches: the number of workers changes nothing."""

Candidate = Mapping[str, float]


@dataclass(frozen=True)
class Objective:
    """The figure that is to become small, or large."""

    figure: str  # name of a row of the experiment
    direction: Literal["minimize", "maximize"] = "minimize"

    @property
    def worst_of(self) -> Callable[[Sequence[float]], float]:
        """Function that picks the worst of several figures."""
        return max if self.direction == "minimize" else min

    @property
    def absent(self) -> float:
        """Worse than every value."""
        return math.inf if self.direction == "minimize" else -math.inf

    def better(self, one: float, other: float) -> bool:
        """Whether figure `one` is better than `other` (same unit)."""
        return one < other if self.direction == "minimize" else one > other


@dataclass(frozen=True)
class Score:
    """What a candidate is worth."""

    candidate: Candidate  # its values by name; empty: the present ones
    nominal: float  # figure on the nominal plant; infinite: it did not happen
    mean: float  # over all plants, likewise
    worst: float  # of all plants, likewise
    violations: int  # trials with a figure outside its bound, or that could not be run

    @classmethod
    def of(cls, candidate: Candidate, objective: Objective, trials: Sequence[Trial]) -> Score:
        """Score from the trials on the nominal plant (the first) and on all others."""

        def value(trial: Trial) -> float:
            figure = trial.figures.get(objective.figure)
            return objective.absent if figure is None or figure.value is None else figure.value

        values = [value(trial) for trial in trials]
        violations = sum(bool(t.problem) or not all(f.inside for f in t.figures.values()) for t in trials)
        return cls(candidate, values[0], sum(values) / len(values), objective.worst_of(values), violations)


@dataclass(frozen=True)
class Candidates:
    """Every candidate on every plant: trial number = candidate x plants + plant, plant 0 being the nominal one."""

    measure: str  # name of an experiment
    base: Base  # nominal plant and configuration
    plants: Space  # the other plants
    level: Level
    candidates: tuple[Candidate, ...]

    @property
    def each(self) -> int:
        """Trials of a candidate."""
        return self.plants.count + 1

    def run(self, number: int) -> Trial:
        which, plant = divmod(number, self.each)
        point = {**self.candidates[which], **(self.plants.point(plant - 1) if plant else {})}
        return trial_at(number, self.measure, self.base, point, self.plants.seed, self.level)

    def scores(self, objective: Objective, runner: Runner, what: str) -> list[Score]:
        """Score of each candidate.

        Raises
        ------
        SimulationError
            If the experiment has no such figure.
        """
        trials = run_in_order(runner, self, range(len(self.candidates) * self.each), what)
        parts = [trials[k : k + self.each] for k in range(0, len(trials), self.each)]
        return [Score.of(c, objective, part) for c, part in zip(self.candidates, parts, strict=True)]


def search(
    evaluate: Callable[[Sequence[Candidate]], Sequence[Score]],
    tuned: Sequence[Varied],
    objective: Objective,
    today: Score,
    count: int,
    seed: int,
) -> Iterator[Score]:
    """Scores of so many candidates as they are found.

    Parameters
    ----------
    evaluate : callable
        Scores of candidates.
    tuned : sequence of Varied
        What candidates differ in: levels or ranges.
    objective : Objective
    today : Score
        Of the present gains; no candidate may have more violations.
    count : int
    seed : int
        Of the sampler.

    Raises
    ------
    SimulationError
        If Optuna is not installed.
    """
    try:
        optuna: Any = importlib.import_module("optuna")
    except ImportError:
        raise SimulationError("this needs Optuna: pip install 'servo_twin[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)

    sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
    study = optuna.create_study(directions=[objective.direction] * 2, sampler=sampler)
    for first in range(0, count, BATCH):
        asked = [study.ask() for _ in range(min(BATCH, count - first))]
        scores = evaluate([{one.name: _suggest(trial, one) for one in tuned} for trial in asked])
        for trial, score in zip(asked, scores, strict=True):
            trial.set_constraint("violations", score.violations - today.violations)
            study.tell(trial, [score.nominal, score.worst])
            yield score


def _suggest(trial: Any, one: Varied) -> float:
    if one.levels:
        return float(trial.suggest_categorical(one.name, one.levels))
    return float(trial.suggest_float(one.name, one.low, one.high, log=one.kind == "log"))


def front(scores: Sequence[Score], objective: Objective, today: Score) -> list[Score]:
    """Scores without more violations than today's of which no other is better in both objectives, best worst first."""
    allowed = [s for s in scores if s.violations <= today.violations and math.isfinite(s.worst)]
    kept: list[Score] = []
    for score in sorted(allowed, key=lambda s: (s.worst, s.nominal), reverse=objective.direction == "maximize"):
        if not kept or objective.better(score.nominal, kept[-1].nominal):
            kept.append(score)
    return kept
