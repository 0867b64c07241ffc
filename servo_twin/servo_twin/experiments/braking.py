"""Braking: two shafts onto a bus that takes nothing back, the resistor and its budget, the winding short."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.experiments.plant_limits import OVER_VOLTAGE, top_speed
from servo_twin.experiments.rig import RPM, TICK, command_speed, flags_of, largest, set_axis, set_up, spinning
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "braking"
HELP: Final = """\
Both axes brake at once from 3500 rpm with a supply that cannot absorb energy, with and without a brake resistor; the
energy budget of the resistor; the current of shorted windings over speed, and the speed above which the short is
refused. The ST training describes both kinds of braking and gives the steady-state current of the short as K_e w /
sqrt(R_s^2 + w^2 L_s^2), to be compared with the current limit first; it shows no measurement. The energy stored in
both shafts would raise the bus above 33 V."""

BRAKE_FROM: Final = 3500.0 * RPM  # at most
RESISTOR: Final = 4.7  # nominal value of the firmware, also where the plant has none [ohm]
ON: Final = 28.0  # the firmware's resistor is on from here [V],
BUDGET: Final = 60.0  # may burn so much at once [J],
POWER: Final = 10.0  # bears so much for ever [W],
RESTED: Final = 0.5  # and is used again when this part of the budget is left
LATE: Final = 1.5e-3  # filter of the bus voltage, slow tick [s]
MARGIN: Final = 0.2  # noise of the voltage, and the ripple of the PWM [V]
CURRENT: Final = 4.0  # of the drive [A]
SPENDING: Final = 30.0  # supply that is above ON [V]
SHORT_LIMIT: Final = 8.25  # that the firmware allows in a short: the range of the shunts [A]
SLIDE_SPEED: Final = 1450.0 * RPM  # above which the short is said to be refused
HEAVY: Final = 8.0  # times the inertia: a speed that falls slowly against the windings' time constant
SETTLED: Final = 8.0  # time constants of the winding
NEAR: Final = 0.04  # of the refusal speed, to both sides of it
RUN_UP: Final = 1.0  # [s]
COAST_TIME: Final = 30.0  # at most, what friction has to do at last [s]
STOP_TIME: Final = 4.0  # at most [s]
STANDS: Final = 2.0 * RPM * 5.0  # [rad/s]
AGREE: Final = 0.05
"""Deviation of the short's current from the formula, of the largest, without drops: the speed is not quite steady."""

SHORT: Final = 1.0  # stop category


@dataclass(frozen=True)
class Stop:
    """Both axes from a speed to rest, one entry per slow tick."""

    u_dc: NDArray[np.float64]  # bus [V]
    omega: NDArray[np.float64]  # true speeds, shape (ticks, axes) [rad/s]
    burnt: NDArray[np.float64]  # in the resistor so far [J]
    flags: frozenset[str]  # limits and faults that came up

    @property
    def seconds(self) -> float | None:
        """Until both stand [s]."""
        moving = np.nonzero(np.abs(self.omega).max(axis=1) > STANDS)[0]
        last = int(moving[-1]) + 1 if moving.size else 0
        return None if last == self.u_dc.size else last * TICK


def _run_up(board: Board, speed: float) -> None:
    """Both axes to a speed, and from there as hard as the drive can."""
    for axis in range(AXES):
        limit = min(1.01 * speed, largest(board, "speed_limit"))
        set_up(board, axis, "SPEED", speed, parameters={"speed_limit": limit})
    board.run(RUN_UP)
    for axis in range(AXES):
        set_axis(board, "param.acceleration_limit", axis, largest(board, "acceleration_limit"))
    board.run(10 * TICK)


def stop(plant: PlantConfig, seed: int, speed: float, resistor: float) -> Stop:
    """Both brake at once; `resistor` 0: none [ohm]."""
    with spinning(plant.with_bus(r_brake=resistor), seed) as board:
        board.write("param.brake", float(resistor > 0.0))
        _run_up(board, speed)
        rows: list[tuple[float, float, float, float]] = []
        flags: set[str] = set()
        for axis in range(AXES):
            command_speed(board, axis, 0.0)
        for _ in range(round(STOP_TIME / TICK)):
            board.run(TICK)
            flags.update(*(flags_of(board, axis, name) for axis in range(AXES) for name in ("limits", "faults")))
            one, other = board.truth(0), board.truth(1)
            rows.append((one.u_dc, one.omega_m, other.omega_m, one.e_brake))
            if max(abs(one.omega_m), abs(other.omega_m)) < 0.1 and len(rows) * TICK > 0.2:
                break
    table = np.array(rows)
    return Stop(table[:, 0], table[:, 1:3], table[:, 3], frozenset(flags))


def kinetic(plant: PlantConfig, speed: float) -> float:
    """Energy of both shafts [J]."""
    return sum(0.5 * axis.inertia * speed**2 for axis in plant.axes)


