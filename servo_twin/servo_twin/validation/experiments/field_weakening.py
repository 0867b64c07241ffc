"""Field weakening: rated speed at 24 V, voltage margin, load steps, supply sags, faults, other motors."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_tuning.field_weakening import largest_torque
from servo_tuning.field_weakening import top_speed as speed_left

from servo_twin.board import Board
from servo_twin.fault_injection import HotPowerStage
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.validation.experiments.outcome import BEYOND, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.plant_limits import modulation, over_voltage
from servo_twin.validation.experiments.rig import RPM, at, record, set_up, spinning

NAME: Final = "field-weakening"
HELP: Final = """\
The drive at its rated 4000 rpm, where the back-EMF reaches the voltage limit at 24 V, with and without the feature
FIELD_WEAKENING: torque over speed, voltage margin, load steps, a supply that sags and returns, a fault, motors that
differ by 10 % from their nominal data, and both axes together. The reference design ends at 3000 rpm, without field
weakening."""

AXIS: Final = 0
RATED: Final = 4000.0 * RPM
CURRENT: Final = 4.0  # current limit of the drive [A]
I_D_MAX: Final = 3.0  # limit of the field-weakening current [A]
MARGIN: Final = 0.3  # voltage margin of the field weakening [V]

LOADS: Final = (0.02, 0.045, 0.08, 0.12)  # [N m]
STEP: Final = LOADS[1]  # load step that is feasible at rated speed
SAGS: Final = (22.0, 20.0, 17.5)  # [V]
SAG_LOAD: Final = 0.03  # [N m]
BOTH_SAG: Final = 20.0  # [V]
NOISE: Final = 0.5  # noise of the bus voltage [V]
FAULT_SEEN: Final = 0.1  # [s]
HOT: Final = 110.0  # temperature of the power stage: a fault with coasting [deg C]

RUN_UP: Final = 0.25  # [s]
SETTLE: Final = 0.3  # settling time before a measurement [s]
MEASURED: Final = 0.1  # [s]
DROP_WINDOW: Final = 0.05  # time window of the largest speed drop after a load step [s]
REACHED: Final = 0.005  # permitted error, relative to the rated speed
SPEED_TOLERANCE: Final = 0.02
"""Permitted relative deviation from the theoretical speed: imperfect compensation of drops and dead time, losses of the
bus, and deviations from the currents of maximum torque."""
MARGIN_TOLERANCE: Final = 0.12  # permitted deviation of the mean voltage margin [V]
SPEED_DEVIATION_MAX: Final = 30.0 * RPM
"""Largest standard deviation of a constant speed. It is largest at 3333 rpm with 18 voltage samples per electrical
revolution: the ripple of dead time and drops is aliased to a low frequency."""
I_D_DEVIATION_MAX: Final = 0.15  # largest standard deviation of i_d: noise of currents and speed [A]
RECOVERY_TIME_MAX: Final = 0.25  # permitted time from the return of the supply to rated speed [s]
OVERSHOOT_MAX: Final = 0.04  # permitted relative overshoot of the speed after a load is removed
DROP_RATIO_MAX: Final = 1.25  # permitted speed drop by a load step at rated speed, relative to that at half of it
DEVIATION: Final = 0.1  # relative deviations of the motors, of both signs

Events = Mapping[float, Callable[[Board], object]]
"""Actions by time since the set-point [s]."""


def free_voltage(recording: Trace) -> NDArray[np.float64]:
    """Voltage limit minus stator voltage [V]."""
    return np.asarray(modulation() * recording["u_dc"] - np.hypot(recording["u_d"], recording["u_q"]))


def theoretical_speed(axis: AxisPlant, volts: float, load: float, *, weak: bool) -> float:
    """Theoretical speed for this voltage and current, at most RATED [rad/s]."""
    voltage = modulation() * volts - (MARGIN if weak else 0.0)

    def torque(speed: float) -> float:
        return load + axis.friction + axis.viscous * speed

    return min(speed_left(axis, CURRENT, voltage, -I_D_MAX if weak else 0.0, torque), RATED)


@contextmanager
def at_rated(plant: PlantConfig, seed: int, axes: Sequence[int], *, weak: bool) -> Iterator[Board]:
    """Board with axes that are commanded to rated speed and accelerate."""
    with spinning(plant, seed) as board:
        for axis in axes:
            set_up(board, axis, "SPEED", RATED, parameters={"speed_limit": RATED}, FIELD_WEAKENING=weak)
        yield board


def run_with(
    plant: PlantConfig,
    seed: int,
    events: Events,
    seconds: float,
    axes: Sequence[int] = (AXIS,),
    *,
    weak: bool = True,
    may_fail: bool = False,
) -> Mapping[int, Trace]:
    """Run to rated speed, with events."""
    with at_rated(plant, seed, axes, weak=weak) as board:
        act = at({time: functools.partial(do, board) for time, do in events.items()})
        return record(board, axes, seconds, act, may_fail=may_fail)


def _load(torque: float, axes: Sequence[int] = (AXIS,)) -> Callable[[Board], object]:
    def do(board: Board) -> None:
        for axis in axes:
            board.set_load(axis, torque)

    return do


def _supply(volts: float) -> Callable[[Board], object]:
    return lambda board: board.set_supply(volts)


def _speed(judge: Judge, recording: Trace, target: float) -> Row:
    """Mean speed, compared with the theoretical one [rad/s]."""
    reference, target = f"{BEYOND}; {target / RPM:.0f} rpm in theory", target / RPM
    speed = float(recording["omega"].mean()) / RPM
    return judge(
        "speed", speed, "rpm", (1.0 - SPEED_TOLERANCE) * target, (1.0 + SPEED_TOLERANCE) * target, reference=reference
    )


def _free(judge: Judge, recording: Trace, maximum: float | None = None) -> Row:
    return judge("voltage reserve", free_voltage(recording).mean(), "V", MARGIN - MARGIN_TOLERANCE, maximum)


def _deviation_rows(judge: Judge, recording: Trace) -> Iterator[Row]:
    yield judge(
        "standard deviation of the speed", recording["omega"].std() / RPM, "rpm", 0.0, SPEED_DEVIATION_MAX / RPM
    )
    yield judge("standard deviation of i_d", recording["i_d"].std(), "A", 0.0, I_D_DEVIATION_MAX)


# ---- torque over speed -----------------------------------------------------------------------------------------------


def loaded(plant: PlantConfig, seed: int, load: float, *, weak: bool) -> Trace:
    """The end of a run under a constant load [N m]."""
    end = RUN_UP + SETTLE + MEASURED
    return run_with(plant, seed, {RUN_UP: _load(load)}, end, weak=weak)[AXIS].part(end - MEASURED)


def _load_items(plant: PlantConfig, seed: int) -> Iterator[Item]:
    axis, volts = plant.axes[AXIS], plant.bus.u_source
    speeds: dict[bool, list[float]] = {False: [], True: []}
    for load, weak in itertools.product(LOADS, (True, False)):
        recording = loaded(plant, seed, load, weak=weak)
        judge = Judge(f"{1e3 * load:g} mN m {'with' if weak else 'without'} field weakening: ")
        yield _speed(judge, recording, theoretical_speed(axis, volts, load, weak=weak))
        speeds[weak].append(float(recording["omega"].mean()))
        if weak:
            yield _free(judge, recording, MARGIN + MARGIN_TOLERANCE)
            yield from _deviation_rows(judge, recording)
    theory = theoretical_speed(axis, volts, STEP, weak=True) - theoretical_speed(axis, volts, STEP, weak=False)
    gained = (speeds[True][1] - speeds[False][1]) / RPM
    yield Judge(f"{1e3 * STEP:g} mN m: ")("speed gained", gained, "rpm", 0.5 * theory / RPM)
    grid = np.linspace(0.5 * RATED, 1.1 * RATED, 121)
    curves: list[Curve] = []
    for weak, how in ((False, "without"), (True, "with")):
        voltage = modulation() * volts - (MARGIN if weak else 0.0)
        torques = [largest_torque(axis, CURRENT, w, voltage, -I_D_MAX if weak else 0.0).torque for w in grid]
        rest = np.maximum(np.array(torques) - axis.friction - axis.viscous * grid, 0.0)
        curves.append(Curve(f"{how}, theory", grid / RPM, 1e3 * rest))
        curves.append(Curve(f"{how}, measured", np.array(speeds[weak]) / RPM, 1e3 * np.array(LOADS), "o"))
    yield Panel(f"torque at the shaft, {volts:g} V", "speed [rpm]", "torque [mN m]", curves)


# ---- run-up, load step -----------------------------------------------------------------------------------------------


def _step_items(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Load step, removal of the load, and stop."""
    rest = RUN_UP + 2.0 * SETTLE
    events: Events = {
        RUN_UP: _load(STEP),
        RUN_UP + SETTLE: _load(0.0),
        rest: lambda board: write_axis(board, "cmd.speed", AXIS, 0.0),
    }
    whole = run_with(plant, seed, events, rest + SETTLE + MEASURED)[AXIS]
    idle, high = whole.part(RUN_UP - MEASURED, RUN_UP), float(whole.part(0.0, rest)["omega"].max())
    dip = RATED - float(whole.part(RUN_UP, RUN_UP + DROP_WINDOW)["omega"].min())
    near = RATED * (1.0 - REACHED) / RPM, RATED * (1.0 + REACHED) / RPM
    judge = Judge("run-up without load: ")
    yield judge("speed", float(idle["omega"].mean()) / RPM, "rpm", *near)
    yield _free(judge, idle, MARGIN + MARGIN_TOLERANCE)
    judge, at_rest = Judge(), whole.part(rest + SETTLE)
    yield judge(
        "load step: speed dip relative to that at 2000 rpm",
        dip / _dip_at(plant, seed, 0.5 * RATED),
        "",
        0.0,
        DROP_RATIO_MAX,
    )
    yield judge("highest speed after load removal", high / RPM, "rpm", 0.0, (1.0 + OVERSHOOT_MAX) * RATED / RPM)
    yield judge("i_d at standstill", np.abs(at_rest["i_d"]).mean(), "A", 0.0, 0.1)
    yield _panel("run-up, load step, stop", whole)


