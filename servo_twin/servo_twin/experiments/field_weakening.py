"""Field weakening: rated speed at 24 V, its voltage margin, load steps, a supply that sags, faults, other motors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.tuning.field_weakening import reserve_at
from servo_msgs_py.tuning.field_weakening import top_speed as speed_left

from servo_twin.board import Board
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import MODULATION
from servo_twin.experiments.rig import (
    RPM,
    TICK,
    Recording,
    choose_mode,
    command_speed,
    features,
    set_axis,
    spinning,
    watch,
)
from servo_twin.fault_injection import HotPowerStage
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "field-weakening"
HELP: Final = """\
The drive at its rated 4000 rpm, where the back-EMF is all the voltage of 24 V, with the feature FIELD_WEAKENING and
without: torque over speed, the voltage margin, load steps, a supply that sags and returns, a fault, motors that differ
by 10 % from what the drive believes, and both axes at once. The reference design ends at 3000 rpm without it."""

AXIS: Final = 0
RATED: Final = 4000.0 * RPM
CURRENT: Final = 4.0  # of the drive [A],
I_D_MOST: Final = 3.0  # the part of it that it lets field weakening have [A],
MARGIN: Final = 0.3  # and the voltage that this keeps free [V]

LOADS: Final = (0.02, 0.045, 0.08, 0.12)  # [N m]
STEP: Final = LOADS[1]  # that the rated speed bears
SAGS: Final = (22.0, 20.0, 17.5)  # [V]
SAG_LOAD: Final = 0.03  # [N m]
BOTH_SAG: Final = 20.0  # [V]
OVER_VOLTAGE: Final = 33.0  # of the drive [V]
NOISE: Final = 0.5  # of the bus [V]
FAULT_SEEN: Final = 0.1  # [s]
HOT: Final = 110.0  # of the power stage: a fault that lets the shaft coast [deg C]

RUN_UP: Final = 0.25  # [s]
SETTLE: Final = 0.3  # from a change to what is measured [s]
MEASURED: Final = 0.1  # [s]
DIP: Final = 0.05  # in which a load step shows at its largest [s]
REACHED: Final = 0.005  # of the rated speed
FORMULA: Final = 0.02
"""Part of the speed by which a shaft may be off from what voltage and current leave on paper: drops and dead time that
are not quite compensated, losses of the bus, and currents that are not quite those of the best torque."""
FREE: Final = 0.12  # by which the mean of the free voltage may be off MARGIN [V]
RESTLESS: Final = 30.0 * RPM
"""Standard deviation of a steady speed. It is largest at 3333 rpm, where the voltage is sampled 18 times per electrical
turn: the ripple of dead time and drops then looks like a slow change."""
I_D_RESTLESS: Final = 0.15  # and of its i_d: noise of currents and speed [A]
RETURN: Final = 0.25  # from the return of the supply until the speed is back [s]
BEYOND_RATED: Final = 0.04  # of the speed, after a load has gone
WORSE: Final = 1.25  # speed that a load step takes at the rated speed, over that at half of it
DEVIATION: Final = 0.1  # of the motors, up and down

Event = tuple[float, Callable[[Board], None]]


@dataclass(frozen=True)
class Steady:
    """Means of a part of a recording.

    Attributes
    ----------
    speed, wander : float
        True speed, and its standard deviation [rad/s].
    i_d, i_d_wander : float
        [A].
    free : float
        Stator voltage below its limit [V].
    """

    speed: float
    wander: float
    i_d: float
    i_d_wander: float
    free: float


def free_voltage(recording: Recording) -> NDArray[np.float64]:
    """What the stator voltage leaves of its limit [V]."""
    return np.asarray(MODULATION * recording.u_dc - np.hypot(recording.u_d, recording.u_q))


def steady(recording: Recording, start: float, end: float | None = None) -> Steady:
    """Means from `start` to `end` [s]."""
    part = recording.part(start, end)
    return Steady(
        speed=float(part.omega.mean()),
        wander=float(part.omega.std()),
        i_d=float(part.i_d.mean()),
        i_d_wander=float(part.i_d.std()),
        free=float(free_voltage(part).mean()),
    )


def formula(axis: AxisPlant, volts: float, load: float, *, weak: bool) -> float:
    """Speed that voltage and current leave on paper, RATED at most [rad/s]."""
    voltage = MODULATION * volts - (MARGIN if weak else 0.0)

    def torque(speed: float) -> float:
        return load + axis.friction + axis.viscous * speed

    return min(speed_left(axis, CURRENT, voltage, -I_D_MOST if weak else 0.0, torque), RATED)


@contextmanager
def at_rated(plant: PlantConfig, seed: int, axes: Sequence[int], *, weak: bool) -> Iterator[Board]:
    """A board whose axes are told to turn at the rated speed; they are on their way."""
    with spinning(plant, seed) as board:
        for axis in axes:
            features(board, axis, FIELD_WEAKENING=weak)
            set_axis(board, "param.speed_limit", axis, RATED)
            choose_mode(board, axis, "SPEED")
            command_speed(board, axis, RATED)
        yield board


def run_with(
    plant: PlantConfig,
    seed: int,
    events: Sequence[Event],
    seconds: float,
    axes: Sequence[int] = (AXIS,),
    *,
    weak: bool = True,
    may_fail: bool = False,
) -> Mapping[int, Recording]:
    """Run up to the rated speed, with events at their times from the set-point on [s]."""
    at = [(round(time / TICK), act) for time, act in events]

    def act(k: int) -> None:
        for tick, happen in at:
            if tick == k:
                happen(board)

    with at_rated(plant, seed, axes, weak=weak) as board:
        return watch(board, axes, seconds, act, may_fail=may_fail)


def _load(torque: float, axis: int = AXIS) -> Callable[[Board], None]:
    return lambda board: board.set_load(axis, torque)


def _supply(volts: float) -> Callable[[Board], None]:
    return lambda board: board.set_supply(volts)


# ---- torque over speed -----------------------------------------------------------------------------------------------


def loaded(plant: PlantConfig, seed: int, load: float, *, weak: bool) -> Steady:
    """The speed under a load that stays."""
    end = RUN_UP + SETTLE + MEASURED
    recording = run_with(plant, seed, [(RUN_UP, _load(load))], end, weak=weak)[AXIS]
    return steady(recording, end - MEASURED)


def _load_rows(plant: PlantConfig, seed: int) -> tuple[list[Row], Panel]:
    axis, volts = plant.axes[AXIS], plant.bus.u_source
    rows: list[Row] = []
    speeds: dict[bool, list[float]] = {False: [], True: []}
    for load in LOADS:
        for weak in (True, False):
            result = loaded(plant, seed, load, weak=weak)
            name = f"{1e3 * load:g} mN m {'with' if weak else 'without'}"
            aim = formula(axis, volts, load, weak=weak) / RPM
            bound = Bound((1.0 - FORMULA) * aim, (1.0 + FORMULA) * aim)
            rows.append(Row(f"{name}: speed", f"{BEYOND}; {aim:.0f} rpm on paper", result.speed / RPM, "rpm", bound))
            speeds[weak].append(result.speed)
            if weak:
                free = Bound(MARGIN - FREE, MARGIN + FREE)
                rows += [
                    Row(f"{name}: voltage kept free", BEYOND, result.free, "V", free),
                    Row(f"{name}: wandering speed", BEYOND, result.wander / RPM, "rpm", Bound(0.0, RESTLESS / RPM)),
                    Row(f"{name}: wandering i_d", BEYOND, result.i_d_wander, "A", Bound(0.0, I_D_RESTLESS)),
                ]
    gained = speeds[True][1] - speeds[False][1]
    rows.append(Row(f"{1e3 * STEP:g} mN m: speed gained", BEYOND, gained / RPM, "rpm", Bound(_gain(axis, volts) / RPM)))
    return rows, _torque_panel(axis, volts, speeds)


def _gain(axis: AxisPlant, volts: float) -> float:
    """Half of what field weakening gains on paper."""
    return 0.5 * (formula(axis, volts, STEP, weak=True) - formula(axis, volts, STEP, weak=False))


def _torque_panel(axis: AxisPlant, volts: float, speeds: Mapping[bool, Sequence[float]]) -> Panel:
    grid = np.linspace(0.5 * RATED, 1.1 * RATED, 121)
    curves: list[Curve] = []
    for weak, how in ((False, "without"), (True, "with")):
        voltage = MODULATION * volts - (MARGIN if weak else 0.0)
        torques = [reserve_at(axis, CURRENT, w, voltage, -I_D_MOST if weak else 0.0).torque for w in grid]
        rest = np.maximum(np.array(torques) - axis.friction - axis.viscous * grid, 0.0)
        curves.append(Curve(f"{how}, on paper", grid / RPM, 1e3 * rest))
        curves.append(Curve(f"{how}, measured", np.array(speeds[weak]) / RPM, 1e3 * np.array(LOADS), "o"))
    return Panel(f"torque at the shaft, {volts:g} V", "speed [rpm]", "torque [mN m]", tuple(curves))


# ---- run-up, load step -----------------------------------------------------------------------------------------------


def _step_rows(plant: PlantConfig, seed: int) -> tuple[list[Row], Panel]:
    """A load comes and goes, and the shaft returns to rest."""
    rest = RUN_UP + 2.0 * SETTLE
    events = [
        (RUN_UP, _load(STEP)),
        (RUN_UP + SETTLE, _load(0.0)),
        (rest, lambda board: command_speed(board, AXIS, 0.0)),
    ]
    whole = run_with(plant, seed, events, rest + SETTLE + MEASURED)[AXIS]
    idle, high = steady(whole, RUN_UP - MEASURED, RUN_UP), float(whole.part(0.0, rest).omega.max())
    dip = RATED - float(whole.part(RUN_UP, RUN_UP + DIP).omega.min())
    slow = _dip_at(plant, seed, 0.5 * RATED)
    last = whole.part(rest + SETTLE)
    near = Bound(RATED * (1.0 - REACHED) / RPM, RATED * (1.0 + REACHED) / RPM)
    rows = [
        Row("run-up without load: speed", BEYOND, idle.speed / RPM, "rpm", near),
        Row("run-up without load: voltage kept free", BEYOND, idle.free, "V", Bound(MARGIN - FREE, MARGIN + FREE)),
        Row("load step: speed lost over that at 2000 rpm", BEYOND, dip / slow, "", Bound(0.0, WORSE)),
        Row("highest speed, load gone", BEYOND, high / RPM, "rpm", Bound(0.0, (1.0 + BEYOND_RATED) * RATED / RPM)),
        Row("at rest again: i_d", BEYOND, float(np.abs(last.i_d).mean()), "A", Bound(0.0, 0.1)),
    ]
    return rows, _panel("run-up, load step, stop", whole)


def _dip_at(plant: PlantConfig, seed: int, speed: float) -> float:
    """Speed that a load step takes from a slower shaft [rad/s]."""
    with at_rated(plant, seed, [AXIS], weak=False) as board:
        command_speed(board, AXIS, speed)
        watch(board, [AXIS], RUN_UP)
        board.set_load(AXIS, STEP)
        return speed - float(watch(board, [AXIS], DIP)[AXIS].omega.min())


# ---- a supply that sags ----------------------------------------------------------------------------------------------


def sag(plant: PlantConfig, seed: int, volts: float, axes: Sequence[int] = (AXIS,)) -> Mapping[int, Recording]:
    """The supply falls under load, and returns after SETTLE + MEASURED."""
    events = [(RUN_UP - MEASURED, _load(SAG_LOAD, axis)) for axis in axes]
    events += [(RUN_UP, _supply(volts)), (RUN_UP + SETTLE + MEASURED, _supply(plant.bus.u_source))]
    return run_with(plant, seed, events, RUN_UP + 2.0 * (SETTLE + MEASURED), axes)


def _sag_rows(axis: AxisPlant, recording: Recording, volts: float, name: str) -> list[Row]:
    back = RUN_UP + SETTLE + MEASURED
    low = steady(recording, back - MEASURED, back)
    aim = formula(axis, volts, SAG_LOAD, weak=True) / RPM
    after = recording.part(back)
    again = after.time[np.abs(after.omega - RATED) > 2.0 * REACHED * RATED]
    time = float(again[-1]) - back if again.size else 0.0
    return [
        Row(
            f"{name}: speed",
            f"{BEYOND}; {aim:.0f} rpm on paper",
            low.speed / RPM,
            "rpm",
            Bound((1.0 - FORMULA) * aim, (1.0 + FORMULA) * aim),
        ),
        Row(f"{name}: voltage kept free", BEYOND, low.free, "V", Bound(MARGIN - FREE)),
        Row(f"{name}: wandering speed", BEYOND, low.wander / RPM, "rpm", Bound(0.0, RESTLESS / RPM)),
        Row(f"{name}: wandering i_d", BEYOND, low.i_d_wander, "A", Bound(0.0, I_D_RESTLESS)),
        Row(f"{name}: back after its return", BEYOND, time, "s", Bound(0.0, RETURN)),
        Row(
            f"{name}: highest speed then",
            BEYOND,
            float(after.omega.max()) / RPM,
            "rpm",
            Bound(0.0, (1.0 + 2.0 * REACHED) * RATED / RPM),
        ),
    ]


def _sags(plant: PlantConfig, seed: int) -> tuple[list[Row], list[Panel]]:
    rows: list[Row] = []
    panels: list[Panel] = []
    for volts in SAGS:
        recording = sag(plant, seed, volts)[AXIS]
        rows += _sag_rows(plant.axes[AXIS], recording, volts, f"sag to {volts:g} V")
        panels.append(_panel(f"supply sags to {volts:g} V", recording))
    both = sag(plant, seed, BOTH_SAG, range(AXES))
    for axis in range(AXES):
        rows += _sag_rows(
            plant.axes[axis], both[axis], BOTH_SAG, f"both axes, sag to {BOTH_SAG:g} V, {axis_name(axis)}"
        )
    return rows, panels[1:2]


# ---- a fault ---------------------------------------------------------------------------------------------------------


def _fault_rows(plant: PlantConfig, seed: int) -> list[Row]:
    """The outputs go off in field weakening under load, for a fault that coasts: at a whole bus and a sagging one."""
    rows: list[Row] = []
    for volts in (plant.bus.u_source, BOTH_SAG):
        hot = RUN_UP + MEASURED
        events = [
            (RUN_UP - MEASURED, _load(STEP)),
            (RUN_UP + 0.5 * MEASURED, _supply(volts)),
            (hot, lambda board: board.inject(HotPowerStage(AXIS, HOT))),
        ]
        recording = run_with(plant, seed, events, hot + FAULT_SEEN, may_fail=True)[AXIS]
        name, found = f"fault at {volts:g} V", np.nonzero(recording.faults)[0]
        after = recording.part(float(recording.time[found[0]])) if found.size else recording
        # The capacitor may still be above a supply that has just sagged.
        charged = float(recording.part(hot - TICK, hot).u_dc.max())
        emf = math.sqrt(3.0) * plant.axes[AXIS].pole_pairs * plant.axes[AXIS].psi_m * RATED
        most = min(max(charged, emf) + NOISE, OVER_VOLTAGE)
        current = float(np.hypot(after.i_d, after.i_q)[1:].max())
        rows += [
            Row(f"{name}: noticed", BEYOND, float(found.size > 0), "", Bound(1.0, 1.0)),
            Row(
                f"{name}: in RUN in that tick", BEYOND, float(after.state[0] == recording.state[0]), "", Bound(0.0, 0.0)
            ),
            Row(f"{name}: current from the next tick on", BEYOND, current, "A", Bound(0.0, 0.1)),
            Row(f"{name}: highest bus voltage", BEYOND, float(after.u_dc.max()), "V", Bound(0.0, most)),
        ]
    return rows


# ---- other motors ----------------------------------------------------------------------------------------------------


def _motor_rows(plant: PlantConfig, seed: int) -> list[Row]:
    """The plant's motor is not what the drive believes."""
    rows: list[Row] = []
    axis, volts = plant.axes[AXIS], plant.bus.u_source
    for what, names in (("psi_m", ("psi_m",)), ("L", ("l_d", "l_q"))):
        for sign in (-1.0, 1.0):
            factor = 1.0 + sign * DEVIATION
            other = plant.with_axis(AXIS, **{name: factor * getattr(axis, name) for name in names})
            result = loaded(other, seed, LOADS[0], weak=True)
            aim = formula(other.axes[AXIS], volts, LOADS[0], weak=True) / RPM
            name = f"{what} {100.0 * sign * DEVIATION:+.0f} %"
            bound = Bound((1.0 - FORMULA) * aim, (1.0 + FORMULA) * aim)
            rows += [
                Row(f"{name}: speed", f"{BEYOND}; {aim:.0f} rpm on paper", result.speed / RPM, "rpm", bound),
                Row(f"{name}: voltage kept free", BEYOND, result.free, "V", Bound(MARGIN - FREE)),
                Row(f"{name}: wandering speed", BEYOND, result.wander / RPM, "rpm", Bound(0.0, RESTLESS / RPM)),
            ]
    return rows


def _panel(title: str, recording: Recording) -> Panel:
    time = 1e3 * recording.time
    curves = (
        Curve("speed [1000 rpm]", time, recording.omega / RPM / 1e3),
        Curve("i_d [A]", time, recording.i_d),
        Curve("i_q [A]", time, recording.i_q),
        Curve("voltage left [V]", time, np.minimum(free_voltage(recording), 3.0)),
    )
    return Panel(title, "time [ms]", "", curves)


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Run the experiment."""
    load_rows, torque = _load_rows(plant, seed)
    step_rows, step = _step_rows(plant, seed)
    sag_rows, sags = _sags(plant, seed)
    rows = [*load_rows, *step_rows, *sag_rows, *_fault_rows(plant, seed), *_motor_rows(plant, seed)]
    note = f"axis {AXIS + 1}; i_d down to -{I_D_MOST:g} A of {CURRENT:g} A, {MARGIN:g} V kept free"
    return Outcome(NAME, tuple(rows), (torque, step, *sags), (note,))