def lossless(plant: PlantConfig, speed: float) -> float:
    """Where the bus would end if all of it came back [V]."""
    return math.sqrt(plant.bus.u_source**2 + 2.0 * kinetic(plant, speed) / plant.bus.capacitance)


@dataclass(frozen=True)
class Budget:
    """What a supply above the switching voltage does to the resistor."""

    burnt: float  # until it was switched off [J]
    seconds: float  # until then [s]
    rest: float | None  # until it was used again [s]


def spend(plant: PlantConfig, seed: int, resistor: float) -> Budget:
    """A supply above the switching voltage, until the budget is spent and the `resistor` [ohm] is used again."""
    with spinning(plant.with_bus(r_brake=resistor), seed) as board:
        board.write("param.brake", 1.0)
        board.set_supply(SPENDING)
        start = board.truth(0).e_brake
        times: list[float] = []
        burnt = [start]
        was_on = False
        while len(times) < 3 and board.time_ns < 40e9:
            board.run(TICK)
            burnt.append(board.truth(0).e_brake)
            on = burnt[-1] > burnt[-2]
            if on != was_on:
                was_on = on
                times.append(board.time_ns * 1e-9)
            if len(times) == 2 and not on:
                board.run(20 * TICK)
        if len(times) < 2:
            return Budget(burnt[-1] - start, math.nan, None)
        return Budget(burnt[-2] - start, times[1] - times[0], times[2] - times[1] if len(times) > 2 else None)


def short_current(axis: AxisPlant, omega: float, *, drops: bool) -> float:
    """Steady current of shorted windings at a mechanical speed [A], as on the slide or with what the switches drop."""
    w = axis.pole_pairs * omega
    inductance = 0.5 * (axis.l_d + axis.l_q)
    resistance = axis.r_s + (axis.r_on if drops else 0.0)
    reactance, emf = w * inductance, w * axis.psi_m
    drop = 4.0 / math.pi * axis.v_drop if drops else 0.0  # fundamental of a voltage that is against the current
    # emf^2 = (R i + drop)^2 + (X i)^2
    b, square = resistance * drop, resistance**2 + reactance**2
    root = b**2 - square * (drop**2 - emf**2)
    return max((math.sqrt(root) - b) / square, 0.0) if root > 0.0 else 0.0


def refusal_speed(axis: AxisPlant) -> float:
    """Mechanical speed above which the slide's current is more than the limit [rad/s]."""
    inductance = 0.5 * (axis.l_d + axis.l_q)
    rest = axis.psi_m**2 - (SHORT_LIMIT * inductance) ** 2
    return math.inf if rest <= 0.0 else SHORT_LIMIT * axis.r_s / math.sqrt(rest) / axis.pole_pairs