def _dip_at(plant: PlantConfig, seed: int, speed: float) -> float:
    """Speed drop by a load step at a lower speed [rad/s]."""
    with at_rated(plant, seed, [AXIS], weak=False) as board:
        write_axis(board, "cmd.speed", AXIS, speed)
        record(board, [AXIS], RUN_UP)
        board.set_load(AXIS, STEP)
        return speed - float(record(board, [AXIS], DROP_WINDOW)[AXIS]["omega"].min())


# ---- a supply that sags ----------------------------------------------------------------------------------------------


def sag(plant: PlantConfig, seed: int, volts: float, axes: Sequence[int] = (AXIS,)) -> Mapping[int, Trace]:
    """The supply drops to a voltage [V] under load, and returns after SETTLE + MEASURED."""
    events = {
        RUN_UP - MEASURED: _load(SAG_LOAD, axes),
        RUN_UP: _supply(volts),
        RUN_UP + SETTLE + MEASURED: _supply(plant.bus.u_source),
    }
    return run_with(plant, seed, events, RUN_UP + 2.0 * (SETTLE + MEASURED), axes)


def _sag_rows(judge: Judge, axis: AxisPlant, recording: Trace, volts: float) -> Iterator[Row]:
    back = RUN_UP + SETTLE + MEASURED
    low, after = recording.part(back - MEASURED, back), recording.part(back)
    again = after.time[np.abs(after["omega"] - RATED) > 2.0 * REACHED * RATED]
    time = float(again[-1]) - back if again.size else 0.0
    yield _speed(judge, low, theoretical_speed(axis, volts, SAG_LOAD, weak=True))
    yield _free(judge, low)
    yield from _deviation_rows(judge, low)
    yield judge("recovery time after the supply returns", time, "s", 0.0, RECOVERY_TIME_MAX)
    maximum = (1.0 + 2.0 * REACHED) * RATED / RPM
    yield judge("highest speed after the supply returns", float(after["omega"].max()) / RPM, "rpm", 0.0, maximum)


