"""Effects of elasticity, backlash, cogging, eccentricity, saturation and temperature in the signals of the drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import choose, write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD, TICK

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import record, set_up, spinning

NAME: Final = "real-shaft"
HELP: Final = """\
Each effect of the plant that is off by default, one at a time: a second mass behind an elastic shaft, backlash,
cogging, an eccentric encoder disc, saturation, warm magnet and winding (servo_twin/doc/plant.md). The effect is
measured in the signals of the drive or in the load; the bound is the equation of the effect. The reference design has
none of them."""

RESONANCE: Final = 150.0  # [Hz]
GAP: Final = 0.02  # [rad]
ECCENTRICITY: Final = 0.01  # [rad]
COGGING: Final = 0.15  # cogging torque, relative to the torque of 1 A
PERIODS: Final = 12.0  # cogging periods per revolution
I_SATURATION: Final = 2.0  # [A]
HOT: Final = 75.0  # [deg C]
MAGNET_COEFFICIENT: Final = -0.002  # temperature coefficient of the magnet [1/K]
COPPER: Final = 3.93e-3  # temperature coefficient of the winding [1/K]

FAST: Final = 60.0  # [rad/s]
SLOW: Final = 4.0  # [rad/s]: cogging well within the bandwidth of the speed loop
SETTLE: Final = 0.4  # [s]
RING: Final = 0.06  # recording of the resonance [s]


@dataclass(frozen=True)
class Comparison:
    """Measured and predicted figure, with its curve."""

    measured: float  # from the signals of the drive, in the unit of the effect
    predicted: float  # from the equation, in the unit of the effect
    x: NDArray[np.float64]  # (n,), of the curve
    y: NDArray[np.float64]  # (n,), of the curve


@dataclass(frozen=True)
class Effect:
    """One effect of the plant."""

    name: str  # name of the figure
    unit: str
    tolerance: float  # permitted deviation, relative to the prediction
    changes: Callable[[AxisPlant], Mapping[str, float]]  # changed values of the plant for a motor
    measure: Callable[[Board, int], Comparison]  # measures an axis of a board in closed-loop control
    x_label: str
    y_label: str


# ---- measurements ----------------------------------------------------------------------------------------------------


def wave(angle: NDArray[np.float64], signal: NDArray[np.float64]) -> float:
    """Amplitude of the component of a signal with the period of an angle [rad]; both (samples,)."""
    matrix = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle), angle], axis=1)
    return float(np.hypot(*np.linalg.lstsq(matrix, signal, rcond=None)[0][:2]))


def ringing(board: Board, axis: int) -> Comparison:
    """Frequency of the oscillation of the measured speed after a torque step."""
    shaft = board.plant.axes[axis]
    choose(board, "cmd.mode", axis, "TORQUE")
    write_axis(board, "cmd.i_q", axis, 0.5)
    part = record(board, [axis], RING)[axis]
    time, speed = part.time[2:], part["speed"][2:]
    frequencies = np.arange(0.5, 1.5, 1e-3) * RESONANCE
    trend = np.stack([np.ones_like(time), time, time**2], axis=1)

    def residual(frequency: float) -> float:
        x = 2.0 * np.pi * frequency * time
        matrix = np.column_stack([trend, np.sin(x), np.cos(x)])
        return float(np.std(speed - matrix @ np.linalg.lstsq(matrix, speed, rcond=None)[0]))

    return Comparison(
        float(frequencies[np.argmin([residual(f) for f in frequencies])]), shaft.resonance, part.time, part["speed"]
    )


def held_speed(board: Board, axis: int, speed: float, seconds: float) -> Trace:
    """Recording of `seconds` [s] at a constant speed [rad/s]."""
    set_up(board, axis, "SPEED", speed)
    record(board, [axis], SETTLE)
    return record(board, [axis], seconds)[axis]


def measure_backlash(board: Board, axis: int) -> Comparison:
    """Backlash, measured as motion of the load under alternating torque with the rotor held."""
    shaft = board.plant.axes[axis]
    torque = 0.5 * shaft.torque_constant
    load: list[float] = []
    for push in (torque, -torque):
        board.set_load(axis, push)
        for _ in range(round(SETTLE / TICK)):
            board.run(TICK)
            truth = board.truth(axis)
            load.append(truth.theta_load - truth.theta_m)
    low, high = np.array(load).reshape(2, -1)
    part = low.size // 4
    backlash = float(high[-part:].mean() - low[-part:].mean())
    predicted = shaft.backlash + 2.0 * torque / shaft.shaft_stiffness
    return Comparison(backlash, predicted, TICK * np.arange(1.0, 2.0 * low.size + 1.0), np.array(load))


def speed_ripple(board: Board, axis: int) -> Comparison:
    """Ripple of the true speed while the controller keeps the measured speed constant."""
    shaft = board.plant.axes[axis]
    part = held_speed(board, axis, FAST, 0.5)
    return Comparison(wave(part["theta"], part["omega"]), shaft.disc_eccentricity * FAST, part.time, part["omega"])


def current_ripple(board: Board, axis: int) -> Comparison:
    """Current of the speed loop that compensates the cogging."""
    shaft = board.plant.axes[axis]
    part = held_speed(board, axis, SLOW, 2.0)
    amplitude = wave(shaft.cogging_periods * part["theta"], part["i_q"])
    return Comparison(
        amplitude, shaft.cogging_torque / shaft.torque_constant, part["theta"] - part["theta"][0], part["i_q"]
    )


def step_of_current(board: Board, axis: int, low: float, high: float) -> NDArray[np.float64]:
    """Voltage and current of the q axis per PWM period, shaft locked, around a step of the current; shape (2, n)."""
    name = axis_name(axis)
    choose(board, "cmd.mode", axis, "TORQUE")
    write_axis(board, "cmd.i_q", axis, low)
    board.run(0.02)
    variables = [board.catalogue[f"{name}.{signal}"] for signal in ("u_q", "i_q")]
    board.sample(0, [(variable, 0) for variable in variables], 1000)
    board.run(0.015)
    write_axis(board, "cmd.i_q", axis, high)
    board.run(0.015)
    points = board.sampled()
    board.end_sampling()
    columns = [points[name].astype(np.float64) for name in points.dtype.names or ()]
    return np.array([column * float(v.lsb) for column, v in zip(columns, variables, strict=True)])


def levels(signal: NDArray[np.float64]) -> tuple[float, float]:
    """Means at the start and at the end of a signal (samples,), in its unit."""
    return float(signal[:200].mean()), float(signal[-80:].mean())


def inductance(board: Board, axis: int) -> Comparison:
    """Flux change by a current step around the saturation current, divided by the step [mH]."""
    shaft = board.plant.axes[axis]
    board.lock_shaft(axis)
    u, i = step_of_current(board, axis, 0.75 * I_SATURATION, 1.25 * I_SATURATION)
    (u_0, u_1), (i_0, i_1) = levels(u), levels(i)
    slope = (u_1 - u_0) / (i_1 - i_0)
    resistive = u_0 + slope * (i - i_0)
    step = int(np.argmax(i > 0.5 * (i_0 + i_1)))
    around = slice(step - 16, step + 48)
    delay = slope * PERIOD  # a voltage acts one period after the current sample
    measured = float(np.sum((u - resistive)[around])) * PERIOD / (i_1 - i_0) - delay
    flux = [shaft.l_q * I_SATURATION * 2.0 * math.sinh(math.asinh(1.5 * x / I_SATURATION) / 3.0) for x in (i_0, i_1)]
    return Comparison(
        1e3 * measured, 1e3 * (flux[1] - flux[0]) / (i_1 - i_0), 1e3 * PERIOD * np.arange(float(u.size)), u
    )


def resistance(board: Board, axis: int) -> Comparison:
    """Voltage step divided by current step, with locked shaft and warm winding [ohm]."""
    shaft = board.plant.axes[axis]
    board.set_winding(axis, HOT)
    board.lock_shaft(axis)
    board.run(0.002)
    u, i = step_of_current(board, axis, 1.0, 2.5)
    (u_0, u_1), (i_0, i_1) = levels(u), levels(i)
    warm = shaft.r_s * (1.0 + COPPER * (HOT - board.plant.ambient)) + shaft.r_on
    return Comparison((u_1 - u_0) / (i_1 - i_0), warm, 1e3 * PERIOD * np.arange(float(u.size)), u)


def magnet(board: Board, axis: int) -> Comparison:
    """Flux from the voltages at two speeds with the same load, so that dead time and resistance cancel [mV s]."""
    shaft = board.plant.axes[axis]
    board.set_magnet(axis, HOT)
    board.set_load(axis, 0.5 * shaft.torque_constant)
    parts = [held_speed(board, axis, speed, 0.3) for speed in (FAST, 3.0 * FAST)]
    u, speed = ([float(part[name].mean()) for part in parts] for name in ("u_q", "omega"))
    measured = (u[1] - u[0]) / (shaft.pole_pairs * (speed[1] - speed[0]))
    predicted = shaft.psi_m * (1.0 + MAGNET_COEFFICIENT * (HOT - board.plant.ambient))
    return Comparison(1e3 * measured, 1e3 * predicted, parts[1].time, parts[1]["u_q"])


# ---- effects of the plant --------------------------------------------------------------------------------------------


def second_mass(shaft: AxisPlant, frequency: float) -> dict[str, float]:
    """Second mass with the inertia of the rotor on a shaft with this resonance [Hz] and 2 % damping."""
    mass = 0.5 * shaft.inertia
    w = 2.0 * math.pi * frequency
    return {"load_inertia": shaft.inertia, "shaft_stiffness": mass * w**2, "shaft_damping": 0.04 * mass * w}


EFFECTS: Final = (
    Effect(
        "resonance in the speed", "Hz", 0.03,
        lambda a: second_mass(a, RESONANCE), ringing, "time [s]", "speed [rad/s]",
    ),
    Effect(
        "lost motion of the load", "rad", 0.05,
        lambda a: {**second_mass(a, 4.0 * RESONANCE), "backlash": GAP}, measure_backlash,
        "time [s]", "load - rotor [rad]",
    ),
    Effect(
        "ripple of the true speed, once per turn", "rad/s", 0.2,
        lambda a: {"disc_eccentricity": ECCENTRICITY}, speed_ripple, "time [s]", "speed [rad/s]",
    ),
    Effect(
        "current that compensates the cogging", "A", 0.1,
        lambda a: {"cogging_torque": COGGING * a.torque_constant, "cogging_periods": PERIODS},
        current_ripple, "angle [rad]", "i_q [A]",
    ),
    Effect(
        "L_q at the saturation current", "mH", 0.1,
        lambda a: {"i_saturation_q": I_SATURATION}, inductance, "time [ms]", "u_q [V]",
    ),
    Effect(
        "R of a warm winding", "ohm", 0.05,
        lambda a: {"winding_warms": 1.0, "winding_capacity": 1e6}, resistance, "time [ms]", "u_q [V]",
    ),
    Effect(
        "psi_m of a warm magnet", "mV s", 0.03,
        lambda a: {"magnet_coefficient": MAGNET_COEFFICIENT, "magnet_time": 1e6}, magnet, "time [s]", "u_q [V]",
    ),
)  # fmt: skip
"""Effects, each measured alone."""


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every effect on both axes."""
    for effect in EFFECTS:
        curves: list[Curve] = []
        for axis in range(AXES):
            changed = plant.with_axis(axis, **effect.changes(plant.axes[axis]))
            with spinning(changed, seed) as board:
                result = effect.measure(board, axis)
            judge, off = Judge(f"{axis_name(axis)}, "), effect.tolerance * result.predicted
            yield judge.near(effect.name, result.measured, effect.unit, result.predicted, off)
            curves.append(Curve(axis_name(axis), result.x, result.y))
        yield Panel(effect.name, effect.x_label, effect.y_label, curves)
