"""Braking: two shafts onto a bus that takes nothing back, the resistor and its budget, the winding short."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import OVER_VOLTAGE, top_speed
from servo_twin.experiments.rig import RPM, TICK, choose_mode, command_speed, set_axis, spinning
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "braking"
HELP: Final = """\
Both axes brake at once from 3500 rpm onto a supply that takes nothing back, with a brake resistor and without; the
resistor's energy budget; the current of shorted windings over the speed, and the speed above which the short is
refused. The ST training names both kinds of braking and gives the steady current of the short as
K_e w / sqrt(R_s^2 + w^2 L_s^2), to be compared with the current limit beforehand; it shows no measurement. What both
shafts store would lift the bus past 33 V."""

BRAKE_FROM: Final = 3500.0 * RPM  # at most
RESISTOR: Final = 4.7  # that the firmware believes in, and where the plant has none [ohm]
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
    """Both axes from a speed to rest, one entry per slow tick.

    Attributes
    ----------
    u_dc : ndarray
        Bus [V].
    omega : ndarray, shape (ticks, axes)
        True speeds [rad/s].
    burnt : ndarray
        In the resistor so far [J].
    flags : frozenset of str
        Limits and faults that came up.
    """

    u_dc: NDArray[np.float64]
    omega: NDArray[np.float64]
    burnt: NDArray[np.float64]
    flags: frozenset[str]

    @property
    def seconds(self) -> float | None:
        """Until both stand [s]."""
        moving = np.nonzero(np.abs(self.omega).max(axis=1) > STANDS)[0]
        last = int(moving[-1]) + 1 if moving.size else 0
        return None if last == self.u_dc.size else last * TICK


def _flags(board: Board) -> set[str]:
    found: set[str] = set()
    for axis in range(AXES):
        for word in ("limits", "faults"):
            raw = board.read_raw(f"{axis_name(axis)}.{word}")[0]
            found |= {flag.name for flag in board.catalogue.active(word, raw)}
    return found


def _run_up(board: Board, speed: float) -> None:
    """Both axes to a speed, and from there as hard as the drive can."""
    most = Catalogue.load()["param.acceleration_limit"].maximum
    limit = Catalogue.load()["param.speed_limit"].maximum
    assert most is not None
    assert limit is not None
    for axis in range(AXES):
        set_axis(board, "param.speed_limit", axis, min(1.01 * speed, limit))
        choose_mode(board, axis, "SPEED")
        command_speed(board, axis, speed)
    board.run(RUN_UP)
    for axis in range(AXES):
        set_axis(board, "param.acceleration_limit", axis, most)
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
            flags |= _flags(board)
            one, other = board.truth(0), board.truth(1)
            rows.append((one.u_dc, one.omega_m, other.omega_m, one.e_brake))
            if max(abs(one.omega_m), abs(other.omega_m)) < 0.1 and len(rows) * TICK > 0.2:
                break
    course = np.array(rows)
    return Stop(course[:, 0], course[:, 1:3], course[:, 3], frozenset(flags))


def kinetic(plant: PlantConfig, speed: float) -> float:
    """Energy of both shafts [J]."""
    return sum(0.5 * axis.inertia * speed**2 for axis in plant.axes)


def lossless(plant: PlantConfig, speed: float) -> float:
    """Where the bus would end if all of it came back [V]."""
    return math.sqrt(plant.bus.u_source**2 + 2.0 * kinetic(plant, speed) / plant.bus.capacitance)


@dataclass(frozen=True)
class Budget:
    """What a supply above the switching voltage does to the resistor.

    Attributes
    ----------
    burnt : float
        Until it was switched off [J].
    seconds : float
        Until then [s].
    rest : float
        Until it was used again [s].
    """

    burnt: float
    seconds: float
    rest: float | None


def spend(plant: PlantConfig, seed: int, resistor: float) -> Budget:
    """A supply above the switching voltage, until the budget is spent and the resistor is used again."""
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


@dataclass(frozen=True)
class Short:
    """One axis while its windings are shorted, one entry per slow tick."""

    omega: NDArray[np.float64]
    current: NDArray[np.float64]
    state: int

    @property
    def accepted(self) -> bool:
        return bool(self.current.max() > 0.0)


def short(plant: PlantConfig, seed: int, axis: int, speed: float, seconds: float) -> Short:
    """Drive an axis to a speed and withdraw its drive with the windings shorted."""
    with spinning(plant.with_axis(axis, inertia=HEAVY * plant.axes[axis].inertia), seed) as board:
        board.write("param.on_disable", [SHORT] * AXES)
        choose_mode(board, axis, "SPEED")
        command_speed(board, axis, speed)
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
        return Short(omega, current, board.read_raw(f"{axis_name(axis)}.state")[0])


def run(plant: PlantConfig, seed: int) -> Outcome:
    """The bus with both axes, the budget, and each axis' winding short."""
    speed = top_speed(plant.with_bus(capacitance=1.0), range(AXES), BRAKE_FROM)  # whatever the bus can take
    resistor = plant.bus.r_brake or RESISTOR
    without, with_one = stop(plant, seed, speed, 0.0), stop(plant, seed, speed, resistor)
    budget = spend(plant, seed, resistor)
    rows = [
        *_rows_bus(plant, speed, "no resistor", without, OVER_VOLTAGE),
        *_rows_bus(plant, speed, "resistor", with_one, _with_resistor(plant, speed, resistor)),
        Row("resistor: burnt in it", "not shown", float(with_one.burnt[-1]), "J", Bound(0.0, kinetic(plant, speed))),
        *_rows_budget(budget, RESISTOR / resistor),
    ]
    panels = [_panel_bus(without, with_one)]
    for axis in range(AXES):
        more, panel = _short(plant, seed, axis)
        rows.extend(more)
        panels.append(panel)
    flags = ", ".join(sorted(without.flags)) or "none"
    carried = [short_current(plant.axes[0], SLIDE_SPEED, drops=drops) for drops in (False, True)]
    notes = (
        f"from {speed / RPM:.4g} rpm: {kinetic(plant, speed):.3g} J, {lossless(plant, speed):.3g} V without losses",
        f"resistor {resistor:g} ohm; without it the limits were {flags}",
        f"axis 1 short at {SLIDE_SPEED / RPM:g} rpm: {carried[0]:.3g} A by the formula, {carried[1]:.3g} A with drops",
    )
    return Outcome(NAME, tuple(rows), tuple(panels), notes)


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


