"""Current against friction, fed forward: reversals and starts, with right and wrong nominal values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.experiments import rig
from servo_twin.experiments.dead_time_torque import answer, pushed
from servo_twin.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.experiments.plant_limits import nominal_shafts
from servo_twin.experiments.rig import COUNT, RPM, TICK, Recording
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "friction"
HELP: Final = """\
Beyond the reference design: feed-forward of the current against Coulomb and viscous friction from the speed set-point
(feature FRICTION). The reference design has no such compensation and shows no measurement. Shown, without and with it:
speed control, a start from rest to 10 rpm and a sine of 50 rpm, 1 Hz; position control, a sine of 0.1 turns, 2 Hz,
with feed-forward of speed and acceleration in both runs. The true friction is equal to the nominal one, twice, or half
of it: the loop has to supply the difference."""

TIMES: Final = (1.0, 2.0, 0.5)
"""True friction over the nominal one."""

SPEED: Final = 50.0 * RPM
SPEED_FREQUENCY: Final = 1.0  # [Hz]
WAY: Final = 0.1  # amplitude of the position's sine [turns]
WAY_FREQUENCY: Final = 2.0  # [Hz]
START: Final = 10.0 * RPM
START_WATCHED: Final = 0.1  # [s]
SETTLE: Final = 0.5  # [s]
MEASURED: Final = 2.0  # [s], whole periods

START_HIDDEN: Final = 2.0
"""Between two edges of track B [counts]: before the second one M/T has no speed."""

HIDDEN: Final = 0.75
"""What the encoder's counts leave, root mean square [counts]."""


@dataclass(frozen=True)
class Shaft:
    """What judges a run: the motor, and its inertia over the one that the loops are tuned for, if that is less."""

    axis: AxisPlant
    heavier: float  # inertia over the one that the loops are tuned for; 1 for less


def left(times: float) -> float:
    """Part of the friction [1] that compensation leaves or adds when it is `times` the nominal one."""
    return abs(times - 1.0) / times


def behind(recording: Recording) -> NDArray[np.float64]:
    """How far the true shaft is behind the way that the speed set-point asks for [counts]."""
    asked = np.cumsum(recording.speed_ref) * TICK
    return np.asarray((asked - (recording.theta - recording.theta[0])) / COUNT)


# ---- what the axes do, both at once, without the feature and with it -------------------------------------------------


def start(plant: PlantConfig, seed: int, on: bool) -> dict[int, Recording]:
    """From rest to a low speed."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", FRICTION=on)
        rig.watch(board, [0], 10 * TICK)
        for axis in range(AXES):
            rig.command_speed(board, axis, START)
        return rig.watch(board, range(AXES), START_WATCHED)


def reverse_speed(plant: PlantConfig, seed: int, on: bool) -> dict[int, Recording]:
    """Sine of the speed."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", FRICTION=on)

        def act(k: int) -> None:
            for axis in range(AXES):
                rig.command_speed(board, axis, SPEED * math.sin(2.0 * math.pi * SPEED_FREQUENCY * k * TICK))

        return rig.watch(board, range(AXES), SETTLE + MEASURED, act)


def reverse_position(plant: PlantConfig, seed: int, on: bool) -> dict[int, Recording]:
    """Sine of the position, speed and acceleration fed forward in both runs."""
    with rig.spinning(plant, seed) as board:
        starts = [rig.position_of(board, axis) for axis in range(AXES)]
        for axis in range(AXES):
            rig.set_up(board, axis, FRICTION=on, SPEED_FORWARD=True, ACCELERATION_FORWARD=True)

        def act(k: int) -> None:
            way = 0.5 * (1.0 - math.cos(2.0 * math.pi * WAY_FREQUENCY * k * TICK))
            for axis, start in enumerate(starts):
                rig.command_position(board, axis, round(start + 2.0 * WAY * COUNTS_PER_TURN * way))

        return rig.watch(board, range(AXES), SETTLE + MEASURED, act)


# ---- what is measured ------------------------------------------------------------------------------------------------


