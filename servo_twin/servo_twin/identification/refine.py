"""All values together, by simulation: what was done to the board is done to virtual boards until they answer the same.

The plant is that of the twin, the firmware the same C with the same configuration blocks, written at the same times.
The differences of currents, voltages and speeds are minimised over the values of the motor (output error).
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
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.measurement.access import MeasurementError, Recording
from servo_msgs_py.measurement.estimation import BAND, estimates_of
from servo_msgs_py.measurement.least_squares import mean_of
from servo_msgs_py.measurement.log import MeasurementLog, repeat
from servo_msgs_py.measurement.motor_rig import PROTECTION
from servo_msgs_py.measurement.motor_test import PULSES, SPEEDS, TURN
from servo_msgs_py.measurement.motor_values import Estimate, MotorEstimates
from servo_msgs_py.measurement.standstill import spectra

from servo_twin.board import Board, BoardError
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.level import Level
from servo_twin.plant import PlantConfig, PlantError

Floats = NDArray[np.float64]

REFINED: Final = ("r_s", "l_d", "l_q", "psi_m", "inertia", "friction", "viscous", "load", "dead_voltage")
"""What is refined, in the order of the parameters."""

MODEL_ERROR: Final[Mapping[str, float]] = {
    "r_s": 0.0015,
    "l_d": 0.0012,
    "l_q": 0.0015,
    "friction": 0.01,
    "dead_voltage": 0.004,
}
"""Relative standard uncertainty that the residuals do not show: what the errors of random motors spread beyond the
jackknife's (doc/identify.md)."""

BIAS_ERROR: Final[Mapping[str, float]] = {"friction": 0.1, "viscous": 0.1}
"""Part of a bias that its correction may miss: ripple that the converters sample, as much as half the friction."""

BATCH: Final = 4  # neighbouring samples whose residuals are not independent
STEP: Final = 0.04
"""Of a numerical derivative: encoder and converters make simulated signals rough, so a small one shows nothing else."""
FRICTION_MIN: Final = 0.002  # of simulations, part of the torque of the current limit

QUICK: Final[Level] = "ideal"
CLOSE: Final[Level] = "registers"
"""A board whose switching is simulated, too: its current converters sample the ripple, not the mean."""

CURRENT_ERROR: Final = 0.5e-3
"""Standard uncertainty of a mean current at constant speed: an eighth of a step of the converter [A]."""

VOLTAGE_ERROR: Final = 5e-3
"""The same of a mean voltage: less than a step of the duty at 24 V [V]."""

ITERATIONS: Final = 4
FARTHEST: Final = 8.0  # a residual counts for no more than about so many times the usual one

_COMPARED: Final[Mapping[str, Sequence[str]]] = {
    "level": ("u_d",),
    "speed": ("i_q", "speed"),
    "plain": ("i_q",),
    "hold": ("u_q",),
}
"""Columns that are compared, by the purpose of a recording; of swept sines the spectra are."""

_AVERAGED: Final[Mapping[str, float]] = {"level": 1e3, "speed": 0.02, "plain": 1e3, "hold": 1e3}
"""Means over so many seconds count [s]: dead time makes a ripple of six periods per electrical turn, whose phase says
nothing about the motor."""

_DEPENDS: Final[Mapping[str, Sequence[str]]] = {
    "level": ("r_s", "dead_voltage"),
    "sweep d": ("r_s", "l_d"),
    "sweep q": ("r_s", "l_q", "psi_m", "inertia"),
    "speed": ("psi_m", "inertia", "friction", "viscous", "load"),
    "plain": ("psi_m", "friction", "viscous", "load"),
    "hold": ("r_s", "l_d", "l_q", "psi_m", "friction", "viscous", "load", "dead_voltage"),
}
"""What a signal depends on; all else in a numerical derivative is roughness."""

_SIGMA_MIN: Final[Mapping[tuple[str, str], float]] = {
    ("level", "u_d"): 1e-3,
    ("speed", "i_q"): 4e-3,
    ("speed", "speed"): 0.2,
    ("plain", "i_q"): 0.5e-3,
    ("hold", "u_q"): 2e-3,
}
"""Noise that is assumed at least [SI]: while the speed changes, controllers that hunt by a count do so at other moments
in the simulation."""


@dataclass(frozen=True)
class Refinement:
    """What came of it."""

    estimates: MotorEstimates  # unchanged where not refined
    before: Mapping[str, float]  # root mean square of each signal's difference before [SI]
    after: Mapping[str, float]  # the same after the refinement [SI]
    simulated: list[Recording]  # recordings of a board with the refined values


