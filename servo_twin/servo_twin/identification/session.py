"""Identification of one axis: measurement, estimates, refinement, checks, ``servo.toml``."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from servo_measurement.access import MeasurementError
from servo_measurement.estimation import BAND, estimates_of, inductance_at_low_current
from servo_measurement.log import MeasurementLog
from servo_measurement.motor_config import SUPPLY_END, fitted
from servo_measurement.motor_test import OVERSHOOT, ROOM_USE, MotorTest
from servo_measurement.motor_values import UNITS, VOLTAGE_USE, Limits, MotorEstimates
from servo_msgs_py.axis_config import AxisConfigError
from servo_msgs_py.axis_config_transfer import BlockRefusedError
from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.rounding import rounded_up
from servo_msgs_py.table_text import aligned
from servo_tuning.errors import ConfigError, Problem, Remedy, Table, raised
from servo_tuning.motor import Motor
from servo_tuning.remedies import explained
from servo_tuning.tuned import tuned_axis

from servo_twin.board import Board, SimulationError
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.identification.refine import DETAILED_MODEL, Refinement, refine
from servo_twin.level import Level
from servo_twin.plant import PlantConfig

BOOT: Final = 0.05  # power-on to STOP [s]

NEEDED: Final[Mapping[str, float]] = {
    "r_s": 0.1,
    "l_d": 0.1,
    "l_q": 0.1,
    "psi_m": 0.1,
    "pole_pairs": 0.0,
    "inertia": 0.15,
    "friction": 0.5,
}
"""Largest half width of the 95 % interval of a determined value, relative to the value."""

OF_CURRENT: Final = ("r_s", "l_d", "l_q")
"""Values whose interval is inversely proportional to the current; that of the others to the speed."""

WITH_SPEED: Final[Mapping[str, float]] = {"friction": 2.0}
"""The speed that a value needs is proportional to this power of its interval over the permitted one; others: 1."""

MARGIN: Final = 1.25
"""Margin of a current or a speed that is enough for an interval."""

MOVES_USE: Final = 0.4
"""Largest natural frequency of winding and shaft, over the smallest one of the test signal for `l_q`."""

FRICTION_SMALL: Final = 0.005
"""Friction below this fraction of the torque of the current limit needs no accurate value."""

SATURATED: Final = 0.03
"""Relative difference of the inductances at full and half current that indicates saturation."""

EXPLAINED: Final[Mapping[str, tuple[float, float]]] = {
    "i_d": (0.02, 0.02),
    "i_q": (0.02, 0.05),
    "u_d": (0.05, 0.03),
    "u_q": (0.05, 0.03),
    "speed": (1.0, 0.02),
}
"""Largest RMS difference of an explained signal: absolute part [SI], and part relative to the signal."""

Report = Callable[[str], None]


@dataclass(frozen=True)
class Identified:
    """Result of a measurement."""

    log: MeasurementLog
    estimates: MotorEstimates  # refined, if there is a refinement
    refinement: Refinement | None
    problems: tuple[Problem, ...]  # undetermined values and unexplained differences; empty: success


def measure_virtual(
    plant: PlantConfig,
    axis: int,
    limits: Limits,
    base: Mapping[str, Any],
    *,
    level: Level,
    seed: int,
    prepare: Callable[[Board], None] | None = None,
    report: Report = lambda text: None,
) -> tuple[MeasurementLog, str]:
    """Test the motor of a virtual board.

    Parameters
    ----------
    prepare : callable, optional
        Set-up of the board before the test: a load, a locked shaft.

    Returns
    -------
    log : MeasurementLog
        Recordings until the end or the error.
    problem : str
        Error that ended the test; empty: none.
    """
    with Board(plant, seed=seed, level=level) as board:
        if prepare is not None:
            prepare(board)
        board.run(BOOT)
        test = MotorTest(VirtualBoardAccess(board), axis, limits, base, report)
        test.log.notes["boot"] = BOOT
        problem = ""
        try:
            test.run()
        except (MeasurementError, BlockRefusedError, AxisConfigError, SimulationError) as error:
            problem = str(error)
        if test.restoring_text and test.restoring_text not in problem:
            problem += f"; {test.restoring_text}"
        test.log.notes["seconds"] = board.time_ns * 1e-9
    return test.log, problem


def identified(
    log: MeasurementLog,
    plant: PlantConfig,
    problem: str = "",
    *,
    refined: bool = True,
    level: Level = DETAILED_MODEL,
    report: Report = lambda text: None,
) -> Identified:
    """Estimates from a measurement, with checks.

    Parameters
    ----------
    problem : str
        Error that ended the measurement; empty: none.
    refined : bool
        Refine the estimates by simulation.
    level : {"registers", "ideal"}
        Level of the simulated boards.
    """
    first = estimates_of(log)
    problems = [Problem(problem)] if problem else []
    refinement = None
    if refined and not problem and not first.undetermined:
        try:
            refinement = refine(log, first, plant, level, report)
        except (MeasurementError, np.linalg.LinAlgError) as error:
            problems.append(Problem(f"the refinement has failed: {error}"))
    estimates = refinement.estimates if refinement is not None else first
    if not problem:  # otherwise values and intervals are those of an unfinished measurement
        problems += [Problem(f"{name}: {reason}", name) for name, reason in first.undetermined.items()]
        problems += _undetermined(estimates, log)
        problems += _saturated(first, log)
    if refinement is not None:
        problems += _unexplained(log, refinement)
    return Identified(log, estimates, refinement, tuple(problems))


def _undetermined(estimates: MotorEstimates, log: MeasurementLog) -> Iterator[Problem]:
    """Undetermined values, with the options that narrow a too wide interval."""
    values = estimates.values
    current = float(log.notes["limits"]["current"])
    wide = {name: estimate.part / NEEDED[name] for name, estimate in values.items() if NEEDED.get(name)}
    # infinite: a value of 0, which is named below
    needed = max((wide[name] for name in OF_CURRENT if name in wide and math.isfinite(wide[name])), default=0.0)
    more_current = _more_current(log, estimates, needed) if needed > 1.0 else None
    slow = {name: part ** WITH_SPEED.get(name, 1.0) for name, part in wide.items() if name not in OF_CURRENT}
    fastest = max((part for part in slow.values() if math.isfinite(part)), default=0.0)
    for name, part in NEEDED.items():
        if name not in values:
            if name not in estimates.undetermined:
                yield Problem(f"{name}: not measured", name)
            continue
        estimate = values[name]
        if name == "friction" and "psi_m" in values:
            small = FRICTION_SMALL * 1.5 * values["pole_pairs"].value * values["psi_m"].value
            if estimate.interval[1] < small * current:
                continue
        if not math.isfinite(estimate.value) or (estimate.value <= 0.0 and name != "friction"):
            fact = f"{name}: {estimate.value:.3g} {UNITS[name]} is implausible: not determined by the data"
            yield Problem(fact, name)
        elif estimate.part > part > 0.0:
            low, high = estimate.interval
            fact = f"{name}: the interval {low:.3g} .. {high:.3g} {UNITS[name]} is too wide"
            if name == "l_q" and _moves(estimates):
                reason = "the rotor is so light that a test signal across the vector turns it, whatever its current"
                yield Problem(f"{fact}: {reason}", name, advice="couple an inertia")
                continue
            if name not in OF_CURRENT and not ("runs" in log.notes and math.isfinite(wide[name])):
                yield Problem(fact, name)  # of an earlier version, or a value of 0: no speed can be told
                continue
            remedy = more_current if name in OF_CURRENT else _more_speed(log, estimates, fastest)
            if remedy is None:
                what = "a current, or a voltage for it," if name in OF_CURRENT else "a speed, or a voltage for it,"
                yield Problem(f"{fact}; it needs {what} beyond the board", name)
            else:
                yield Problem(fact, name, (remedy,))


def _moves(estimates: MotorEstimates) -> bool:
    """Whether winding and shaft exchange energy near the frequencies of the test signal for `l_q`."""
    names = [field.name for field in dataclasses.fields(Motor)]
    if not estimates.values.keys() >= set(names):
        return False
    motor = Motor(**{name: estimates[name] for name in names})
    return motor.exchange > MOVES_USE * BAND["q"][0]


def _more_current(log: MeasurementLog, estimates: MotorEstimates, factor: float) -> Remedy | None:
    """The current that is larger by a factor, with the voltage that it needs; none if the board cannot do it."""
    catalogue = Catalogue.load()
    limits = Limits(**log.notes["limits"])
    current = rounded_up(MARGIN * factor * float(log.notes.get("current", limits.current)))
    needed = float(math.ceil(current * (estimates["r_s"] + limits.r_on) * math.sqrt(3.0) / VOLTAGE_USE))
    if current > catalogue["param.i_q_limit"].maximum or needed > SUPPLY_END:
        return None
    return raised({"--voltage": (limits.voltage, needed), "--current": (0.0, current)})


def _more_speed(log: MeasurementLog, estimates: MotorEstimates, factor: float) -> Remedy | None:
    """The speed that is larger by a factor, with the other options that it needs; none if the board cannot do it."""
    limits, runs = Limits(**log.notes["limits"]), log.notes["runs"]
    speed = MARGIN * factor * runs["speed"]
    voltage = float(math.ceil(limits.voltage * speed / runs["speed_of_voltage"]))
    time, per_square = runs["travel"]
    turns = (speed * time + speed**2 * per_square) / (2.0 * math.pi * ROOM_USE)
    energy = 0.5 * runs["inertia"] * speed**2
    if OVERSHOOT * speed > Catalogue.load()["param.speed_limit"].maximum or voltage > SUPPLY_END:
        return None
    wanted = {
        "--voltage": (limits.voltage, voltage),
        "--energy-max": (limits.energy, rounded_up(energy)),
        "--turns-max": (limits.turns, rounded_up(turns)),
        "--speed-max": (limits.speed, rounded_up(OVERSHOOT * speed)),
    }
    return raised(wanted)


def _saturated(first: MotorEstimates, log: MeasurementLog) -> list[Problem]:
    """Message if an inductance depends on the current; not if a phase current vanishes in the dead time."""
    if (
        not log.notes.get("comparable", True)
        or "l_d" not in first.values
        or "r_s" not in first.values
        or "bias" not in log.notes
    ):
        return []
    half = inductance_at_low_current(log, first["r_s"] + float(log.notes["limits"]["r_on"]))
    full = first.values["l_d"]
    if half is None or half.value / full.value - 1.0 < SATURATED + math.hypot(half.part, full.part):
        return []
    less, more = (log.notes["bias"][name] for name in ("l_d_low", "l_d"))
    text = (
        f"l_d: {half.value:.4g} H at {less:.2g} A and {full.value:.4g} H at {more:.2g} A along the flux: the iron"
        " saturates, which is not modelled; the values are valid near these currents only"
    )
    return [Problem(text, "l_d")]


def _unexplained(log: MeasurementLog, refinement: Refinement) -> list[Problem]:
    found = []
    for column, (fixed, part) in EXPLAINED.items():
        key = f"{axis_name(log.axis)}.{column}"
        runs = [recording[key] for recording in log.labelled("speed") if key in recording.columns]
        rms = refinement.after.get(column)
        if rms is None or not runs:
            continue
        size = float(np.nanstd(np.concatenate(runs)))
        if rms > fixed + part * size:
            fact = f"{column}: with the best values the simulation still differs by {rms:.3g}: an effect on this axis"
            found.append(Problem(f"{fact} is not modelled", column))
    return found


def tuned_table(base: Mapping[str, Any], result: Identified, limits: Limits) -> tuple[Table | None, Sequence[str]]:
    """``servo.toml`` with feasible bandwidths, and lines with the margins; None and a reason if refused."""
    values = {name: estimate.value for name, estimate in result.estimates.values.items()}
    motor = {name: values[name] for name in ("l_d", "l_q", "psi_m", "pole_pairs", "inertia")}
    # the resistance for the controller includes the switches
    motor |= {"r_s": values["r_s"] + limits.r_on, "friction": max(values["friction"], 0.0)}
    motor["viscous"] = max(values.get("viscous", 0.0), 0.0)
    motor = {name: float(f"{value:.5g}") for name, value in motor.items()}
    try:
        table = fitted(base, result.log.axis, limits, motor)
        design = tuned_axis(table, result.log.axis)
    except ConfigError as error:
        return None, (f"no feasible configuration: {explained(error)}",)
    rows = []
    for name, margins in (
        ("current d", design.current_loop("d").margins()),
        ("current q", design.current_loop("q").margins()),
        ("speed", design.shaft().speed_margins()),
        ("position", design.shaft().position_margins()),
    ):
        crossover = "-" if margins.crossover is None else f"{margins.crossover:.4g} Hz"
        phase = "-" if margins.phase is None else f"{margins.phase:.1f} deg"
        gain = "-" if margins.gain is None else f"{margins.gain:.2f}"
        rows.append([name, f"crossover {crossover}", f"phase margin {phase}", f"gain margin {gain}"])
    return table, aligned(rows)