def _rms(signal: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def expected_at_start(shaft: Shaft, rest: float) -> float:
    """Root mean square of the way that a part of the friction takes by itself at a start [counts].

    Not to be had from a run without the feature: what the encoder hides at a start takes the shaft ahead, and what
    friction takes is to be seen only less that.
    """
    torques = np.full(round(START_WATCHED / TICK), rest * shaft.axis.friction)
    return _rms(answer(torques, shaft.axis, position=False, heavier=shaft.heavier))


def lost_at_start(recording: Recording, shaft: Shaft) -> float:
    """Root mean square of the lost way, but for what the inverter costs [counts]."""
    return _rms(behind(recording) + pushed(recording, shaft.axis, position=False, heavier=shaft.heavier))


def lost_at_reversals(recording: Recording, shaft: Shaft) -> float:
    """Root mean square of the lost way about its mean, over whole periods, but for what the inverter costs [counts]."""
    way = behind(recording) + pushed(recording, shaft.axis, position=False, heavier=shaft.heavier)
    way = way[round(SETTLE / TICK) :]
    return _rms(way - way.mean())


def following_error(recording: Recording, shaft: Shaft) -> float:
    """Root mean square of the true following error, over whole periods, but for what the inverter costs [counts]."""
    cost = pushed(recording, shaft.axis, position=True, heavier=shaft.heavier)
    return _rms((recording.position_ref - recording.shaft + cost)[round(SETTLE / TICK) :])


@dataclass(frozen=True)
class Task:
    """What the axes do, what is measured of it, and how it is drawn."""

    name: str
    note: str  # its name in the notes
    run: Callable[[PlantConfig, int, bool], dict[int, Recording]]  # both axes, without the feature or with it
    figure: str
    measure: Callable[[Recording, Shaft], float]  # root mean square [counts]
    label: str
    signal: Callable[[Recording], NDArray[np.float64]]  # curve of the picture [counts]
    shown: float  # begin of the picture [s]


END: Final = SETTLE + MEASURED
TASKS: Final = (
    Task("start from rest", "start", start, "lost way", lost_at_start, "behind", behind, 0.0),
    Task(
        "reversals of speed", "reversals of speed", reverse_speed, "lost way", lost_at_reversals,
        "behind", behind, END - 1.0 / SPEED_FREQUENCY,
    ),
    Task(
        "reversals of position", "of position", reverse_position, "following error", following_error,
        "following error", lambda r: np.asarray(r.position_ref - r.shaft), END - 1.0 / WAY_FREQUENCY,
    ),
)  # fmt: skip


def deviation_max(task: Task, without: Recording, shaft: Shaft, rest: float) -> float:
    """What may be left of an error [counts]: the part of the friction that is, and what the encoder hides.

    The loop is slower, and what it does not see grows, as much as the shaft is heavier than nominal.
    """
    if task.run is start:
        return expected_at_start(shaft, rest) + START_HIDDEN
    return rest * task.measure(without, shaft) + HIDDEN * shaft.heavier


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Three frictions, three tasks, without and with."""
    nominals = nominal_shafts(plant, seed)
    torques = ", ".join(f"{axis_name(axis)} {1e3 * nominal.friction:.3g} mN m" for axis, nominal in enumerate(nominals))
    yield f"the friction of the plant is set, Coulomb only, from the nominal values: {torques}"
    for times in TIMES:
        changed = plant
        for axis, nominal in enumerate(nominals):
            changed = changed.with_axis(axis, friction=times * nominal.friction, viscous=0.0)
        shafts = [
            Shaft(entry, max(entry.inertia / nominal.inertia, 1.0))
            for entry, nominal in zip(changed.axes, nominals, strict=True)
        ]
        found = [(task, task.run(changed, seed, False), task.run(changed, seed, True)) for task in TASKS]
        for axis, shaft in enumerate(shafts):
            judge = Judge(f"{axis_name(axis)}, friction x {times:g}, ")
            for task, without, with_it in found:
                value, bound = (
                    task.measure(with_it[axis], shaft),
                    deviation_max(task, without[axis], shaft, left(times)),
                )
                yield judge(f"{task.name}, {task.figure}, rms", value, "counts", maximum=bound)
                if times == 1.0:
                    shown = {"without": without[axis], "with friction compensation": with_it[axis]}
                    yield _panel(f"{axis_name(axis)}: {task.name}", task, shown)
        yield _note(times, shafts, found)


def _note(
    times: float, shafts: list[Shaft], found: list[tuple[Task, dict[int, Recording], dict[int, Recording]]]
) -> str:
    """The figures, and how much of it the current costs that the inverter kept back."""
    parts = [
        f"{task.note} "
        + " and ".join(
            f"{task.measure(without[axis], shaft):.3g} -> {task.measure(with_it[axis], shaft):.3g}"
            for axis, shaft in enumerate(shafts)
        )
        for task, without, with_it in found
    ]
    last = found[-1][2]
    costs = " and ".join(
        f"{_rms(pushed(last[axis], s.axis, position=True, heavier=s.heavier)[round(SETTLE / TICK) :]):.2g}"
        for axis, s in enumerate(shafts)
    )
    return (
        f"friction x {times:g}, both axes, without -> with, rms [counts]: "
        + ", ".join(parts)
        + f"; taken out of the last: {costs}, for current that did not flow"
    )


def _panel(title: str, task: Task, shown: Mapping[str, Recording]) -> Panel:
    first = round(task.shown / TICK)
    curves = [Curve(how, r.time[first:], task.signal(r)[first:]) for how, r in shown.items()]
    return Panel(title, "time [s]", f"{task.label} [counts]", curves)
