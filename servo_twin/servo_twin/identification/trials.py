"""``servo-sim identify --trials``: identification of random motors, with errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from servo_measurement.motor_values import Limits
from servo_msgs_py.table_text import aligned

from servo_twin.identification.session import identified, measure_virtual, tuned_table
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.random_motor import random_motor, with_random_inverter

TARGETS: Final[Mapping[str, float]] = {
    "r_s": 0.03,
    "l_d": 0.03,
    "l_q": 0.03,
    "psi_m": 0.03,
    "inertia": 0.05,
    "friction": 0.10,
}
"""Target of the relative errors for 95 % of the motors."""

TIME_MAX: Final = 60.0  # board time per axis [s]


@dataclass(frozen=True)
class Trial:
    """Result for one motor."""

    errors: Mapping[str, float]  # relative errors by name
    covered: Mapping[str, bool]  # true if the 95 % interval contains the true value, by name
    seconds: float  # board time [s]
    problems: tuple[str, ...]  # reasons for no identification; empty: success
    tuned: str  # reason for no feasible configuration; empty: feasible

    @property
    def false_success(self) -> bool:
        """True if success was reported with an error above three times the target."""
        return not self.problems and any(
            abs(self.errors.get(name, 1.0)) > 3.0 * target for name, target in TARGETS.items()
        )


def random_case(plant: PlantConfig, axis: int, limits: Limits, seed: int, number: int) -> tuple[PlantConfig, Limits]:
    """A plant with a random motor and inverter, and the limits with its voltage and current."""
    motor = random_motor(seed, number)
    real = with_random_inverter(motor.at(plant, axis), axis, seed, number)
    return real, dataclasses.replace(limits, voltage=motor.voltage, current=motor.current)


@dataclass(frozen=True)
class Trials:
    """Numbered random motors; can be pickled."""

    plant: PlantConfig  # all values except those of the motor
    base: Mapping[str, Any]  # parsed ``servo.toml``
    axis: int
    limits: Limits  # voltage and current are those of each motor
    level: Level  # level of the measured boards
    seed: int
    refined: bool = True  # whether the estimates are refined by simulation

    def run(self, number: int) -> Trial:
        plant, limits = random_case(self.plant, self.axis, self.limits, self.seed, number)
        truth = plant.axes[self.axis]
        log, problem = measure_virtual(plant, self.axis, limits, self.base, level=self.level, seed=self.seed)
        result = identified(log, self.plant, problem, refined=self.refined, level=self.level)
        errors, covered = {}, {}
        for name in (*TARGETS, "viscous", "pole_pairs"):
            if name in result.estimates.values:
                estimate, true = result.estimates.values[name], float(getattr(truth, name))
                errors[name] = estimate.value / true - 1.0
                low, high = estimate.interval
                covered[name] = low <= true <= high
        problems, tuned = tuple(map(str, result.problems)), ""
        if not problems:
            table, lines = tuned_table(self.base, result, limits)
            tuned = "" if table is not None else lines[0]
        return Trial(errors, covered, float(log.notes.get("seconds", 0.0)), problems, tuned)


def summary(trials: Sequence[tuple[int, Trial]]) -> list[str]:
    """Summary as lines of text."""
    done = [trial for _, trial in trials if not trial.problems]
    lines = [f"{len(trials)} motors: {len(done)} identified, {len(trials) - len(done)} not identified, with a reason"]
    rows = [["", "within target", "bias", "scatter", "|error| 95 %", "max", "interval covers"]]
    for name in (*TARGETS, "viscous"):
        errors = np.array([trial.errors[name] for trial in done if name in trial.errors])
        if not errors.size:
            continue
        covered = np.mean([trial.covered[name] for trial in done if name in trial.covered])
        target = TARGETS.get(name)
        within = "" if target is None else f"{100 * np.mean(np.abs(errors) <= target):.1f} % < {100 * target:g} %"
        large, largest = np.percentile(np.abs(errors), (95, 100))
        figures = (f"{100 * figure:.2f} %" for figure in (errors.std(), large, largest))
        rows.append([name, within, f"{100 * errors.mean():+.2f} %", *figures, f"{100 * covered:.1f} %"])
    lines += aligned(rows, "<>")
    seconds = np.array([trial.seconds for _, trial in trials])
    lines.append(f"board time: median {np.median(seconds):.1f} s, maximum {seconds.max():.1f} s (limit {TIME_MAX:g} s)")
    false = [number for number, trial in trials if trial.false_success]
    lines.append(f"false success: {len(false)}" + (f" (motors {', '.join(map(str, false))})" if false else ""))
    refused = [(number, trial.tuned) for number, trial in trials if trial.tuned]
    lines.append(f"identified, but no feasible configuration: {len(refused)}")
    lines += [f"  motor {number}: {reason}" for number, reason in refused]
    lines += [f"not identified, motor {number}: {trial.problems[0]}" for number, trial in trials if trial.problems]
    return lines
