"""Braking: two shafts on a bus without energy recovery, brake resistor and its energy budget, winding short."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import active, write_axis
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.servo_config import servo_table
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.plant_limits import over_voltage, top_speed
from servo_twin.validation.experiments.rig import RPM, largest, set_up, spinning

NAME: Final = "braking"
HELP: Final = """\
Both axes brake simultaneously from 3500 rpm with a supply that cannot absorb energy, with and without a brake
resistor; the energy budget of the resistor; the current of shorted windings over speed, and the speed above which
the short is refused. The ST training describes both kinds of braking and gives the steady-state current of the short
as K_e w / sqrt(R_s^2 + w^2 L_s^2), to be compared with the current limit first; it shows no measurement. The energy
stored in both shafts would raise the bus above 33 V."""

BRAKE_FROM: Final = 3500.0 * RPM  # largest initial speed
RESISTOR: Final = 4.7  # nominal value of the firmware, also where the plant has none [ohm]
ON: Final = 28.0  # switching threshold of the brake resistor [V]
BUDGET: Final = 60.0  # energy budget of the resistor [J]
POWER: Final = 10.0  # continuous power of the resistor [W]
RECOVERED: Final = 0.5  # fraction of the budget at which the resistor is used again
FILTER_DELAY: Final = 1.5e-3  # filter of the bus voltage, slow tick [s]
MARGIN: Final = 0.2  # noise and PWM ripple of the voltage [V]
CURRENT: Final = 4.0  # current limit of the drive [A]
BUDGET_SUPPLY: Final = 30.0  # supply above ON [V]
SLIDE_SPEED: Final = 1450.0 * RPM  # speed above which the short is refused, according to the slide
INERTIA_FACTOR: Final = (
    8.0  # factor of the inertia, for a slow deceleration compared with the time constant of the winding
)
SETTLED: Final = 8.0  # time constants of the winding
NEAR: Final = 0.04  # relative distance from the refusal speed, on both sides
RUN_UP: Final = 1.0  # [s]
COAST_TIME: Final = 30.0  # largest time of a winding short; at low speed only friction brakes [s]
STOP_TIME: Final = 4.0  # largest time of a stop [s]
STANDSTILL: Final = 2.0 * RPM * 5.0  # [rad/s]
CURRENT_TOLERANCE: Final = 0.05
"""Permitted deviation of the short current from the formula, relative to the largest: the speed is not constant."""

SHORT: Final = 1.0  # stop category


_SPEEDS: Final = tuple(f"{axis_name(axis)}.omega" for axis in range(AXES))


@dataclass(frozen=True)
class Stop:
    """Stop of both axes."""

    trace: Trace  # true bus voltage ``u_dc`` [V], speeds `_SPEEDS` [rad/s], energy ``dissipated`` in the resistor [J]
    flags: frozenset[str]  # reported limits and faults

    @property
    def seconds(self) -> float | None:
        """Time to standstill of both axes [s]."""
        moving = np.nonzero(np.abs(self.trace.table(_SPEEDS)).max(axis=1) > STANDSTILL)[0]
        last = int(moving[-1]) + 1 if moving.size else 0
        return None if last == len(self.trace) else last * TICK


def _run_up(board: Board, speed: float) -> None:
    """Accelerate both axes to a speed, then set the largest acceleration limit."""
    for axis in range(AXES):
        limit = min(1.01 * speed, largest(board, "speed_limit"))
        set_up(board, axis, "SPEED", speed, parameters={"speed_limit": limit})
    board.run(RUN_UP)
    for axis in range(AXES):
        write_axis(board, "param.acceleration_limit", axis, largest(board, "acceleration_limit"))
    board.run(10 * TICK)


def stop(plant: PlantConfig, seed: int, speed: float, resistor: float) -> Stop:
    """Brake both axes simultaneously; `resistor` 0: none [ohm]."""
    with spinning(plant.with_bus(r_brake=resistor), seed) as board:
        board.write("param.brake", float(resistor > 0.0))
        _run_up(board, speed)
        rows: list[tuple[float, float, float, float]] = []
        flags: set[str] = set()
        for axis in range(AXES):
            write_axis(board, "cmd.speed", axis, 0.0)
        for _ in range(round(STOP_TIME / TICK)):
            board.run(TICK)
            flags.update(*(active(board, axis, name) for axis in range(AXES) for name in ("limits", "faults")))
            one, other = board.truth(0), board.truth(1)
            rows.append((one.u_dc, one.omega_m, other.omega_m, one.e_brake))
            if max(abs(one.omega_m), abs(other.omega_m)) < 0.1 and len(rows) * TICK > 0.2:
                break
    columns = zip(("u_dc", *_SPEEDS, "dissipated"), np.array(rows).T, strict=True)
    return Stop(Trace(TICK, dict(columns), first=1), frozenset(flags))


def kinetic(plant: PlantConfig, speed: float) -> float:
    """Kinetic energy of both shafts [J]."""
    return sum(0.5 * axis.inertia * speed**2 for axis in plant.axes)


def lossless(plant: PlantConfig, speed: float) -> float:
    """Final bus voltage without losses [V]."""
    return math.sqrt(plant.bus.u_source**2 + 2.0 * kinetic(plant, speed) / plant.bus.capacitance)


@dataclass(frozen=True)
class Budget:
    """Energy budget of the resistor with a supply above the switching threshold."""

    dissipated: float  # energy until switched off [J]
    seconds: float  # time until switched off [s]
    recovery_time: float | None  # time until used again [s]


def use_budget(plant: PlantConfig, seed: int, resistor: float) -> Budget:
    """Supply above the switching threshold until the budget is used and the `resistor` [ohm] is switched on again."""
    with spinning(plant.with_bus(r_brake=resistor), seed) as board:
        board.write("param.brake", 1.0)
        board.set_supply(BUDGET_SUPPLY)
        start = board.truth(0).e_brake
        times: list[float] = []
        dissipated = [start]
        was_on = False
        while len(times) < 3 and board.time_ns < 40e9:
            board.run(TICK)
            dissipated.append(board.truth(0).e_brake)
            on = dissipated[-1] > dissipated[-2]
            if on != was_on:
                was_on = on
                times.append(board.time_ns * 1e-9)
            if len(times) == 2 and not on:
                board.run(20 * TICK)
        if len(times) < 2:
            return Budget(dissipated[-1] - start, math.nan, None)
        return Budget(dissipated[-2] - start, times[1] - times[0], times[2] - times[1] if len(times) > 2 else None)


def short_current(axis: AxisPlant, omega: float, *, drops: bool) -> float:
    """Steady-state current of shorted windings at a mechanical speed [A], as on the slide or with switch drops."""
    w = axis.pole_pairs * omega
    inductance = 0.5 * (axis.l_d + axis.l_q)
    resistance = axis.r_s + (axis.r_on if drops else 0.0)
    reactance, emf = w * inductance, w * axis.psi_m
    drop = 4.0 / math.pi * axis.v_drop if drops else 0.0  # fundamental of a square wave that opposes the current
    # emf^2 = (R i + drop)^2 + (X i)^2
    b, square = resistance * drop, resistance**2 + reactance**2
    root = b**2 - square * (drop**2 - emf**2)
    return max((math.sqrt(root) - b) / square, 0.0) if root > 0.0 else 0.0


def refusal_speed(axis: AxisPlant) -> float:
    """Mechanical speed above which the current of the slide exceeds the limit [rad/s]."""
    inductance = 0.5 * (axis.l_d + axis.l_q)
    limit = float(servo_table()["defaults"]["stop"]["short_current"])
    margin = axis.psi_m**2 - (limit * inductance) ** 2
    return math.inf if margin <= 0.0 else limit * axis.r_s / math.sqrt(margin) / axis.pole_pairs


def short(
    plant: PlantConfig, seed: int, axis: int, speed: float, seconds: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Accelerate an axis and disable it with a winding short: speed [rad/s] and current [A]."""
    with spinning(plant.with_axis(axis, inertia=INERTIA_FACTOR * plant.axes[axis].inertia), seed) as board:
        board.write("param.on_disable", [SHORT] * AXES)
        set_up(board, axis, "SPEED", speed)
        board.run(RUN_UP)
        board.write("cmd.enable", [0.0] * AXES)
        board.run(2 * TICK)
        rows: list[tuple[float, float]] = []
        for _ in range(round(seconds / TICK)):
            board.run(TICK)
            truth = board.truth(axis)
            rows.append((truth.omega_m, math.hypot(truth.i_d, truth.i_q)))
            if truth.omega_m == 0.0:
                break
    omega, current = np.array(rows).T
    return omega, current


