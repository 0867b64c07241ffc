"""Error of the observed angle over speed and current, with another winding, and without dead-time compensation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.rig import RPM, set_up, spinning
from servo_twin.validation.experiments.sensorless import (
    back_emf,
    dead_voltage,
    degrees,
    follow,
    limits_of,
    without_fault,
)

NAME: Final = "observer"
HELP: Final = """\
The observer runs in parallel to the encoder, which alone is used for control: error of the observed angle from 200 rpm
to the speed limit, without load and with loads that require a quarter and half of the current limit. According to the
reference design it is not very sensitive to Rs and moderately sensitive to Ls (ST document, performance). In theory,
with i_d = 0, an error of R changes only the amplitude of the observed back-EMF, and an error of L rotates it by (Lq -
L) i_q / psi; shown with R and L of the plant at 0.5 and 1.5 times their values. At 200 rpm dead time and switch drops
cause an error as large as the back-EMF; shown with the normal compensation, and on an inverter with twice the dead
time and twice the drops, where the remaining error equals that without compensation."""

SPEEDS: Final = (1.0 / 15.0, 1.0 / 6.0, 1.0 / 3.0, 1.0)
"""Speeds, relative to the speed limit: 200, 500, 1000 and 3000 rpm with the nominal one."""

CURRENTS: Final = (0.0, 0.25, 0.5)
"""Load currents, relative to the current limit."""

WINDINGS: Final = ((0.5, 1.0), (1.5, 1.0), (1.0, 0.5), (1.0, 1.5))
"""Factors of resistance and inductance of the plant."""

SENSITIVE: Final = (SPEEDS[1], SPEEDS[2], SPEEDS[3])
"""Speeds for other windings: at lower ones, half of R at half of the current equals the back-EMF."""

SENSITIVE_CURRENT: Final = 0.5

ERROR_MAX: Final = 5.0
"""Permitted mean error in addition to the theoretical error by saliency [deg]: 0.4 % of the torque."""

UNCOMPENSATED: Final = 1.0 / 8.0
"""Permitted remainder of the dead-time voltage after compensation; dominant at small back-EMF."""

THEORY_ERROR_MAX: Final = 3.0
"""Permitted difference between the measured and the theoretical effect (without dead time) of another winding [deg]."""

RIPPLE: Final = 9.0
"""Largest amplitude at 200 rpm with compensation of dead time and drops [deg]; without: 9 to 15."""

AMPLITUDE_RATIO_MIN: Final = 2.0
"""Smallest ratio of the amplitudes without and with compensation."""

SETTLE: Final = 0.3  # settling time at each point [s]
MEASURED: Final = 0.3  # time of the measurement [s]


@dataclass(frozen=True)
class Point:
    """Result at one speed with one load."""

    speed: float  # [rad/s]
    i_q: float  # mean of the true current [A]
    mean: float  # mean error of the observed angle [deg]
    deviation: float  # standard deviation of the error [deg]
    amplitude: float  # largest distance of the error from the mean [deg]
    trace: Trace


def run_in_parallel(board: Board, axis: int) -> None:
    """Run the observer in parallel to the encoder, with the fault ANGLE_MISMATCH disabled."""
    without_fault(board, axis, "ANGLE_MISMATCH")
    set_up(board, axis, "SPEED", ANGLE_CHECK=True, DEAD_TIME=True)


def offset(board: Board, axis: int) -> float:
    """Offset of the encoder angle after the rotor search against the true angle, at standstill [deg]."""
    name = axis_name(axis)
    used = board.read(f"{name}.theta_e")
    assert isinstance(used, float)
    true = board.plant.axes[axis].pole_pairs * board.truth(axis).theta_m
    return float(degrees(np.array([used - true]))[0])


def measure(
    plant: PlantConfig, seed: int, axis: int, speeds: tuple[float, ...], currents: tuple[float, ...]
) -> Mapping[tuple[float, float], Point]:
    """Every speed (relative to the limit) with every load (relative to the current limit).

    Raises
    ------
    SimulationError
        If the axis has a fault.
    """
    found: dict[tuple[float, float], Point] = {}
    motor = plant.axes[axis]
    with spinning(plant, seed) as board:
        run_in_parallel(board, axis)
        encoder_offset = offset(board, axis)
        limit, current = limits_of(board, axis)
        for speed in speeds:
            write_axis(board, "cmd.speed", axis, speed * limit)
            follow(board, [], SETTLE)
            for part in currents:
                board.set_load(axis, part * current * motor.torque_constant)
                follow(board, [], SETTLE)
                trace = follow(board, [axis], MEASURED)[axis]
                if trace["faults"].any():
                    raise SimulationError(f"{axis_name(axis)} ended in a fault at {speed * limit / RPM:.0f} rpm")
                found[speed, part] = _point(trace, speed * limit, encoder_offset)
            board.set_load(axis, 0.0)
            follow(board, [], SETTLE)
    return found


def _point(trace: Trace, speed: float, encoder_offset: float) -> Point:
    """Evaluate a trace against the encoder, which is sampled simultaneously."""
    error = degrees(trace["angle"] - trace["used"] + math.radians(encoder_offset))
    mean = float(error.mean())
    amplitude = float(np.abs(error - mean).max())
    return Point(speed, float(trace["i_q"].mean()), mean, float(error.std()), amplitude, trace)


def theoretical_error(motor: AxisPlant, nominal: AxisPlant, speed: float, i_q: float) -> float:
    """Theoretical error of the observed angle [deg] of a motor with wrong nominal values."""
    l_s = 0.5 * (nominal.l_d + nominal.l_q)
    emf = motor.psi_m + (motor.r_s - nominal.r_s) * i_q / (motor.pole_pairs * speed)
    return math.degrees(math.atan2((motor.l_q - l_s) * i_q, emf))


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes."""
    for axis in range(AXES):
        name = axis_name(axis)
        points = measure(plant, seed, axis, SPEEDS, CURRENTS)
        beyond, allowed = _worst(plant, axis, points)
        yield Judge(f"{name}, ", NOT_SHOWN)("largest mean error", beyond, "deg", maximum=allowed)
        for point in points.values():
            yield (
                f"{name} at {point.speed / RPM:.0f} rpm, {point.i_q:.2f} A: mean error {point.mean:+.2f} deg, "
                f"deviation {point.deviation:.2f} deg, amplitude {point.amplitude:.2g} deg"
            )
        yield from _sensitivity(plant, seed, axis, points)
        slow, doubled = points[SPEEDS[0], 0.5], _uncompensated(plant, seed, axis)
        what = f"{name} at {slow.speed / RPM:.0f} rpm"
        judge = Judge(f"{what}, ", NOT_SHOWN)
        ratio = doubled.amplitude / max(slow.amplitude, 1e-9)
        yield judge("amplitude with compensation", slow.amplitude, "deg", maximum=RIPPLE)
        yield judge("amplitude without / with compensation", ratio, "", AMPLITUDE_RATIO_MIN)
        yield f"{what}, without compensation: amplitude {doubled.amplitude:.3g} deg"
        yield _over_speed(name, points)
        errors = {"dead time compensated": slow, "not compensated": doubled}
        curves = [
            Curve(label, error.trace.time, degrees(error.trace["angle"] - error.trace["used"]) - error.mean)
            for label, error in errors.items()
        ]
        yield Panel(f"{what}, {slow.i_q:.2g} A: error minus its mean", "time [s]", "error [deg]", curves)


