"""Feed-forward of the friction current: reversals and starts, with right and wrong nominal values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.dead_time_torque import displacement, response
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import nominal_shafts
from servo_twin.validation.experiments.rig import COUNT, RPM, shaft_counts

NAME: Final = "friction"
HELP: Final = """\
Beyond the reference design: feed-forward of the current against Coulomb and viscous friction from the speed set-point
(feature FRICTION). The reference design has no such compensation and shows no measurement. Shown, without and with it:
speed control, a start from rest to 10 rpm and a sine of 50 rpm, 1 Hz; position control, a sine of 0.1 turns, 2 Hz,
with feed-forward of speed and acceleration in both runs. The true friction is equal to the nominal one, twice, or half
of it: the loop has to supply the difference."""

TIMES: Final = (1.0, 2.0, 0.5)
"""True friction relative to the nominal value."""

SPEED: Final = 50.0 * RPM
SPEED_FREQUENCY: Final = 1.0  # [Hz]
AMPLITUDE: Final = 0.1  # of the position sine [turns]
POSITION_FREQUENCY: Final = 2.0  # [Hz]
START: Final = 10.0 * RPM
START_TIME: Final = 0.1  # [s]
SETTLE: Final = 0.5  # [s]
MEASURED: Final = 2.0  # [s], whole periods

START_QUANTISATION: Final = 2.0
"""Distance of two edges of track B [counts]: the M/T method has no speed before the second edge."""

QUANTISATION: Final = 0.75
"""RMS error by the quantisation of the encoder [counts]."""


@dataclass(frozen=True)
class Shaft:
    """Axis and inertia ratio for the evaluation of a run."""

    plant: PlantConfig
    axis: int
    heavier: float  # inertia relative to the tuning, at least 1


def uncompensated(times: float) -> float:
    """Uncompensated fraction of the friction [1], if the friction is `times` the nominal value."""
    return abs(times - 1.0) / times


def position_lag(recording: Trace) -> NDArray[np.float64]:
    """Lag of the true shaft behind the integral of the speed set-point [counts]."""
    reference = np.cumsum(recording["speed_ref"]) * TICK
    return np.asarray((reference - (recording["theta"] - recording["theta"][0])) / COUNT)


# ---- runs of both axes, without and with the feature -----------------------------------------------------------------


def start(plant: PlantConfig, seed: int, on: bool) -> dict[int, Trace]:
    """Start from standstill to a low speed."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", FRICTION=on)
        rig.record(board, [0], 10 * TICK)
        for axis in range(AXES):
            write_axis(board, "cmd.speed", axis, START)
        return rig.record(board, range(AXES), START_TIME)


