"""Refinement by simulation (output-error method): the test is repeated on virtual boards to fit the motor data.

The virtual boards have the plant model of the twin and the same firmware, with the same configuration blocks, written
at the same times. The differences of currents, voltages and speeds are minimised over the values of the motor.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from servo_measurement.access import MeasurementError
from servo_measurement.estimation import BAND, FLUX_CURRENT_TIME, estimates_of
from servo_measurement.least_squares import mean_of
from servo_measurement.log import MeasurementLog, repeat
from servo_measurement.motor_rig import PROTECTION
from servo_measurement.motor_test import PULSES, SPEEDS, TURN
from servo_measurement.motor_values import Estimate, MotorEstimates
from servo_measurement.speed_runs import half_wave
from servo_measurement.standstill import spectra
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace

from servo_twin.board import Board, BoardError
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.level import Level
from servo_twin.plant import PlantConfig, PlantError

Floats = NDArray[np.float64]

REFINED: Final = ("r_s", "l_d", "l_q", "psi_m", "inertia", "friction", "viscous", "load", "dead_voltage")
"""Refined values, in the order of the parameters."""

MODEL_ERROR: Final[Mapping[str, float]] = {
    "r_s": 0.0015,
    "l_d": 0.0012,
    "l_q": 0.0015,
    "friction": 0.01,
    "dead_voltage": 0.004,
}
"""Additional relative standard uncertainty: spread of the errors of random motors in excess of the jackknife estimate
(doc/identify.md)."""

BIAS_ERROR: Final[Mapping[str, float]] = {"friction": 0.1, "viscous": 0.1}
"""Uncertainty of a bias correction, relative to it; sampled current ripple can amount to half the friction."""

BATCH: Final = 4  # number of adjacent samples with correlated residuals
STEP: Final = 0.04
"""Relative step of the numerical derivatives, larger than the quantisation of encoder and ADC."""
FRICTION_MIN: Final = 0.002  # friction in simulations, relative to the torque of the current limit

FAST_MODEL: Final[Level] = "ideal"
DETAILED_MODEL: Final[Level] = "registers"
"""A board with simulated switching, whose current samples include the ripple."""

CURRENT_ERROR: Final = 0.5e-3
"""Standard uncertainty of a mean current at constant speed: an eighth of an LSB of the ADC [A]."""

VOLTAGE_ERROR: Final = 5e-3
"""Standard uncertainty of a mean voltage at constant speed: less than an LSB of the duty at 24 V [V]."""

ITERATIONS: Final = 4
RESIDUAL_MAX: Final = 8.0  # limit of a residual in the covariance, in standard deviations

_COMPARED: Final[Mapping[str, Sequence[str]]] = {
    "level": ("u_d",),
    "speed": ("i_q", "speed"),
    "plain": ("i_q",),
    "hold": ("u_q",),
}
"""Compared columns by label of the recording; swept sines are compared by their spectra."""

_AVERAGED: Final[Mapping[str, float]] = {"level": 1e3, "speed": 0.02, "plain": 1e3, "hold": 1e3}
"""Averaging time by label [s]; averaging removes the dead-time ripple of six periods per electrical revolution, whose
phase does not depend on the motor data."""

_DEPENDS: Final[Mapping[str, Sequence[str]]] = {
    "level": ("r_s", "dead_voltage"),
    "sweep d": ("r_s", "l_d"),
    "sweep q": ("r_s", "l_q", "psi_m", "inertia"),
    "speed": ("psi_m", "inertia", "friction", "viscous", "load"),
    "plain": ("psi_m", "friction", "viscous", "load"),
    "hold": ("r_s", "l_d", "l_q", "psi_m", "friction", "viscous", "load", "dead_voltage"),
}
"""Parameters that a signal depends on; other numerical derivatives are set to zero."""

_SIGMA_MIN: Final[Mapping[tuple[str, str], float]] = {
    ("level", "u_d"): 1e-3,
    ("speed", "i_q"): 4e-3,
    ("speed", "speed"): 0.2,
    ("plain", "i_q"): 0.5e-3,
    ("hold", "u_q"): 2e-3,
}
"""Smallest assumed noise [SI]: during speed changes, limit cycles of one count have another phase in the simulation."""


@dataclass(frozen=True)
class Refinement:
    """Result of the refinement."""

    estimates: MotorEstimates  # unchanged where not refined
    before: Mapping[str, float]  # RMS difference of each signal before the refinement [SI]
    after: Mapping[str, float]  # RMS difference of each signal after the refinement [SI]
    simulated: list[Trace]  # recordings of a board with the refined values


def plant_of(plant: PlantConfig, axis: int, values: Mapping[str, float], limits: Mapping[str, float]) -> PlantConfig:
    """Plant with the values of a motor [SI], by name.

    ``dead_voltage`` of a leg is the sum of dead time and drop: the dead time is that of `plant`, the drop is the
    remainder.
    """
    own = plant.axes[axis]
    changes: dict[str, Any] = {
        name: values[name]
        for name in ("r_s", "l_d", "l_q", "psi_m", "inertia", "friction", "viscous")
        if name in values
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


def simulated(log: MeasurementLog, plant: PlantConfig, load: float, level: Level = "ideal") -> list[Trace]:
    """Recordings of a virtual board with this plant and load [N m] in the same test.

    Raises
    ------
    MeasurementError
        If the simulation fails.
    """
    plant = plant.with_axis(log.axis, theta_start=0.0)
    if level == FAST_MODEL:
        plant = plant.with_axis(log.axis, i_noise=0.0).with_bus(u_noise=0.0)
    try:
        with Board(plant, seed=1, level=level) as board:
            board.set_load(log.axis, load)
            board.run(float(log.notes.get("boot", 0.05)))
            # disable the monitors: with preliminary values they could end the simulation
            board.write_raw("param.faults_enabled", [0] * AXES)
            return repeat(log, VirtualBoardAccess(board), (TURN, PULSES, PROTECTION))
    except BoardError as error:
        raise MeasurementError(f"the simulation has failed: {error}") from None


@dataclass(frozen=True)
class _Part:
    """A compared column of one recording."""

    number: int  # index of the recording
    label: str
    column: str
    usable: NDArray[np.bool_]  # valid samples
    group: NDArray[np.int64]  # averaging group of each usable sample

    def means(self, samples: Floats) -> Floats:
        _, index, counts = np.unique(self.group, return_inverse=True, return_counts=True)
        result: Floats = np.bincount(index, samples) / counts
        return result


class _Difference:
    """Differences of two sets of recordings as one vector, weighted by noise, without missing samples."""

    def __init__(self, log: MeasurementLog) -> None:
        self._name = axis_name(log.axis)
        self._log = log
        self._parts: list[_Part] = []
        first_run = True
        for k, (label, recording) in enumerate(zip(log.labels, log.recordings, strict=True)):
            if label == "speed" and first_run:
                first_run = False  # the end of the preceding rotor search differs
                continue
            for column in _COMPARED.get(label, ()):
                if label == "hold":  # both signs of the d-axis current
                    usable = np.zeros(len(recording), dtype=np.bool_)
                    for sign in (1.0, -1.0):
                        peak = half_wave(recording, FLUX_CURRENT_TIME, sign)
                        usable |= np.isfinite(peak[f"{self._name}.{column}"])
                else:
                    usable = np.isfinite(recording[f"{self._name}.{column}"])
                every = max(round(_AVERAGED[label] / recording.step), 1)
                if usable.any():
                    self._parts.append(_Part(k, label, column, usable, np.arange(usable.size)[usable] // every))
        self._sigma: dict[tuple[str, str], float] = {}

    def _raw(self, recordings: Sequence[Trace]) -> list[tuple[_Part, Floats]]:
        result = []
        for part in self._parts:
            key = f"{self._name}.{part.column}"
            there, here = self._log.recordings[part.number][key], recordings[part.number][key]
            if part.label == "speed":
                here = self._aligned(part.number, recordings[part.number], here, there)
            result.append((part, part.means((here - there)[part.usable])))
        return result

    def _aligned(self, number: int, recordings: Trace, column: Floats, measured: Floats) -> Floats:
        """Simulated column, shifted to the measured change of the set-point; before it the measured column."""
        key = f"{self._name}.speed_ref"
        late = _ramp_centre(self._log.recordings[number][key]) - _ramp_centre(recordings[key])
        at = np.arange(column.size, dtype=np.float64)
        shifted: Floats = np.where(at < late, measured, np.interp(at - late, at, column))
        return shifted

    def _sweeps(self, recordings: Sequence[Trace]) -> list[tuple[str, Floats]]:
        """Differences of the spectra relative to the test signal, all sweeps of an axis (d, q) together."""
        result = []
        for point in "dq":
            names = (f"{self._name}.i_{point}", f"{self._name}.u_{point}", f"{self._name}.test_signal")
            numbers = [k for k, label in enumerate(self._log.labels) if label == f"sweep_{point}"]
            there, here = (
                spectra([recordings[k] for k in numbers], names, BAND[point])
                for recordings in (self._log.recordings, recordings)
            )
            for quantity in (1, 2):
                difference = here[quantity] - there[quantity]
                result.append((f"{point}{quantity}", np.concatenate([difference.real, difference.imag])))
        return result

    def weigh(self, recordings: Sequence[Trace]) -> None:
        """Estimate the noise of every signal, from the differences of successive means or from the single mean."""
        noise: dict[tuple[str, str], list[float]] = {}
        for part, values in self._raw(recordings):
            if values.size > 4:
                sigma = _robust_deviation(np.diff(values)) / math.sqrt(2.0)
            else:
                # from the difference, so that common changes do not count as noise
                column = f"{self._name}.{part.column}"
                there, here = self._log.recordings[part.number][column], recordings[part.number][column]
                _, sigma = mean_of((here - there)[part.usable])
            noise.setdefault((part.label, part.column), []).append(sigma)
        for key, sigmas in noise.items():
            self._sigma[key] = max(float(np.median(sigmas)), _SIGMA_MIN[key])
        for name, values in self._sweeps(recordings):
            self._sigma["sweep", name] = max(_robust_deviation(np.diff(values)) / math.sqrt(2.0), 1e-9)

    def vector(self, recordings: Sequence[Trace]) -> Floats:
        plain = [values / self._sigma[part.label, part.column] for part, values in self._raw(recordings)]
        return np.concatenate(plain + [values / self._sigma["sweep", key] for key, values in self._sweeps(recordings)])

    def depends(self, names: Sequence[str]) -> NDArray[np.bool_]:
        """True if a residual of `vector` depends on a parameter, shape (residuals, parameters)."""

        def row(label: str) -> list[bool]:
            return [name in _DEPENDS[label] for name in names]

        recordings = self._log.recordings
        rows = [row(part.label) for part, values in self._raw(recordings) for _ in values]
        rows += [row(f"sweep {key[0]}") for key, values in self._sweeps(recordings) for _ in values]
        return np.array(rows)

    @property
    def batches(self) -> NDArray[np.int64]:
        """Batch of each residual of `vector`; residuals within a batch may be correlated."""
        sizes = [np.unique(part.group).size for part in self._parts]
        rest = sum(np.asarray(values).size for _, values in self._sweeps(self._log.recordings))
        together = [np.arange(size) // BATCH + 10_000 * n for n, size in enumerate(sizes)]
        return np.concatenate([*together, 1_000_000 + np.arange(rest)])

    def rms(self, recordings: Sequence[Trace]) -> dict[str, float]:
        """RMS of the differences of each signal."""
        found: dict[str, list[Floats]] = {}
        for part, values in self._raw(recordings):
            found.setdefault(part.column, []).append(values)
        for key, values in self._sweeps(recordings):
            found.setdefault(f"sweep {key}", []).append(values)
        return {column: float(np.sqrt((np.concatenate(parts) ** 2).mean())) for column, parts in found.items()}


def _ramp_centre(set_point: Floats) -> float:
    """Sample index at half of a ramp."""
    usable = np.isfinite(set_point)
    at = np.arange(set_point.size, dtype=np.float64)[usable]
    values = set_point[usable]
    part = (values - values[0]) / (values[-1] - values[0] or 1.0)
    return float(np.interp(0.5, np.maximum.accumulate(part), at))


def _robust_deviation(differences: Floats) -> float:
    """Robust standard deviation."""
    return 1.4826 * float(np.median(np.abs(differences)))


def refine(
    log: MeasurementLog,
    first: MotorEstimates,
    plant: PlantConfig,
    level: Level = DETAILED_MODEL,
    report: Callable[[str], None] = lambda text: None,
) -> Refinement:
    """Fit the values of the motor to all recordings.

    Parameters
    ----------
    log : MeasurementLog
        Recordings of a motor test.
    first : MotorEstimates
        Closed-form estimates.
    plant : PlantConfig
        Values that are not estimated: bus, sensors.
    level : {"registers", "ideal"}
        Detailed model of the measured board. Derivatives are calculated with the fast model.
    report : callable, optional
        Called with a line of text.

    Raises
    ------
    MeasurementError
        If the simulation fails.
    """
    limits: Mapping[str, float] = log.notes["limits"]
    names = [name for name in REFINED if name in first.values]
    start = {name: estimate.value for name, estimate in first.values.items()}
    torque = 1.5 * start["pole_pairs"] * start["psi_m"] * limits["current"]
    top = max(float(np.nanmax(np.abs(r[f"{axis_name(log.axis)}.speed"]))) for r in log.labelled("speed"))
    scale = {name: abs(start[name]) for name in names}
    scale["friction"] = max(scale.get("friction", 0.0), 0.003 * torque)
    scale["viscous"] = max(scale.get("viscous", 0.0), 0.5 * scale["friction"] / top)
    scale["load"] = scale["friction"]
    base = plant.with_bus(u_source=limits["voltage"])
    corrected = _corrected(log, start, base, names, level)
    start = corrected.values
    difference = _Difference(log)
    recordings: dict[bytes, list[Trace]] = {}

    depends = difference.depends(names)

    def values_of(x: Floats) -> dict[str, float]:
        return {**start, **{name: start[name] + x[k] * scale[name] for k, name in enumerate(names)}}

    def show(x: Floats) -> list[Trace]:
        key = x.tobytes()
        if key not in recordings:
            values = values_of(x)
            try:
                found = simulated(log, plant_of(base, log.axis, values, limits), values.get("load", 0.0))
            except PlantError as error:
                raise MeasurementError(f"the estimates are invalid for a motor: {error}") from None
            recordings[key] = found
        return recordings[key]

    def jacobian(x: Floats, *_: object) -> Floats:
        middle = difference.vector(show(x))
        columns = []
        for k in range(x.size):
            shifted = x.copy()
            shifted[k] += STEP
            columns.append((difference.vector(show(shifted)) - middle) / STEP)
        return np.where(depends, np.column_stack(columns), 0.0)

    x = np.zeros(len(names))
    before = difference.rms(corrected.detailed)
    difference.weigh(show(x))
    # difference between detailed and fast model
    model_difference = difference.vector(corrected.detailed) - difference.vector(corrected.fast)

    def vector(y: Floats) -> Floats:
        result: Floats = difference.vector(show(y)) + model_difference
        return result

    result = least_squares(
        vector,
        x,
        jac=jacobian,
        max_nfev=ITERATIONS,
        xtol=1e-4,
        ftol=1e-4,
        bounds=(-0.6, 1.5),
    )
    x = np.asarray(result.x, dtype=np.float64)
    report(f"refined by simulation: {', '.join(f'{name} {values_of(x)[name]:.4g}' for name in names)}")
    spread = covariance(np.asarray(result.jac), vector(x), difference.batches)
    quantisation = _quantisation_errors(start, top)
    found = dict(first.values)
    for k, name in enumerate(names):
        value = start[name] + x[k] * scale[name]
        sigma = math.sqrt(max(spread[k, k], 0.0)) * scale[name]
        bias_error = BIAS_ERROR.get(name, 0.0) * (start[name] - first.values[name].value)
        part = MODEL_ERROR.get(name, 0.0) * value
        found[name] = Estimate(value, math.hypot(sigma, part, quantisation.get(name, 0.0), bias_error))
    final = values_of(x)
    detailed_recordings = simulated(log, plant_of(base, log.axis, final, limits), final.get("load", 0.0), level)
    return Refinement(
        MotorEstimates(found, first.undetermined), before, difference.rms(detailed_recordings), detailed_recordings
    )


def _quantisation_errors(values: Mapping[str, float], top: float) -> dict[str, float]:
    """Standard uncertainties by quantisation of ADC and duties: of the flux, and of the torques at each speed."""
    pairs, psi = values["pole_pairs"], values["psi_m"]
    torque = CURRENT_ERROR * 1.5 * pairs * psi
    line = np.array([[direction, direction * part * top, 1.0] for part in SPEEDS for direction in (1.0, -1.0)])
    spread = torque * np.sqrt(np.diag(np.linalg.inv(line.T @ line)))
    flux = VOLTAGE_ERROR / (pairs * top)
    # the error of the flux scales the torque
    return {
        "psi_m": flux,
        "inertia": flux / psi * values["inertia"],
        "friction": math.hypot(spread[0], flux / psi * values["friction"]),
        "viscous": float(spread[1]),
        "load": float(spread[2]),
    }


@dataclass(frozen=True)
class _Start:
    """Start of the minimisation."""

    values: dict[str, float]  # bias-corrected estimates
    detailed: list[Trace]  # recordings of the detailed model near these values
    fast: list[Trace]  # recordings of the fast model at the values of `detailed`


def _corrected(
    log: MeasurementLog, first: Mapping[str, float], plant: PlantConfig, names: Sequence[str], level: Level
) -> _Start:
    """Bias-corrected estimates; the bias is determined by the same estimators with simulated recordings."""
    values, limits = dict(first), log.notes["limits"]

    def show(at: Level) -> list[Trace]:
        return simulated(log, plant_of(plant, log.axis, values, limits), values.get("load", 0.0), at)

    detailed: list[Trace] = []
    # without friction a simulated shaft would oscillate about the vector without decay
    minimum = FRICTION_MIN * 1.5 * first["pole_pairs"] * first["psi_m"] * limits["current"]
    values["friction"], values["viscous"] = max(values["friction"], minimum), max(values["viscous"], 0.0)
    previous = dict(values)
    for at in (FAST_MODEL, level, level, level):
        previous = dict(values)
        detailed = show(at)
        again = estimates_of(dataclasses.replace(log, recordings=_with_gaps(detailed, log.recordings)))
        for name in names:
            if name not in again.values:
                reason = again.undetermined.get(name, "")
                raise MeasurementError(f"{name} cannot be estimated from the simulation: {reason}")
            estimate = again.values[name].value
            if name in ("load", "viscous", "friction"):
                values[name] += first[name] - estimate
            else:
                values[name] *= min(max(first[name] / estimate, 0.8), 1.25) if estimate > 0.0 else 1.0
        values["friction"], values["viscous"] = max(values["friction"], minimum), max(values["viscous"], 0.0)
    if level == FAST_MODEL:
        return _Start(values, detailed, detailed)
    values, refined = previous, values
    fast = show(FAST_MODEL)
    return _Start(refined, detailed, fast)


def _with_gaps(recordings: Sequence[Trace], like: Sequence[Trace]) -> list[Trace]:
    """Recordings with the same missing samples as `like`."""
    return [
        one.changed(**{name: np.where(np.isfinite(there[name]), one[name], np.nan) for name in one.columns})
        for one, there in zip(recordings, like, strict=True)
    ]


def covariance(jacobian: Floats, residual: Floats, batches: NDArray[np.int64]) -> Floats:
    """Covariance of fitted parameters: jackknife over batches of correlated residuals.

    Parameters
    ----------
    jacobian : ndarray, shape (residuals, parameters)
    residual : ndarray, shape (residuals,)
        Residuals of the fit.
    batches : ndarray of int, shape (residuals,)
        Batch of each residual.

    Returns
    -------
    ndarray, shape (parameters, parameters)
    """
    limited = np.clip(residual, -RESIDUAL_MAX, RESIDUAL_MAX)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = []
    for batch in np.unique(batches):
        rows = batches == batch
        part = jacobian[rows]
        # residuals of a batch for a fit without this batch
        alone = np.linalg.lstsq(np.eye(len(part)) - part @ inverse @ part.T, limited[rows], rcond=1e-6)[0]
        scores.append(part.T @ alone)
    result: Floats = inverse @ (np.array(scores).T @ np.array(scores)) @ inverse
    return result
