"""``servo-sim identify --trials``: random motors, each from unknown to identified, against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from servo_msgs_py.measurement.motor_values import Limits

from servo_twin.identification.motors import random_motor
from servo_twin.identification.session import identified, measure_virtual, tuned_table
from servo_twin.level import Level
from servo_twin.plant import PlantConfig

AIMS: Final[Mapping[str, float]] = {
    "r_s": 0.03,
    "l_d": 0.03,
    "l_q": 0.03,
    "psi_m": 0.03,
    "inertia": 0.05,
    "friction": 0.10,
}
"""Relative errors that 95 % of the motors should stay within."""

TIME_MAX: Final = 60.0  # board time per axis [s]


@dataclass(frozen=True)
class Trial:
    """One motor."""

    errors: Mapping[str, float]  # relative errors by name
    covered: Mapping[str, bool]  # whether the 95 % interval holds the truth, by name
    seconds: float  # time of the board [s]
    problems: tuple[str, ...]  # why it was not identified; empty: success
    tuned: str  # why no configuration works; empty: one does

    @property
    def false_success(self) -> bool:
        """Whether success was reported with a value that is far off."""
        return not self.problems and any(abs(self.errors.get(name, 1.0)) > 3.0 * aim for name, aim in AIMS.items())


@dataclass(frozen=True)
class Trials:
    """Numbered random motors, to be run anywhere."""

    plant: PlantConfig  # for all but the motor
    base: Mapping[str, Any]  # parsed ``servo.toml``
    axis: int
    limits: Limits
    level: Level  # of the boards that are measured
    seed: int

    def run(self, number: int) -> Trial:
        seed = self.seed + number
        plant = random_motor(self.plant, self.axis, seed)
        truth = plant.axes[self.axis]
        log, problem = measure_virtual(plant, self.axis, self.limits, self.base, level=self.level, seed=seed)
        result = identified(log, self.plant, problem, level=self.level)
        errors, covered = {}, {}
        for name in (*AIMS, "viscous", "pole_pairs"):
            if name in result.estimates.values:
                estimate, true = result.estimates.values[name], float(getattr(truth, name))
                errors[name] = estimate.value / true - 1.0
                low, high = estimate.interval
                covered[name] = low <= true <= high
        tuned = ""
        if not result.problems:
            table, lines = tuned_table(self.base, result, self.limits)
            tuned = "" if table is not None else lines[0]
        return Trial(errors, covered, float(log.notes.get("seconds", 0.0)), result.problems, tuned)


def summary(trials: Sequence[tuple[int, Trial]]) -> list[str]:
    """Lines about all of them."""
    done = [trial for _, trial in trials if not trial.problems]
    lines = [f"{len(trials)} motors: {len(done)} identified, {len(trials) - len(done)} not, with a reason"]
    lines.append("              within aim    |error| 50 %     95 %      max   interval covers")
    for name in (*AIMS, "viscous"):
        errors = np.array([abs(trial.errors[name]) for trial in done if name in trial.errors])
        if not errors.size:
            continue
        covered = np.mean([trial.covered[name] for trial in done if name in trial.covered])
        aim = AIMS.get(name)
        within = "" if aim is None else f"{100 * np.mean(errors <= aim):.1f} % < {100 * aim:g} %"
        half, maximum = np.percentile(errors, (50, 95))
        figures = f"{100 * half:12.2f} % {100 * maximum:7.2f} % {100 * errors.max():7.2f} % {100 * covered:10.1f} %"
        lines.append(f"{name:10} {within:>15}  {figures}")
    seconds = np.array([trial.seconds for _, trial in trials])
    lines.append(
        f"time of the board: median {np.median(seconds):.1f} s, longest {seconds.max():.1f} s (at most {TIME_MAX:g} s)"
    )
    false = [number for number, trial in trials if trial.false_success]
    lines.append(f"false success: {len(false)}" + (f" (motors {', '.join(map(str, false))})" if false else ""))
    refused = [(number, trial.tuned) for number, trial in trials if trial.tuned]
    lines.append(f"identified, but no configuration works: {len(refused)}")
    lines += [f"  motor {number}: {reason}" for number, reason in refused]
    lines += [f"not identified, motor {number}: {trial.problems[0]}" for number, trial in trials if trial.problems]
    return lines