def short(
    plant: PlantConfig, seed: int, axis: int, speed: float, seconds: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Drive an axis to a speed and withdraw its drive with the windings shorted: speed [rad/s] and current [A]."""
    with spinning(plant.with_axis(axis, inertia=HEAVY * plant.axes[axis].inertia), seed) as board:
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
    """The bus with both axes, the budget, and each axis' winding short."""
    speed = top_speed(plant.with_bus(capacitance=1.0), range(AXES), BRAKE_FROM)  # whatever the bus can take
    resistor = plant.bus.r_brake or RESISTOR
    without, with_one = stop(plant, seed, speed, 0.0), stop(plant, seed, speed, resistor)
    budget = spend(plant, seed, resistor)
    yield from _rows_bus(Judge("no resistor: ", NOT_SHOWN), plant, speed, without, OVER_VOLTAGE)
    judge = Judge("resistor: ", NOT_SHOWN)
    yield from _rows_bus(judge, plant, speed, with_one, _with_resistor(plant, speed, resistor))
    yield judge("burnt in it", with_one.burnt[-1], "J", 0.0, kinetic(plant, speed))
    judge = Judge("budget: ", NOT_SHOWN)
    allowed = (BUDGET + POWER * budget.seconds) * (RESISTOR / resistor)  # computed with the nominal one
    rest = (1.0 - RESTED) * BUDGET / POWER
    yield judge("burnt until off", budget.burnt, "J", 0.95 * allowed, 1.05 * allowed)
    yield judge("rest until used again", budget.rest, "s", 0.95 * rest, 1.05 * rest)
    curves: list[Curve] = []
    for name, it in (("no resistor", without), ("resistor", with_one)):
        time = TICK * np.arange(1, it.u_dc.size + 1, dtype=np.float64)
        curves.append(Curve(f"bus, {name} [V]", time, it.u_dc))
        speeds = [(f"{axis_name(axis)}, {name} [100 rpm]", it.omega[:, axis]) for axis in range(AXES)]
        curves += [Curve(label, time, omega / RPM / 100.0, "--") for label, omega in speeds]
    yield Panel("both axes brake at once", "time [s]", "bus [V], speed [100 rpm]", curves)
    for axis in range(AXES):
        yield from _short(plant, seed, axis)
    yield f"from {speed / RPM:.4g} rpm: {kinetic(plant, speed):.3g} J, {lossless(plant, speed):.3g} V without losses"
    yield f"resistor {resistor:g} ohm; without it the limits were {', '.join(sorted(without.flags)) or 'none'}"
    carried = [short_current(plant.axes[0], SLIDE_SPEED, drops=drops) for drops in (False, True)]
    what = f"axis 1 short at {SLIDE_SPEED / RPM:g} rpm"
    yield f"{what}: {carried[0]:.3g} A by the formula, {carried[1]:.3g} A with drops"


def _with_resistor(plant: PlantConfig, speed: float, resistor: float) -> float:
    """Highest bus voltage with the resistor: what comes back until it is on, or all that it leaves over [V]."""
    current = sum(_returned(axis, speed) for axis in plant.axes) / ON
    left = max(current - ON / resistor, 0.0)
    if left > 0.0:
        return OVER_VOLTAGE
    return ON + current * LATE / plant.bus.capacitance + MARGIN


def _returned(axis: AxisPlant, speed: float) -> float:
    """Power of a braking motor at the current that the drive has, less what winding and switches burn [W]."""
    emf = axis.pole_pairs * axis.psi_m * speed
    lost = (axis.r_s + axis.r_on) * CURRENT + 4.0 / math.pi * axis.v_drop
    return 1.5 * CURRENT * max(emf - lost, 0.0)


def _rows_bus(judge: Judge, plant: PlantConfig, speed: float, it: Stop, maximum: float) -> Iterator[Row]:
    faults = {flag.name for flag in Catalogue.load().flags["faults"]}
    yield judge(
        "highest bus voltage", it.u_dc.max(), "V", plant.bus.u_source, maximum, reference="below the limit, 33 V"
    )
    yield judge.none("faults", len(it.flags & faults), reference="none")
    yield judge("both stand after", it.seconds, "s", 0.0, _longest(plant, speed))


def _longest(plant: PlantConfig, speed: float) -> float:
    """A stop in which nothing but friction and half of the copper's losses at full current brake [s]."""
    times = []
    for axis in plant.axes:
        copper = 0.5 * 1.5 * axis.r_s * 3.0**2
        friction = (axis.friction + axis.viscous * speed) * 0.5 * speed
        times.append(0.5 * axis.inertia * speed**2 / (copper + friction))
    return 0.1 + 1.5 * max(times)


def _short(plant: PlantConfig, seed: int, axis: int) -> Iterator[Row | Panel]:
    motor, judge = plant.axes[axis], Judge(f"{axis_name(axis)}: ")
    refused = refusal_speed(PlantConfig.load().axes[axis])  # the firmware judges by its nominal values
    below, above = (1.0 - NEAR) * refused, (1.0 + NEAR) * refused
    omega, current = short(plant, seed, axis, below, COAST_TIME)
    _, beyond = short(plant, seed, axis, above, 0.01)
    speeds = np.abs(omega)
    formula, slide = (np.array([short_current(motor, w, drops=drops) for w in speeds]) for drops in (True, False))
    begun = SETTLED * motor.l_q / motor.r_s  # the current that was there has gone
    moving = (speeds > 0.1 * below) & (TICK * np.arange(speeds.size) > begun)
    off = float(np.abs(current - formula)[moving].max() / formula.max())
    # Deviation that is allowed: the drops are square waves; 5th and 7th harmonic add up.
    harmonics = 4.0 / math.pi * motor.v_drop * (1.0 / 5.0 + 1.0 / 7.0)
    maximum = AGREE + harmonics / (motor.r_s + motor.r_on) / float(formula.max())
    over, law = (current[moving] / slide[moving]).max(), "K_e w / sqrt(R^2 + w^2 L^2)"
    yield judge.true(f"short at {below / RPM:.0f} rpm", current.max() > 0.0, reference="allowed")
    yield judge.none(f"short at {above / RPM:.0f} rpm", beyond.max() > 0.0, reference="refused above some 1450 rpm")
    yield judge("current off the formula", off, "of largest", maximum=maximum, reference=law)
    yield judge("current over the slide's", over, "", 0.3, 1.02, reference="an upper bound: it has no drops")
    yield judge("speed after the short", speeds[-1] / RPM, "rpm", 0.0, 1.0, reference="rest")
    curves = (
        Curve("measured", speeds / RPM, current, "."),
        Curve("formula with drops", speeds / RPM, formula),
        Curve("formula of the slide", speeds / RPM, slide),
    )
    yield Panel(f"{axis_name(axis)}: windings shorted", "speed [rpm]", "current [A]", curves)