# ---- a fault ---------------------------------------------------------------------------------------------------------


def _fault_rows(plant: PlantConfig, seed: int) -> Iterator[Row]:
    """A fault with coasting in field weakening under load, at normal and reduced supply."""
    hot = RUN_UP + MEASURED
    for volts in (plant.bus.u_source, BOTH_SAG):
        events: Events = {
            RUN_UP - MEASURED: _load(STEP),
            RUN_UP + 0.5 * MEASURED: _supply(volts),
            hot: lambda board: board.inject(HotPowerStage(AXIS, HOT)),
        }
        recording = run_with(plant, seed, events, hot + FAULT_SEEN, may_fail=True)[AXIS]
        judge, found = Judge(f"fault at {volts:g} V: "), np.nonzero(recording["faults"])[0]
        after = recording.part(float(recording.time[found[0]])) if found.size else recording
        # The capacitor may still be above the reduced supply.
        charged = float(recording.part(hot - TICK, hot)["u_dc"].max())
        emf = math.sqrt(3.0) * plant.axes[AXIS].pole_pairs * plant.axes[AXIS].psi_m * RATED
        yield judge.true("detected", found.size > 0)
        yield judge.none("still in RUN in the tick of the fault", after["state"][0] == recording["state"][0])
        yield judge("current after the next tick", np.hypot(after["i_d"], after["i_q"])[1:].max(), "A", 0.0, 0.1)
        maximum = min(max(charged, emf) + NOISE, over_voltage())
        yield judge("highest bus voltage", after["u_dc"].max(), "V", 0.0, maximum)