def plant_of(plant: PlantConfig, axis: int, values: Mapping[str, float], limits: Mapping[str, float]) -> PlantConfig:
    """A plant file's values with those of a motor [SI], by name.

    The lost voltage of a leg is dead time and drop together: the dead time stays that of `plant`, the drop takes the
    rest.
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


def simulated(log: MeasurementLog, plant: PlantConfig, load: float, level: Level = "ideal") -> list[Recording]:
    """What a virtual board with this plant and load [N m] shows when treated as the real one was.

    Raises
    ------
    MeasurementError
        If it cannot be done.
    """
    plant = plant.with_axis(log.axis, theta_start=0.0)
    if level == QUICK:
        plant = plant.with_axis(log.axis, i_noise=0.0).with_bus(u_noise=0.0)
    try:
        with Board(plant, seed=1, level=level) as board:
            board.set_load(log.axis, load)
            board.run(float(log.notes.get("boot", 0.05)))
            # the real board has watched the motor; with values not yet right a monitor would end the simulation
            board.write_raw("param.faults_enabled", [0] * AXES)
            return repeat(log, VirtualBoardAccess(board), (TURN, PULSES, PROTECTION))
    except BoardError as error:
        raise MeasurementError(f"the simulation has failed: {error}") from None


@dataclass(frozen=True)
class _Part:
    """What is compared of one recording."""

    number: int  # of the recording
    label: str
    column: str
    usable: NDArray[np.bool_]  # which samples are valid
    group: NDArray[np.int64]  # of each usable sample: those of one number are averaged

    def means(self, samples: Floats) -> Floats:
        _, place, counts = np.unique(self.group, return_inverse=True, return_counts=True)
        result: Floats = np.bincount(place, samples) / counts
        return result


class _Difference:
    """Differences of two sets of recordings as one vector; weighted by their noise, and without missing samples."""

    def __init__(self, log: MeasurementLog) -> None:
        self._name = axis_name(log.axis)
        self._log = log
        self._parts: list[_Part] = []
        first_run = True
        for k, (label, recording) in enumerate(zip(log.labels, log.recordings, strict=True)):
            if label == "speed" and first_run:
                first_run = False  # the rotor search before it does not end at the same time
                continue
            for column in _COMPARED.get(label, ()):
                usable = np.isfinite(recording.columns[f"{self._name}.{column}"])
                if label == "hold":  # the current along the flux has to grow first
                    usable[: usable.size // 2] = False
                every = max(round(_AVERAGED[label] / recording.step), 1)
                if usable.any():
                    self._parts.append(_Part(k, label, column, usable, np.arange(usable.size)[usable] // every))
        self._sigma: dict[tuple[str, str], float] = {}

    def _raw(self, shown: Sequence[Recording]) -> list[tuple[_Part, Floats]]:
        result = []
        for part in self._parts:
            key = f"{self._name}.{part.column}"
            there, here = self._log.recordings[part.number].columns[key], shown[part.number].columns[key]
            if part.label == "speed":
                here = self._aligned(part.number, shown[part.number], here, there)
            result.append((part, part.means((here - there)[part.usable])))
        return result

    def _aligned(self, number: int, shown: Recording, column: Floats, measured: Floats) -> Floats:
        """A simulated column, moved to where the measured set-point changes; before that the measured one."""
        key = f"{self._name}.speed_ref"
        late = _half_way(self._log.recordings[number].columns[key]) - _half_way(shown.columns[key])
        at = np.arange(column.size, dtype=np.float64)
        moved: Floats = np.where(at < late, measured, np.interp(at - late, at, column))
        return moved

    def _sweeps(self, shown: Sequence[Recording]) -> list[tuple[str, Floats]]:
        """Spectra in terms of the test signal, all sweeps of one kind together."""
        result = []
        for point in "dq":
            names = (f"{self._name}.i_{point}", f"{self._name}.u_{point}", f"{self._name}.test_signal")
            numbers = [k for k, label in enumerate(self._log.labels) if label == f"sweep_{point}"]
            there, here = (
                spectra([recordings[k] for k in numbers], names, BAND[point])
                for recordings in (self._log.recordings, shown)
            )
            for quantity in (1, 2):
                difference = here[quantity] - there[quantity]
                result.append((f"{point}{quantity}", np.concatenate([difference.real, difference.imag])))
        return result

    def weigh(self, shown: Sequence[Recording]) -> None:
        """Noise of every signal: of what changes from one mean to the next, or of the one mean."""
        noise: dict[tuple[str, str], list[float]] = {}
        for part, values in self._raw(shown):
            if values.size > 4:
                sigma = _usual(np.diff(values)) / math.sqrt(2.0)
            else:
                # of the difference: what both do alike is no noise
                column = f"{self._name}.{part.column}"
                there, here = self._log.recordings[part.number].columns[column], shown[part.number].columns[column]
                _, sigma = mean_of((here - there)[part.usable])
            noise.setdefault((part.label, part.column), []).append(sigma)
        for key, sigmas in noise.items():
            self._sigma[key] = max(float(np.median(sigmas)), _SIGMA_MIN[key])
        for name, values in self._sweeps(shown):
            self._sigma["sweep", name] = max(_usual(np.diff(values)) / math.sqrt(2.0), 1e-9)

    def vector(self, shown: Sequence[Recording]) -> Floats:
        plain = [values / self._sigma[part.label, part.column] for part, values in self._raw(shown)]
        return np.concatenate(plain + [values / self._sigma["sweep", key] for key, values in self._sweeps(shown)])

    def depends(self, names: Sequence[str]) -> NDArray[np.bool_]:
        """Whether a residual of `vector` depends on a parameter, shape (residuals, parameters)."""

        def row(label: str) -> list[bool]:
            return [name in _DEPENDS[label] for name in names]

        shown = self._log.recordings
        rows = [row(part.label) for part, values in self._raw(shown) for _ in values]
        rows += [row(f"sweep {key[0]}") for key, values in self._sweeps(shown) for _ in values]
        return np.array(rows)

    @property
    def batches(self) -> NDArray[np.int64]:
        """Which residuals of `vector` may depend on each other."""
        sizes = [np.unique(part.group).size for part in self._parts]
        rest = sum(np.asarray(values).size for _, values in self._sweeps(self._log.recordings))
        together = [np.arange(size) // BATCH + 10_000 * n for n, size in enumerate(sizes)]
        return np.concatenate([*together, 1_000_000 + np.arange(rest)])

    def rms(self, shown: Sequence[Recording]) -> dict[str, float]:
        """Root mean square of each signal's differences."""
        found: dict[str, list[Floats]] = {}
        for part, values in self._raw(shown):
            found.setdefault(part.column, []).append(values)
        for key, values in self._sweeps(shown):
            found.setdefault(f"sweep {key}", []).append(values)
        return {column: float(np.sqrt((np.concatenate(parts) ** 2).mean())) for column, parts in found.items()}


