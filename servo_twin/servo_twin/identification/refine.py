"""All values together, by simulation: what was done to the board is done to virtual boards until they answer the same.

The plant is that of the twin, the firmware the same C with the same configuration blocks, written at the same times. The
differences of currents, voltages and speeds are minimised over the values of the motor (output error).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.measurement.access import MeasurementError, Recording
from servo_msgs_py.measurement.log import MeasurementLog, repeat
from servo_msgs_py.measurement.motor_values import Estimate, MotorEstimates

from servo_twin.board import Board, BoardError
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.level import Level
from servo_twin.plant import PlantConfig, PlantError

__all__ = ["MODEL_ERROR", "REFINED", "Refinement", "plant_of", "refine", "simulated"]

Floats = NDArray[np.float64]

REFINED: Final = ("r_s", "l_d", "l_q", "psi_m", "inertia", "friction", "viscous", "load", "dead_voltage")
"""What is refined, in the order of the parameters."""

MODEL_ERROR: Final[Mapping[str, float]] = {
    "r_s": 0.002,
    "l_d": 0.002,
    "l_q": 0.002,
    "psi_m": 0.002,
    "inertia": 0.004,
    "friction": 0.01,
    "viscous": 0.02,
    "dead_voltage": 0.003,
}
"""Relative standard uncertainty that the model leaves, whatever the noise (doc/identify.md)."""

BATCH: Final = 40  # neighbouring samples whose residuals are not independent
STEP: Final = 0.01  # of a numerical derivative
ITERATIONS: Final = 5
FARTHEST: Final = 8.0  # a residual counts for no more than about so many times the usual one

_COMPARED: Final[Mapping[str, Sequence[str]]] = {
    "level": ("u_d",),
    "sweep_d": ("i_d", "u_d"),
    "sweep_q": ("i_q", "u_q"),
    "speed": ("i_q", "u_q", "speed"),
}
"""Columns that are compared, by the purpose of a recording."""

_AVERAGED: Final[Mapping[str, float]] = {"level": math.inf, "speed": 0.02}
"""Means over so many seconds count [s]: dead time makes a ripple of six periods per electrical turn, whose phase says
nothing about the motor."""


@dataclass(frozen=True)
class Refinement:
    """What came of it.

    Attributes
    ----------
    estimates : MotorEstimates
        With what was not refined as it was.
    before, after : mapping
        Root mean square of each signal's difference before and after [SI].
    simulated : list of Recording
        What a board with the refined values shows.
    """

    estimates: MotorEstimates
    before: Mapping[str, float]
    after: Mapping[str, float]
    simulated: list[Recording]


def plant_of(plant: PlantConfig, axis: int, values: Mapping[str, float], limits: Mapping[str, float]) -> PlantConfig:
    """A plant file's values with those of a motor.

    The lost voltage of a leg is dead time and drop together: the dead time stays that of `plant`, the drop takes the rest.
    """
    own = plant.axes[axis]
    changes: dict[str, Any] = {
        name: values[name] for name in ("r_s", "l_d", "l_q", "psi_m", "inertia", "friction", "viscous") if name in values
    }
    if "pole_pairs" in values:
        changes["pole_pairs"] = float(round(values["pole_pairs"]))
    if "dead_voltage" in values:
        dead = own.dead_time * plant.pwm_frequency * limits["voltage"]
        changes["v_drop"] = max(values["dead_voltage"] - dead, 0.0)
    changes["r_on"] = limits["r_on"]
    for name in ("friction", "viscous"):
        if name in changes:
            changes[name] = max(changes[name], 0.0)
    return plant.with_axis(axis, **changes)


def simulated(
    log: MeasurementLog, plant: PlantConfig, load: float, level: Level = "ideal", seed: int = 1
) -> list[Recording]:
    """What a virtual board with this plant shows, when all is done to it that was done to the real one.

    Raises
    ------
    MeasurementError
        If it cannot be done.
    """
    quiet = plant.with_axis(log.axis, i_noise=0.0, theta_start=0.0).with_bus(u_noise=0.0)
    try:
        with Board(quiet, seed=seed, level=level) as board:
            board.set_load(log.axis, load)
            board.run(float(log.notes.get("boot", 0.05)))
            return repeat(log, VirtualBoardAccess(board))
    except BoardError as error:
        raise MeasurementError(f"the simulation has failed: {error}") from None


class _Difference:
    """Differences of two sets of recordings as one vector; weighted, and without missing samples."""

    def __init__(self, log: MeasurementLog) -> None:
        self._name = axis_name(log.axis)
        self._log = log
        self.parts: list[tuple[int, str, NDArray[np.bool_], NDArray[np.int64]]] = []
        first_run = True
        for k, (label, recording) in enumerate(zip(log.labels, log.recordings, strict=True)):
            if label == "speed" and first_run:
                first_run = False  # the rotor search before it does not end at the same time
                continue
            for column in _COMPARED.get(label, ()):
                values = recording.columns[f"{self._name}.{column}"]
                usable = np.isfinite(values)
                every = min(max(round(_AVERAGED.get(label, 0.0) / recording.step), 1) if label != "level" else values.size, values.size)
                self.parts.append((k, column, usable, np.arange(values.size)[usable] // every))
        self.weights = [1.0] * len(self.parts)
        sizes = [np.unique(group).size for _, _, _, group in self.parts]
        self.batches = np.concatenate(
            [np.arange(size) // (BATCH if size > 500 else 4) + 1_000_000 * n for n, size in enumerate(sizes)] or [np.zeros(0, dtype=np.int64)]
        )

    def raw(self, shown: Sequence[Recording]) -> list[Floats]:
        result = []
        for k, column, usable, group in self.parts:
            key = f"{self._name}.{column}"
            difference = shown[k].columns[key][usable] - self._log.recordings[k].columns[key][usable]
            _, place, counts = np.unique(group, return_inverse=True, return_counts=True)
            result.append(np.bincount(place, difference) / counts)
        return result

    def vector(self, shown: Sequence[Recording]) -> Floats:
        parts = zip(self.raw(shown), self.weights, strict=True)
        return np.concatenate([part * weight for part, weight in parts])

    def weigh(self, shown: Sequence[Recording]) -> None:
        """Weights such that every signal's usual difference counts as 1."""
        groups: dict[tuple[str, str], list[Floats]] = {}
        labels = self._log.labels
        keys = [(labels[k], column) for k, column, _, _ in self.parts]
        raw = self.raw(shown)
        for key, part in zip(keys, raw, strict=True):
            groups.setdefault(key, []).append(part)
        usual = {key: _usual(np.concatenate(parts)) for key, parts in groups.items()}
        self.weights = [1.0 / usual[key] for key in keys]

    def rms(self, shown: Sequence[Recording]) -> dict[str, float]:
        """Root mean square of each signal's differences."""
        found: dict[str, list[Floats]] = {}
        for (_, column, _, _), part in zip(self.parts, self.raw(shown), strict=True):
            found.setdefault(column, []).append(part)
        return {column: float(np.sqrt((np.concatenate(parts) ** 2).mean())) for column, parts in found.items()}