# ---- figures ---------------------------------------------------------------------------------------------------------


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """The bus with both axes, the energy budget, and the winding short of each axis."""
    speed = top_speed(plant.with_bus(capacitance=1.0), range(AXES), BRAKE_FROM)  # without the limit by the bus
    resistor = plant.bus.r_brake or RESISTOR
    without, with_one = stop(plant, seed, speed, 0.0), stop(plant, seed, speed, resistor)
    budget = use_budget(plant, seed, resistor)
    yield from _rows_bus(Judge("no resistor: ", NOT_SHOWN), plant, speed, without, over_voltage())
    judge = Judge("resistor: ", NOT_SHOWN)
    yield from _rows_bus(judge, plant, speed, with_one, _with_resistor(plant, speed, resistor))
    yield judge("energy dissipated in the resistor", with_one.trace["dissipated"][-1], "J", 0.0, kinetic(plant, speed))
    judge = Judge("budget: ", NOT_SHOWN)
    permitted = (BUDGET + POWER * budget.seconds) * (
        RESISTOR / resistor
    )  # the firmware calculates with the nominal one
    recovery_time = (1.0 - RECOVERED) * BUDGET / POWER
    yield judge("energy until the resistor is switched off", budget.dissipated, "J", 0.95 * permitted, 1.05 * permitted)
    yield judge("recovery time", budget.recovery_time, "s", 0.95 * recovery_time, 1.05 * recovery_time)
    curves: list[Curve] = []
    for name, result in (("no resistor", without), ("resistor", with_one)):
        trace = result.trace
        curves.append(Curve(f"bus, {name} [V]", trace.time, trace["u_dc"]))
        for axis, of in enumerate(_SPEEDS):
            curves.append(Curve(f"{axis_name(axis)}, {name} [100 rpm]", trace.time, trace[of] / RPM / 100.0, "--"))
    yield Panel("both axes brake simultaneously", "time [s]", "bus [V], speed [100 rpm]", curves)
    for axis in range(AXES):
        yield from _short(plant, seed, axis)
    yield f"from {speed / RPM:.4g} rpm: {kinetic(plant, speed):.3g} J, {lossless(plant, speed):.3g} V without losses"
    yield f"resistor {resistor:g} ohm; without it the limits were {', '.join(sorted(without.flags)) or 'none'}"
    carried = [short_current(plant.axes[0], SLIDE_SPEED, drops=drops) for drops in (False, True)]
    what = f"axis 1 short at {SLIDE_SPEED / RPM:g} rpm"
    yield f"{what}: {carried[0]:.3g} A by the formula, {carried[1]:.3g} A with drops"