def _half_way(set_point: Floats) -> float:
    """Sample at which a ramp is half over."""
    usable = np.isfinite(set_point)
    at = np.arange(set_point.size, dtype=np.float64)[usable]
    values = set_point[usable]
    part = (values - values[0]) / (values[-1] - values[0] or 1.0)
    return float(np.interp(0.5, np.maximum.accumulate(part), at))


def _usual(differences: Floats) -> float:
    """Robust standard deviation."""
    return 1.4826 * float(np.median(np.abs(differences)))


def refine(
    log: MeasurementLog,
    first: MotorEstimates,
    plant: PlantConfig,
    level: Level = CLOSE,
    report: Callable[[str], None] = lambda text: None,
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
    level : {"registers", "ideal"}
        The close model: how the measured board is to be imitated. Derivatives come from the quick one.
    report : callable, optional
        Gets a line.

    Raises
    ------
    MeasurementError
        If it cannot be simulated.
    """
    limits: Mapping[str, float] = log.notes["limits"]
    names = [name for name in REFINED if name in first.values]
    start = {name: estimate.value for name, estimate in first.values.items()}
    torque = 1.5 * start["pole_pairs"] * start["psi_m"] * limits["current"]
    top = max(float(np.nanmax(np.abs(r.columns[f"{axis_name(log.axis)}.speed"]))) for r in log.labelled("speed"))
    scale = {name: abs(start[name]) for name in names}
    scale["friction"] = max(scale.get("friction", 0.0), 0.003 * torque)
    scale["viscous"] = max(scale.get("viscous", 0.0), 0.5 * scale["friction"] / top)
    scale["load"] = scale["friction"]
    base = plant.with_bus(u_source=limits["voltage"])
    corrected = _corrected(log, start, base, names, level)
    start = corrected.values
    difference = _Difference(log)
    shown: dict[bytes, list[Recording]] = {}

    depends = difference.depends(names)

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
        return np.where(depends, np.column_stack(columns), 0.0)

    x = np.zeros(len(names))
    before = difference.rms(corrected.close)
    difference.weigh(show(x))
    # what the close model shows beyond the quick one
    beyond = difference.vector(corrected.close) - difference.vector(corrected.quick)

    def vector(y: Floats) -> Floats:
        result: Floats = difference.vector(show(y)) + beyond
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
    floor = _floor(start, top)
    found = dict(first.values)
    for k, name in enumerate(names):
        value = start[name] + x[k] * scale[name]
        sigma = math.sqrt(max(spread[k, k], 0.0)) * scale[name]
        missed = BIAS_ERROR.get(name, 0.0) * (start[name] - first.values[name].value)
        part = MODEL_ERROR.get(name, 0.0) * value
        found[name] = Estimate(value, math.hypot(sigma, part, floor.get(name, 0.0), missed))
    final = values_of(x)
    shown_close = simulated(log, plant_of(base, log.axis, final, limits), final.get("load", 0.0), level)
    return Refinement(MotorEstimates(found, first.undetermined), before, difference.rms(shown_close), shown_close)


def _floor(values: Mapping[str, float], top: float) -> dict[str, float]:
    """Standard uncertainty that steps of converters and duties leave: of the flux, and of torques at each speed."""
    pairs, psi = values["pole_pairs"], values["psi_m"]
    torque = CURRENT_ERROR * 1.5 * pairs * psi
    line = np.array([[way, way * part * top, 1.0] for part in SPEEDS for way in (1.0, -1.0)])
    spread = torque * np.sqrt(np.diag(np.linalg.inv(line.T @ line)))
    flux = VOLTAGE_ERROR / (pairs * top)
    # torque is measured in terms of the flux
    return {
        "psi_m": flux,
        "inertia": flux / psi * values["inertia"],
        "friction": math.hypot(spread[0], flux / psi * values["friction"]),
        "viscous": float(spread[1]),
        "load": float(spread[2]),
    }


@dataclass(frozen=True)
class _Start:
    """Where the minimisation begins."""

    values: dict[str, float]  # estimates without their bias
    close: list[Recording]  # recordings of the close model at about these values
    quick: list[Recording]  # the same of the quick model; the difference is added to it


def _corrected(
    log: MeasurementLog, first: Mapping[str, float], plant: PlantConfig, names: Sequence[str], level: Level
) -> _Start:
    """Estimates without their bias: what the same estimators make of a simulation with them shows it."""
    values, limits = dict(first), log.notes["limits"]

    def show(at: Level) -> list[Recording]:
        return simulated(log, plant_of(plant, log.axis, values, limits), values.get("load", 0.0), at)

    close: list[Recording] = []
    # without friction a simulated shaft would swing about the vector for ever
    minimum = FRICTION_MIN * 1.5 * first["pole_pairs"] * first["psi_m"] * limits["current"]
    values["friction"], values["viscous"] = max(values["friction"], minimum), max(values["viscous"], 0.0)
    begun = dict(values)
    for at in (QUICK, level, level, level):
        begun = dict(values)
        close = show(at)
        again = estimates_of(dataclasses.replace(log, recordings=_with_gaps(close, log.recordings)))
        for name in names:
            if name not in again.values:
                reason = again.undetermined.get(name, "")
                raise MeasurementError(f"{name} of a simulation cannot be estimated: {reason}")
            seen = again.values[name].value
            if name in ("load", "viscous", "friction"):
                values[name] += first[name] - seen
            else:
                values[name] *= min(max(first[name] / seen, 0.8), 1.25) if seen > 0.0 else 1.0
        values["friction"], values["viscous"] = max(values["friction"], minimum), max(values["viscous"], 0.0)
    if level == QUICK:
        return _Start(values, close, close)
    values, refined = begun, values
    quick = show(QUICK)
    return _Start(refined, close, quick)


def _with_gaps(shown: Sequence[Recording], like: Sequence[Recording]) -> list[Recording]:
    """Recordings in which the same samples are missing."""
    return [
        Recording(
            one.step,
            {name: np.where(np.isfinite(there.columns[name]), one.columns[name], np.nan) for name in one.columns},
        )
        for one, there in zip(shown, like, strict=True)
    ]


def covariance(jacobian: Floats, residual: Floats, batches: NDArray[np.int64]) -> Floats:
    """Of fitted parameters: jackknife over batches, within which residuals depend on each other.

    Parameters
    ----------
    jacobian : ndarray, shape (residuals, parameters)
    residual : ndarray, shape (residuals,)
        After the fit.
    batches : ndarray of int, shape (residuals,)
        Residuals of one number depend on each other.

    Returns
    -------
    ndarray, shape (parameters, parameters)
    """
    limited = np.clip(residual, -FARTHEST, FARTHEST)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = []
    for batch in np.unique(batches):
        rows = batches == batch
        part = jacobian[rows]
        # a batch draws the fit to itself: its residuals without that
        alone = np.linalg.lstsq(np.eye(len(part)) - part @ inverse @ part.T, limited[rows], rcond=1e-6)[0]
        scores.append(part.T @ alone)
    result: Floats = inverse @ (np.array(scores).T @ np.array(scores)) @ inverse
    return result