def reverse_speed(plant: PlantConfig, seed: int, on: bool) -> dict[int, Trace]:
    """Sinusoidal speed."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", FRICTION=on)

        def act(k: int) -> None:
            for axis in range(AXES):
                write_axis(board, "cmd.speed", axis, SPEED * math.sin(2.0 * math.pi * SPEED_FREQUENCY * k * TICK))

        return rig.record(board, range(AXES), SETTLE + MEASURED, act)


def reverse_position(plant: PlantConfig, seed: int, on: bool) -> dict[int, Trace]:
    """Sinusoidal position, with feed-forward of speed and acceleration in both runs."""
    with rig.spinning(plant, seed) as board:
        starts = [word(board, axis, "position") for axis in range(AXES)]
        for axis in range(AXES):
            rig.set_up(board, axis, FRICTION=on, SPEED_FORWARD=True, ACCELERATION_FORWARD=True)

        def act(k: int) -> None:
            position = 0.5 * (1.0 - math.cos(2.0 * math.pi * POSITION_FREQUENCY * k * TICK))
            for axis, start in enumerate(starts):
                write_word(board, "cmd.position", axis, round(start + 2.0 * AMPLITUDE * COUNTS_PER_TURN * position))

        return rig.record(board, range(AXES), SETTLE + MEASURED, act)


# ---- figures ---------------------------------------------------------------------------------------------------------


def _rms(signal: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def expected_at_start(shaft: Shaft, fraction: float) -> float:
    """RMS position lag at a start by a fraction `fraction` of the friction alone [counts].

    Cannot be measured in the run without feed-forward: at the start the encoder resolution adds an error of opposite
    sign.
    """
    torques = np.full(round(START_TIME / TICK), fraction * shaft.plant.axes[shaft.axis].friction)
    return _rms(response(torques, shaft.plant, shaft.axis, position=False, heavier=shaft.heavier))


def lost_at_start(recording: Trace, shaft: Shaft) -> float:
    """RMS position lag, without the part caused by the inverter [counts]."""
    return _rms(
        position_lag(recording)
        + displacement(recording, shaft.plant, shaft.axis, position=False, heavier=shaft.heavier)
    )


def lost_at_reversals(recording: Trace, shaft: Shaft) -> float:
    """RMS of the position lag about its mean, over whole periods, without the part of the inverter [counts]."""
    position = position_lag(recording) + displacement(
        recording, shaft.plant, shaft.axis, position=False, heavier=shaft.heavier
    )
    position = position[round(SETTLE / TICK) :]
    return _rms(position - position.mean())


def following_error(recording: Trace, shaft: Shaft) -> float:
    """RMS of the true following error, over whole periods, without the part caused by the inverter [counts]."""
    cost = displacement(recording, shaft.plant, shaft.axis, position=True, heavier=shaft.heavier)
    return _rms((recording["position_ref"] - shaft_counts(recording) + cost)[round(SETTLE / TICK) :])


@dataclass(frozen=True)
class Task:
    """A run, its figure and its curve."""

    name: str
    note: str  # name in the notes
    run: Callable[[PlantConfig, int, bool], dict[int, Trace]]  # runs both axes, without or with the feature
    figure: str
    measure: Callable[[Trace, Shaft], float]  # RMS figure [counts]
    label: str
    signal: Callable[[Trace], NDArray[np.float64]]  # curve of the picture [counts]
    shown: float  # start of the picture [s]


END: Final = SETTLE + MEASURED
TASKS: Final = (
    Task("start from rest", "start", start, "lost way", lost_at_start, "lag", position_lag, 0.0),
    Task(
        "reversals of speed", "reversals of speed", reverse_speed, "lost way", lost_at_reversals,
        "lag", position_lag, END - 1.0 / SPEED_FREQUENCY,
    ),
    Task(
        "reversals of position", "of position", reverse_position, "following error", following_error,
        "following error", lambda r: np.asarray(r["position_ref"] - shaft_counts(r)), END - 1.0 / POSITION_FREQUENCY,
    ),
)  # fmt: skip


def deviation_max(task: Task, without: Trace, shaft: Shaft, fraction: float) -> float:
    """Permitted remaining error [counts]: part of the uncompensated friction, and encoder quantisation.

    With a larger inertia the loop is slower, and the quantisation error increases by the same factor.
    """
    if task.run is start:
        return expected_at_start(shaft, fraction) + START_QUANTISATION
    return fraction * task.measure(without, shaft) + QUANTISATION * shaft.heavier


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Three frictions, three tasks, without and with the feature."""
    nominals = nominal_shafts(plant, seed)
    torques = ", ".join(f"{axis_name(axis)} {1e3 * nominal.friction:.3g} mN m" for axis, nominal in enumerate(nominals))
    yield f"the friction of the plant is set, Coulomb only, from the nominal values: {torques}"
    for times in TIMES:
        changed = plant
        for axis, nominal in enumerate(nominals):
            changed = changed.with_axis(axis, friction=times * nominal.friction, viscous=0.0)
        shafts = [
            Shaft(changed, axis, max(entry.inertia / nominal.inertia, 1.0))
            for axis, (entry, nominal) in enumerate(zip(changed.axes, nominals, strict=True))
        ]
        found = [(task, task.run(changed, seed, False), task.run(changed, seed, True)) for task in TASKS]
        for axis, shaft in enumerate(shafts):
            judge = Judge(f"{axis_name(axis)}, friction x {times:g}, ")
            for task, without, with_it in found:
                value, bound = (
                    task.measure(with_it[axis], shaft),
                    deviation_max(task, without[axis], shaft, uncompensated(times)),
                )
                yield judge(f"{task.name}, {task.figure}, rms", value, "counts", maximum=bound)
                if times == 1.0:
                    shown = {"without": without[axis], "with friction compensation": with_it[axis]}
                    yield _panel(f"{axis_name(axis)}: {task.name}", task, shown)
        yield _note(times, shafts, found)


def _note(times: float, shafts: list[Shaft], found: list[tuple[Task, dict[int, Trace], dict[int, Trace]]]) -> str:
    """Note with the figures and the part caused by the inverter."""
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
        f"{_rms(displacement(last[axis], s.plant, axis, position=True, heavier=s.heavier)[round(SETTLE / TICK) :]):.2g}"
        for axis, s in enumerate(shafts)
    )
    return (
        f"friction x {times:g}, both axes, without -> with, rms [counts]: "
        + ", ".join(parts)
        + f"; subtracted from the last: {costs}, caused by the inverter"
    )


def _panel(title: str, task: Task, shown: Mapping[str, Trace]) -> Panel:
    first = round(task.shown / TICK)
    curves = [Curve(how, r.time[first:], task.signal(r)[first:]) for how, r in shown.items()]
    return Panel(title, "time [s]", f"{task.label} [counts]", curves)