def _with_resistor(plant: PlantConfig, speed: float, resistor: float) -> float:
    """Highest bus voltage with the resistor [V]: rise until it is on, or over-voltage if it is too weak."""
    current = sum(_returned(axis, speed) for axis in plant.axes) / ON
    excess = max(current - ON / resistor, 0.0)
    if excess > 0.0:
        return over_voltage()
    return ON + current * FILTER_DELAY / plant.bus.capacitance + MARGIN


def _returned(axis: AxisPlant, speed: float) -> float:
    """Power of a braking motor at the current limit, minus the losses of winding and switches [W]."""
    emf = axis.pole_pairs * axis.psi_m * speed
    lost = (axis.r_s + axis.r_on) * CURRENT + 4.0 / math.pi * axis.v_drop
    return 1.5 * CURRENT * max(emf - lost, 0.0)


def _rows_bus(judge: Judge, plant: PlantConfig, speed: float, result: Stop, maximum: float) -> Iterator[Row]:
    faults = {flag.name for flag in Catalogue.load().flags["faults"]}
    yield judge(
        "highest bus voltage",
        result.trace["u_dc"].max(),
        "V",
        plant.bus.u_source,
        maximum,
        reference="below the limit, 33 V",
    )
    yield judge.none("faults", len(result.flags & faults), reference="none")
    yield judge("stop time of both axes", result.seconds, "s", 0.0, _longest(plant, speed))