def _usual(differences: Floats) -> float:
    """Robust standard deviation."""
    return max(1.4826 * float(np.median(np.abs(differences))), 1e-6)


def refine(
    log: MeasurementLog, first: MotorEstimates, plant: PlantConfig, report: Callable[[str], None] = lambda text: None
) -> Refinement:
    """Values of the motor from all recordings together.

    Parameters
    ----------
    log : MeasurementLog
        Of a motor test.
    first : MotorEstimates
        Closed-form estimates.
    plant : PlantConfig
        For all that is not estimated: bus, sensors.
    report : callable, optional
        Gets a line for each iteration.

    Raises
    ------
    MeasurementError
        If it cannot be simulated.
    """
    limits: Mapping[str, float] = log.notes["limits"]
    names = [name for name in REFINED if name in first.values]
    start = {name: estimate.value for name, estimate in first.values.items()}
    torque = 1.5 * start["pole_pairs"] * start["psi_m"] * limits["current"]
    top = max((float(np.nanmax(np.abs(r.columns[f"{axis_name(log.axis)}.speed"]))) for r in log.labelled("speed")))
    scale = {name: abs(start[name]) for name in names}
    scale["friction"] = max(scale.get("friction", 0.0), 0.003 * torque)
    scale["viscous"] = max(scale.get("viscous", 0.0), 0.5 * scale["friction"] / top)
    scale["load"] = scale["friction"]
    base = plant.with_bus(u_source=limits["voltage"])
    difference = _Difference(log)
    shown: dict[bytes, list[Recording]] = {}

    def values_of(x: Floats) -> dict[str, float]:
        return {**start, **{name: start[name] + x[k] * scale[name] for k, name in enumerate(names)}}

    def show(x: Floats) -> list[Recording]:
        key = x.tobytes()
        if key not in shown:
            values = values_of(x)
            try:
                found = simulated(log, plant_of(base, log.axis, values, limits), values.get("load", 0.0))
            except PlantError as error:
                raise MeasurementError(f"the estimates are no motor: {error}") from None
            shown[key] = found
        return shown[key]

    def jacobian(x: Floats, *_: object) -> Floats:
        middle = difference.vector(show(x))
        columns = []
        for k in range(x.size):
            moved = x.copy()
            moved[k] += STEP
            columns.append((difference.vector(show(moved)) - middle) / STEP)
        return np.column_stack(columns)

    x = np.zeros(len(names))
    before = difference.rms(show(x))
    result = None
    for _ in range(2):  # the second time with weights of what is left
        difference.weigh(show(x))
        result = least_squares(
            lambda y: difference.vector(show(y)),
            x,
            jac=jacobian,
            loss="soft_l1",
            f_scale=3.0,
            max_nfev=ITERATIONS,
            xtol=1e-4,
            ftol=1e-4,
            bounds=(-0.6, 1.5),
        )
        x = np.asarray(result.x, dtype=np.float64)
        report(f"refined by simulation: {', '.join(f'{name} {values_of(x)[name]:.4g}' for name in names)}")
    covariance = _covariance(jacobian(x), difference.vector(show(x)), difference.batches)
    found = dict(first.values)
    for k, name in enumerate(names):
        value = start[name] + x[k] * scale[name]
        sigma = math.sqrt(max(covariance[k, k], 0.0)) * scale[name]
        found[name] = Estimate(value, math.hypot(sigma, MODEL_ERROR.get(name, 0.0) * value))
    after = difference.rms(show(x))
    return Refinement(MotorEstimates(found, first.undetermined), before, after, show(x))


def _covariance(jacobian: Floats, residual: Floats, batches: NDArray[np.int64]) -> Floats:
    """Of the parameters, where residuals depend on each other within a batch (sandwich estimate)."""
    limited = np.clip(residual, -FARTHEST, FARTHEST)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    _, place = np.unique(batches, return_inverse=True)
    scores = np.zeros((int(place.max()) + 1, jacobian.shape[1]))
    np.add.at(scores, place, jacobian * limited[:, None])
    result: Floats = inverse @ (scores.T @ scores) @ inverse
    return result