def _uncompensated(plant: PlantConfig, seed: int, axis: int) -> Point:
    """200 rpm and half of the current with twice the dead time and drops, half of them compensated."""
    motor = plant.axes[axis]
    worse = plant.with_axis(axis, dead_time=2.0 * motor.dead_time, v_drop=2.0 * motor.v_drop)
    return measure(worse, seed, axis, SPEEDS[:1], (0.5,))[SPEEDS[0], 0.5]


def _worst(plant: PlantConfig, axis: int, points: Mapping[tuple[float, float], Point]) -> tuple[float, float]:
    """Error and permitted error of the point with the largest relative error [deg]."""
    motor, lost = plant.axes[axis], dead_voltage(plant, axis)
    found: list[tuple[float, float]] = []
    for point in points.values():
        beyond = max(abs(point.mean) - abs(theoretical_error(motor, motor, point.speed, point.i_q)), 0.0)
        found.append((beyond, max(ERROR_MAX, math.degrees(UNCOMPENSATED * lost / back_emf(motor, point.speed)))))
    return max(found, key=lambda pair: (pair[0] / pair[1], pair))


def _sensitivity(
    plant: PlantConfig, seed: int, axis: int, nominal: Mapping[tuple[float, float], Point]
) -> Iterator[Row]:
    """Change of the mean error by another winding, compared with theory."""
    motor = plant.axes[axis]
    for r_s, inductance in WINDINGS:
        changes = {"r_s": r_s * motor.r_s, "l_d": inductance * motor.l_d, "l_q": inductance * motor.l_q}
        other = plant.with_axis(axis, **changes)
        speeds = tuple(speed for speed in SENSITIVE if _observable(motor, nominal[speed, SENSITIVE_CURRENT]))
        away, largest = 0.0, 0.0
        for (speed, part), point in measure(other, seed, axis, speeds, (SENSITIVE_CURRENT,)).items():
            before = nominal[speed, part]
            change, theory = point.mean - before.mean, theoretical_error(motor, motor, point.speed, before.i_q)
            expected = theoretical_error(other.axes[axis], motor, point.speed, point.i_q) - theory
            away, largest = max(away, abs(change - expected)), max(largest, abs(change))
        label, reference = f"Ls x {inductance:g}", "moderately sensitive to Ls"
        if r_s != 1.0:
            label, reference = f"Rs x {r_s:g}", "not very sensitive to Rs"
        judge = Judge(f"{axis_name(axis)}, {label}, ", reference)
        if r_s != 1.0:
            yield judge("change of the error", largest, "deg", maximum=THEORY_ERROR_MAX)
        yield judge("difference between measured and theoretical change", away, "deg", maximum=THEORY_ERROR_MAX)


def _observable(motor: AxisPlant, point: Point) -> bool:
    """True if the voltage at the resistance is at most the back-EMF."""
    return motor.r_s * abs(point.i_q) <= back_emf(motor, point.speed)


def _over_speed(name: str, points: Mapping[tuple[float, float], Point]) -> Panel:
    curves: list[Curve] = []
    for part in CURRENTS:
        chosen = [points[speed, part] for speed in SPEEDS]
        x = np.array([point.speed / RPM for point in chosen])
        label = f"{np.mean([point.i_q for point in chosen]):.2g} A"
        curves.append(Curve(f"mean, {label}", x, np.array([point.mean for point in chosen]), "o-"))
        curves.append(Curve(f"deviation, {label}", x, np.array([point.deviation for point in chosen]), "x--"))
    return Panel(f"{name}: error of the observed angle", "speed [rpm]", "error [deg]", curves, log_x=True)