def _longest(plant: PlantConfig, speed: float) -> float:
    """Largest stop time, with braking by friction and half of the copper losses at full current only [s]."""
    times = []
    for axis in plant.axes:
        copper = 0.5 * 1.5 * axis.r_s * 3.0**2
        friction = (axis.friction + axis.viscous * speed) * 0.5 * speed
        times.append(0.5 * axis.inertia * speed**2 / (copper + friction))
    return 0.1 + 1.5 * max(times)


def _short(plant: PlantConfig, seed: int, axis: int) -> Iterator[Row | Panel]:
    motor, judge = plant.axes[axis], Judge(f"{axis_name(axis)}: ")
    refused = refusal_speed(PlantConfig.load().axes[axis])  # the firmware uses its nominal values
    below, above = (1.0 - NEAR) * refused, (1.0 + NEAR) * refused
    omega, current = short(plant, seed, axis, below, COAST_TIME)
    _, beyond = short(plant, seed, axis, above, 0.01)
    speeds = np.abs(omega)
    formula, slide = (np.array([short_current(motor, w, drops=drops) for w in speeds]) for drops in (True, False))
    settled = SETTLED * motor.l_q / motor.r_s  # the initial current has decayed
    moving = (speeds > 0.1 * below) & (TICK * np.arange(speeds.size) > settled)
    off = float(np.abs(current - formula)[moving].max() / formula.max())
    # Permitted deviation: the drops are square waves; the 5th and 7th harmonic add up.
    harmonics = 4.0 / math.pi * motor.v_drop * (1.0 / 5.0 + 1.0 / 7.0)
    maximum = CURRENT_TOLERANCE + harmonics / (motor.r_s + motor.r_on) / float(formula.max())
    over, law = (current[moving] / slide[moving]).max(), "K_e w / sqrt(R^2 + w^2 L^2)"
    yield judge.true(f"short at {below / RPM:.0f} rpm", current.max() > 0.0, reference="allowed")
    yield judge.none(f"short at {above / RPM:.0f} rpm", beyond.max() > 0.0, reference="refused above some 1450 rpm")
    yield judge("deviation of the current from the formula", off, "of largest", maximum=maximum, reference=law)
    yield judge("current relative to the slide", over, "", 0.3, 1.02, reference="an upper bound: it has no drops")
    yield judge("speed after the short", speeds[-1] / RPM, "rpm", 0.0, 1.0, reference="rest")
    curves = (
        Curve("measured", speeds / RPM, current, "."),
        Curve("formula with drops", speeds / RPM, formula),
        Curve("formula of the slide", speeds / RPM, slide),
    )
    yield Panel(f"{axis_name(axis)}: windings shorted", "speed [rpm]", "current [A]", curves)
