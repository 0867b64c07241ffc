"""Summary of a sweep: range of every figure, and the worst trials."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from servo_msgs_py.table_text import aligned

from servo_twin.validation.sweep.trial import Figure, Trial

WORST: Final = 3
"""Number of listed trials per figure."""


@dataclass
class FigureSummary:
    """Running statistics of one figure over all trials."""

    unit: str
    count: int = 0  # trials with this figure
    absent: int = 0  # trials without a value
    outside: int = 0  # trials outside the bound
    mean: float = 0.0  # in `unit`
    minimum: float = math.inf  # in `unit`
    maximum: float = -math.inf  # in `unit`
    worst: list[tuple[float, int]] = field(default_factory=list)  # -slack and -number of the worst trials, a heap

    def add(self, number: int, figure: Figure) -> None:
        self.count += 1
        if figure.value is None:
            self.absent += 1
        else:
            self.mean += (figure.value - self.mean) / (self.count - self.absent)
            self.minimum, self.maximum = min(self.minimum, figure.value), max(self.maximum, figure.value)
        if figure.slack is not None:
            self.outside += not figure.inside
            entry = (-figure.slack, -number)
            (heapq.heappush if len(self.worst) < WORST else heapq.heappushpop)(self.worst, entry)

    def worst_trials(self) -> list[int]:
        """Numbers of the worst trials, sorted."""
        return [-number for _, number in sorted(self.worst, reverse=True)]


class Summary:
    """Summary of a sweep."""

    def __init__(self, trials: Iterable[Trial]) -> None:
        self.trials = 0  # number of trials
        self.figures: dict[str, FigureSummary] = {}  # by name
        self.problems: dict[str, tuple[int, int]] = {}  # by reason: number of trials, first trial
        for trial in trials:
            self.trials += 1
            for name, figure in trial.figures.items():
                self.figures.setdefault(name, FigureSummary(figure.unit)).add(trial.number, figure)
            if trial.problem:
                count, first = self.problems.get(trial.problem, (0, trial.number))
                self.problems[trial.problem] = (count + 1, first)

    def lines(self, replay: str) -> list[str]:
        """Summary as text.

        Parameters
        ----------
        replay : str
            Command that repeats a trial, without the trial number.
        """
        rows = [["figure", "mean", "min", "max", "outside", "unit"]]
        for name, f in self.figures.items():
            numbers = [f.mean, f.minimum, f.maximum] if f.count > f.absent else [math.nan] * 3
            rows.append([name, *(f"{number:.4g}" for number in numbers), str(f.outside), f.unit])
        lines = aligned(rows, "<>>>><")
        outside = [(name, f) for name, f in self.figures.items() if f.outside]
        if outside:
            lines += ["", "worst trials outside a bound:"]
            lines += [
                f"  {replay} {number}  # {name}" for name, f in outside for number in f.worst_trials()[: f.outside]
            ]
        if self.problems:
            lines += ["", "failed:"]
            ranked = sorted(self.problems.items(), key=lambda item: -item[1][0])[: 2 * WORST]
            lines += [f"  {count} trials: {problem}\n    {replay} {first}" for problem, (count, first) in ranked]
        return lines
