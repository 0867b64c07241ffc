"""What real shafts, irons and magnets have beyond the plant of the reference design, as the drive sees it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board
from servo_twin.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.experiments.rig import TICK, Recording, choose_mode, set_axis, set_up, spinning, watch
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "real-shaft"
HELP: Final = """\
Each effect of the plant that is off by default, one at a time: a second mass behind an elastic shaft, backlash,
cogging, an eccentric encoder disc, saturation, warm magnet and winding (servo_twin/doc/plant.md). The effect is
measured in the signals of the drive or in the load; the bound is the equation of the effect. The reference design has
none of them."""

RESONANCE: Final = 150.0  # [Hz]
GAP: Final = 0.02  # [rad]
ECCENTRICITY: Final = 0.01  # [rad]
COGGING: Final = 0.15  # of the torque of 1 A
PERIODS: Final = 12.0  # of it, per turn
I_SATURATION: Final = 2.0  # [A]
HOT: Final = 75.0  # [deg C]
WEAKER: Final = -0.002  # of the magnet [1/K]
COPPER: Final = 3.93e-3  # of the winding [1/K]

FAST: Final = 60.0  # [rad/s]
SLOW: Final = 4.0  # [rad/s]: what passes in a second is well within the speed loop
SETTLE: Final = 0.4  # [s]
RING: Final = 0.06  # [s]
FINE: Final = PERIOD_NS * 1e-9  # [s]


@dataclass(frozen=True)
class Seen:
    """One figure with its curve."""

    value: float  # what the drive shows, in the unit of the effect
    expected: float  # what the equation says, likewise
    x: NDArray[np.float64]  # (n,), of the curve
    y: NDArray[np.float64]  # (n,), of the curve


@dataclass(frozen=True)
class Effect:
    """One part of the plant."""

    name: str  # of its figure
    unit: str
    tolerance: float  # of the figure, relative to what the equation says
    changes: Callable[[AxisPlant], Mapping[str, float]]  # values of the plant for a motor
    measure: Callable[[Board, int], Seen]  # the figure of an axis on a board that spins
    x_label: str
    y_label: str


# ---- measurements ----------------------------------------------------------------------------------------------------


def wave(angle: NDArray[np.float64], signal: NDArray[np.float64]) -> float:
    """Amplitude, in the unit of the signal, of what repeats with an angle [rad]; both (samples,)."""
    matrix = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle), angle], axis=1)
    return float(np.hypot(*np.linalg.lstsq(matrix, signal, rcond=None)[0][:2]))


def ringing(board: Board, axis: int) -> Seen:
    """The frequency at which the measured speed swings after a step of the torque."""
    shaft = board.plant.axes[axis]
    choose_mode(board, axis, "TORQUE")
    set_axis(board, "cmd.i_q", axis, 0.5)
    part = watch(board, [axis], RING)[axis]
    time, speed = part.time[2:], part.speed[2:]
    frequencies = np.arange(0.5, 1.5, 1e-3) * RESONANCE
    trend = np.stack([np.ones_like(time), time, time**2], axis=1)

    def left(frequency: float) -> float:
        x = 2.0 * np.pi * frequency * time
        matrix = np.column_stack([trend, np.sin(x), np.cos(x)])
        return float(np.std(speed - matrix @ np.linalg.lstsq(matrix, speed, rcond=None)[0]))

    return Seen(float(frequencies[np.argmin([left(f) for f in frequencies])]), shaft.resonance, part.time, part.speed)


def held_speed(board: Board, axis: int, speed: float, seconds: float) -> Recording:
    """Recording of so many seconds at a speed [rad/s]."""
    set_up(board, axis, "SPEED", speed)
    watch(board, [axis], SETTLE)
    return watch(board, [axis], seconds)[axis]


def lost_motion(board: Board, axis: int) -> Seen:
    """How far the load goes against the encoder, pushed to and fro while the drive holds the rotor."""
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
    way = float(high[-part:].mean() - low[-part:].mean())
    expected = shaft.backlash + 2.0 * torque / shaft.shaft_stiffness
    return Seen(way, expected, TICK * np.arange(1.0, 2.0 * low.size + 1.0), np.array(load))


def speed_ripple(board: Board, axis: int) -> Seen:
    """True speed of a shaft whose controller keeps that of the disc constant."""
    shaft = board.plant.axes[axis]
    part = held_speed(board, axis, FAST, 0.5)
    return Seen(wave(part.theta, part.omega), shaft.disc_eccentricity * FAST, part.time, part.omega)


def current_ripple(board: Board, axis: int) -> Seen:
    """Current with which the speed loop answers the cogging."""
    shaft = board.plant.axes[axis]
    part = held_speed(board, axis, SLOW, 2.0)
    amplitude = wave(shaft.cogging_periods * part.theta, part.i_q)
    return Seen(amplitude, shaft.cogging_torque / shaft.torque_constant, part.theta - part.theta[0], part.i_q)


def step_of_current(board: Board, axis: int, low: float, high: float) -> NDArray[np.float64]:
    """Voltage and current of the q axis, a PWM period each, with the shaft held, around a step; shape (2, n)."""
    name = axis_name(axis)
    choose_mode(board, axis, "TORQUE")
    set_axis(board, "cmd.i_q", axis, low)
    board.run(0.02)
    variables = [board.catalogue[f"{name}.{signal}"] for signal in ("u_q", "i_q")]
    board.sample(0, [(variable, 0) for variable in variables], 1000)
    board.run(0.015)
    set_axis(board, "cmd.i_q", axis, high)
    board.run(0.015)
    points = board.sampled()
    board.end_sampling()
    columns = [points[name].astype(np.float64) for name in points.dtype.names or ()]
    return np.array([column * float(v.lsb) for column, v in zip(columns, variables, strict=True)])


def levels(signal: NDArray[np.float64]) -> tuple[float, float]:
    """Means at the beginning and at the end of a signal (samples,), in its unit."""
    return float(signal[:200].mean()), float(signal[-80:].mean())


def inductance(board: Board, axis: int) -> Seen:
    """Volt-seconds of a step of the current at twice the current of the saturation, by the step [H]."""
    shaft = board.plant.axes[axis]
    board.lock_shaft(axis)
    u, i = step_of_current(board, axis, 0.75 * I_SATURATION, 1.25 * I_SATURATION)
    (u_0, u_1), (i_0, i_1) = levels(u), levels(i)
    slope = (u_1 - u_0) / (i_1 - i_0)
    lost = u_0 + slope * (i - i_0)
    step = int(np.argmax(i > 0.5 * (i_0 + i_1)))
    around = slice(step - 16, step + 48)
    delay = slope * FINE  # a voltage acts in the period after that of the current it was computed from
    value = float(np.sum((u - lost)[around])) * FINE / (i_1 - i_0) - delay
    flux = [shaft.l_q * I_SATURATION * 2.0 * math.sinh(math.asinh(1.5 * x / I_SATURATION) / 3.0) for x in (i_0, i_1)]
    return Seen(1e3 * value, 1e3 * (flux[1] - flux[0]) / (i_1 - i_0), 1e3 * FINE * np.arange(float(u.size)), u)


def resistance(board: Board, axis: int) -> Seen:
    """Step of the voltage by that of the current with the shaft held, winding warm."""
    shaft = board.plant.axes[axis]
    board.set_winding(axis, HOT)
    board.lock_shaft(axis)
    board.run(0.002)
    u, i = step_of_current(board, axis, 1.0, 2.5)
    (u_0, u_1), (i_0, i_1) = levels(u), levels(i)
    warm = shaft.r_s * (1.0 + COPPER * (HOT - board.plant.ambient)) + shaft.r_on
    return Seen((u_1 - u_0) / (i_1 - i_0), warm, 1e3 * FINE * np.arange(float(u.size)), u)


def magnet(board: Board, axis: int) -> Seen:
    """Flux by the voltage at two speeds under the same load, which leaves dead times and resistance out."""
    shaft = board.plant.axes[axis]
    board.set_magnet(axis, HOT)
    board.set_load(axis, 0.5 * shaft.torque_constant)
    parts = [held_speed(board, axis, speed, 0.3) for speed in (FAST, 3.0 * FAST)]
    u, speed = ([float(getattr(part, name).mean()) for part in parts] for name in ("u_q", "omega"))
    value = (u[1] - u[0]) / (shaft.pole_pairs * (speed[1] - speed[0]))
    expected = shaft.psi_m * (1.0 + WEAKER * (HOT - board.plant.ambient))
    return Seen(1e3 * value, 1e3 * expected, parts[1].time, parts[1].u_q)


# ---- the parts of the plant ------------------------------------------------------------------------------------------


def second_mass(shaft: AxisPlant, frequency: float) -> dict[str, float]:
    """As heavy as the rotor, on a shaft of this natural frequency [Hz] that is damped by 2 %."""
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
        lambda a: {**second_mass(a, 4.0 * RESONANCE), "backlash": GAP}, lost_motion, "time [s]", "load - rotor [rad]",
    ),
    Effect(
        "ripple of the true speed, once per turn", "rad/s", 0.2,
        lambda a: {"disc_eccentricity": ECCENTRICITY}, speed_ripple, "time [s]", "speed [rad/s]",
    ),
    Effect(
        "current that answers the cogging", "A", 0.1,
        lambda a: {"cogging_torque": COGGING * a.torque_constant, "cogging_periods": PERIODS},
        current_ripple, "angle [rad]", "i_q [A]",
    ),
    Effect(
        "L_q at the saturation's current", "mH", 0.1,
        lambda a: {"i_saturation_q": I_SATURATION}, inductance, "time [ms]", "u_q [V]",
    ),
    Effect(
        "R of a warm winding", "ohm", 0.05,
        lambda a: {"winding_warms": 1.0, "winding_capacity": 1e6}, resistance, "time [ms]", "u_q [V]",
    ),
    Effect(
        "psi_m of a warm magnet", "mV s", 0.03,
        lambda a: {"magnet_coefficient": WEAKER, "magnet_time": 1e6}, magnet, "time [s]", "u_q [V]",
    ),
)  # fmt: skip
"""Each part alone."""


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every part on both axes."""
    for effect in EFFECTS:
        curves: list[Curve] = []
        for axis in range(AXES):
            changed = plant.with_axis(axis, **effect.changes(plant.axes[axis]))
            with spinning(changed, seed) as board:
                seen = effect.measure(board, axis)
            judge, off = Judge(f"{axis_name(axis)}, "), effect.tolerance * seen.expected
            yield judge.near(effect.name, seen.value, effect.unit, seen.expected, off)
            curves.append(Curve(axis_name(axis), seen.x, seen.y))
        yield Panel(effect.name, effect.x_label, effect.y_label, curves)