def _rows_bus(plant: PlantConfig, speed: float, name: str, it: Stop, most: float) -> list[Row]:
    faults = {flag.name for flag in Catalogue.load().flags["faults"]}
    highest = float(it.u_dc.max())
    return [
        Row(f"{name}: highest bus voltage", "below the limit, 33 V", highest, "V", Bound(plant.bus.u_source, most)),
        Row(f"{name}: faults", "none", float(len(it.flags & faults)), "", Bound(0.0, 0.0)),
        Row(f"{name}: both stand after", "not shown", it.seconds, "s", Bound(0.0, _longest(plant, speed))),
    ]


def _longest(plant: PlantConfig, speed: float) -> float:
    """A stop in which nothing but friction and half of the copper's losses at full current brake [s]."""
    times = []
    for axis in plant.axes:
        copper = 0.5 * 1.5 * axis.r_s * 3.0**2
        friction = (axis.friction + axis.viscous * speed) * 0.5 * speed
        times.append(0.5 * axis.inertia * speed**2 / (copper + friction))
    return 0.1 + 1.5 * max(times)


def _rows_budget(it: Budget, scale: float) -> list[Row]:
    """The firmware computes with the resistor that it believes in."""
    allowed = (BUDGET + POWER * it.seconds) * scale
    rest = (1.0 - RESTED) * BUDGET / POWER
    return [
        Row("budget: burnt until off", "not shown", it.burnt, "J", Bound(0.95 * allowed, 1.05 * allowed)),
        Row("budget: rest until used again", "not shown", it.rest, "s", Bound(0.95 * rest, 1.05 * rest)),
    ]


def _off(axis: AxisPlant, formula: NDArray[np.float64]) -> float:
    """Allowed deviation, of the largest current: the drops are square waves; 5th and 7th harmonic add up."""
    harmonics = 4.0 / math.pi * axis.v_drop * (1.0 / 5.0 + 1.0 / 7.0)
    return AGREE + harmonics / (axis.r_s + axis.r_on) / float(formula.max())


def _short(plant: PlantConfig, seed: int, axis: int) -> tuple[list[Row], Panel]:
    name, motor = axis_name(axis), plant.axes[axis]
    refused = refusal_speed(PlantConfig.load().axes[axis])  # the firmware judges by what it believes
    below, above = (1.0 - NEAR) * refused, (1.0 + NEAR) * refused
    it = short(plant, seed, axis, below, COAST_TIME)
    no = short(plant, seed, axis, above, 0.01)
    speeds = np.abs(it.omega)
    formula = np.array([short_current(motor, w, drops=True) for w in speeds])
    slide = np.array([short_current(motor, w, drops=False) for w in speeds])
    begun = SETTLED * motor.l_q / motor.r_s  # the current that was there has gone
    moving = (speeds > 0.1 * below) & (TICK * np.arange(speeds.size) > begun)
    off = float(np.abs(it.current - formula)[moving].max() / formula.max())
    rows = [
        Row(f"{name}: short at {below / RPM:.0f} rpm", "allowed", float(it.accepted), "", Bound(1.0, 1.0)),
        Row(
            f"{name}: short at {above / RPM:.0f} rpm",
            "refused above some 1450 rpm",
            float(no.accepted),
            "",
            Bound(0, 0),
        ),
        Row(
            f"{name}: current off the formula",
            "K_e w / sqrt(R^2 + w^2 L^2)",
            off,
            "of largest",
            Bound(most=_off(motor, formula)),
        ),
        Row(
            f"{name}: current over the slide's",
            "an upper bound: it has no drops",
            float((it.current[moving] / slide[moving]).max()),
            "",
            Bound(0.3, 1.02),
        ),
        Row(f"{name}: speed after the short", "rest", float(speeds[-1] / RPM), "rpm", Bound(0.0, 1.0)),
    ]
    curves = (
        Curve("measured", speeds / RPM, it.current, "."),
        Curve("formula with drops", speeds / RPM, formula),
        Curve("formula of the slide", speeds / RPM, slide),
    )
    return rows, Panel(f"{name}: windings shorted", "speed [rpm]", "current [A]", curves)


def _panel_bus(without: Stop, with_one: Stop) -> Panel:
    curves = []
    for name, it in (("no resistor", without), ("resistor", with_one)):
        time = TICK * np.arange(1, it.u_dc.size + 1, dtype=np.float64)
        curves += [Curve(f"bus, {name} [V]", time, it.u_dc)]
        curves += [
            Curve(f"{axis_name(k)}, {name} [100 rpm]", time, it.omega[:, k] / RPM / 100.0, "--") for k in range(AXES)
        ]
    return Panel("both axes brake at once", "time [s]", "bus [V], speed [100 rpm]", tuple(curves))