# ---- other motors ----------------------------------------------------------------------------------------------------


def _motor_rows(plant: PlantConfig, seed: int) -> Iterator[Row]:
    """Motors that deviate from their nominal values."""
    axis, volts = plant.axes[AXIS], plant.bus.u_source
    for (what, names), sign in itertools.product((("psi_m", ("psi_m",)), ("L", ("l_d", "l_q"))), (-1.0, 1.0)):
        factor = 1.0 + sign * DEVIATION
        other = plant.with_axis(AXIS, **{name: factor * getattr(axis, name) for name in names})
        recording = loaded(other, seed, LOADS[0], weak=True)
        judge = Judge(f"{what} {100.0 * sign * DEVIATION:+.0f} %: ")
        yield _speed(judge, recording, theoretical_speed(other.axes[AXIS], volts, LOADS[0], weak=True))
        yield _free(judge, recording)
        yield next(_deviation_rows(judge, recording))


def _panel(title: str, recording: Trace) -> Panel:
    time = 1e3 * recording.time
    curves = (
        Curve("speed [1000 rpm]", time, recording["omega"] / RPM / 1e3),
        Curve("i_d [A]", time, recording["i_d"]),
        Curve("i_q [A]", time, recording["i_q"]),
        Curve("voltage reserve [V]", time, np.minimum(free_voltage(recording), 3.0)),
    )
    return Panel(title, "time [ms]", "", curves)


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Run the experiment."""
    yield from _load_items(plant, seed)
    yield from _step_items(plant, seed)
    for volts in SAGS:
        recording = sag(plant, seed, volts)[AXIS]
        yield from _sag_rows(Judge(f"sag to {volts:g} V: "), plant.axes[AXIS], recording, volts)
        if volts == SAGS[1]:
            yield _panel(f"supply sags to {volts:g} V", recording)
    for axis, recording in sag(plant, seed, BOTH_SAG, range(AXES)).items():
        judge = Judge(f"both axes, sag to {BOTH_SAG:g} V, {axis_name(axis)}: ")
        yield from _sag_rows(judge, plant.axes[axis], recording, BOTH_SAG)
    yield from _fault_rows(plant, seed)
    yield from _motor_rows(plant, seed)
    yield f"axis {AXIS + 1}; i_d down to -{I_D_MAX:g} A of {CURRENT:g} A, voltage margin {MARGIN:g} V"
