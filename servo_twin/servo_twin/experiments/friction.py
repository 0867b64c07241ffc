"""Current against friction, fed forward: reversals and starts, with the right belief and with wrong ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.experiments.dead_time_torque import answer, pushed
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import believed
from servo_twin.experiments.rig import (
    COUNT,
    RPM,
    TICK,
    Recording,
    choose_mode,
    command_position,
    command_speed,
    features,
    position_of,
    spinning,
    watch,
)
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "friction"
HELP: Final = """\
Beyond the reference design: current against Coulomb and viscous friction, fed forward from the set-point of the speed
(feature FRICTION). The seed has none and shows nothing of it.
Shown, without and with it: speed control, a start from rest to 10 rpm and a sine of 50 rpm, 1 Hz; position control, a
sine of 0.1 turns, 2 Hz, with speed and acceleration fed forward in both runs. The friction that is there is as large as
the controller believes, or twice, or half of that: then a half, or as much again, is left to the loop."""

TIMES: Final = (1.0, 2.0, 0.5)
"""Friction that is there over the one that the controller believes in."""

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

FORWARD: Final[Mapping[str, bool]] = {"SPEED_FORWARD": True, "ACCELERATION_FORWARD": True}


@dataclass(frozen=True)
class Pair:
    """The same run without and with the feature, of one axis."""

    without: Recording
    compensated: Recording


@dataclass(frozen=True)
class Shaft:
    """What judges a run: the motor, and its inertia over the one that the loops are tuned for, if that is less."""

    axis: AxisPlant
    heavier: float


def left(times: float) -> float:
    """Part of the friction that compensation leaves, or brings, when so many times of what is believed are there."""
    return abs(times - 1.0) / times


def behind(recording: Recording) -> NDArray[np.float64]:
    """How far the true shaft is behind the way that the speed set-point asks for [counts]."""
    asked = np.cumsum(recording.speed_ref) * TICK
    return np.asarray((asked - (recording.theta - recording.theta[0])) / COUNT)


def reverse_speed(plant: PlantConfig, seed: int) -> list[Pair]:
    """Sine of the speed, both axes at once."""

    def once(on: bool) -> dict[int, Recording]:
        with spinning(plant, seed) as board:
            for axis in range(AXES):
                features(board, axis, FRICTION=on)
                choose_mode(board, axis, "SPEED")

            def act(k: int) -> None:
                for axis in range(AXES):
                    command_speed(board, axis, SPEED * math.sin(2.0 * math.pi * SPEED_FREQUENCY * k * TICK))

            return watch(board, range(AXES), SETTLE + MEASURED, act)

    return _pairs(once(False), once(True))


def reverse_position(plant: PlantConfig, seed: int) -> list[Pair]:
    """Sine of the position, speed and acceleration fed forward in both runs."""

    def once(on: bool) -> dict[int, Recording]:
        with spinning(plant, seed) as board:
            starts = [position_of(board, axis) for axis in range(AXES)]
            for axis in range(AXES):
                features(board, axis, FRICTION=on, **FORWARD)

            def act(k: int) -> None:
                way = 0.5 * (1.0 - math.cos(2.0 * math.pi * WAY_FREQUENCY * k * TICK))
                for axis, start in enumerate(starts):
                    command_position(board, axis, round(start + 2.0 * WAY * COUNTS_PER_TURN * way))

            return watch(board, range(AXES), SETTLE + MEASURED, act)

    return _pairs(once(False), once(True))


def start(plant: PlantConfig, seed: int) -> list[Pair]:
    """From rest to a low speed."""

    def once(on: bool) -> dict[int, Recording]:
        with spinning(plant, seed) as board:
            for axis in range(AXES):
                features(board, axis, FRICTION=on)
                choose_mode(board, axis, "SPEED")
            watch(board, [0], 10 * TICK)
            for axis in range(AXES):
                command_speed(board, axis, START)
            return watch(board, range(AXES), START_WATCHED)

    return _pairs(once(False), once(True))


def _pairs(without: dict[int, Recording], compensated: dict[int, Recording]) -> list[Pair]:
    return [Pair(without[axis], compensated[axis]) for axis in range(AXES)]


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


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Three frictions, three tasks, without and with."""
    beliefs = believed(plant, seed)
    rows: list[Row] = []
    notes: list[str] = [
        "the friction of the plant is set, Coulomb only, from what the controller believes: "
        + ", ".join(f"{axis_name(axis)} {1e3 * belief.friction:.3g} mN m" for axis, belief in enumerate(beliefs))
    ]
    panels: list[Panel] = []
    for times in TIMES:
        changed = plant
        for axis, belief in enumerate(beliefs):
            changed = changed.with_axis(axis, friction=times * belief.friction, viscous=0.0)
        shafts = [
            Shaft(entry, max(entry.inertia / belief.inertia, 1.0))
            for entry, belief in zip(changed.axes, beliefs, strict=True)
        ]
        tasks = start(changed, seed), reverse_speed(changed, seed), reverse_position(changed, seed)
        for axis in range(AXES):
            what = f"{axis_name(axis)}, friction x {times:g}"
            rows.extend(_rows(what, left(times), shafts[axis], *(task[axis] for task in tasks)))
            if times == 1.0:
                panels.extend(_panels(axis_name(axis), *(task[axis] for task in tasks)))
        notes.append(_note(times, shafts, *tasks))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(what: str, rest: float, shaft: Shaft, begin: Pair, speed: Pair, position: Pair) -> tuple[Row, ...]:
    """What is left of each error is the part of the friction that compensation leaves, and what the encoder hides.

    The loop is slower, and what it does not see grows, as much as the shaft is heavier than the controller believes.
    """
    hidden = HIDDEN * shaft.heavier

    def row(name: str, figure: Callable[[Recording, Shaft], float], pair: Pair, most: float) -> Row:
        return Row(f"{what}, {name}, rms", BEYOND, figure(pair.compensated, shaft), "counts", Bound(most=most))

    return (
        row("start from rest, lost way", lost_at_start, begin, expected_at_start(shaft, rest) + START_HIDDEN),
        row(
            "reversals of speed, lost way",
            lost_at_reversals,
            speed,
            rest * lost_at_reversals(speed.without, shaft) + hidden,
        ),
        row(
            "reversals of position, following error",
            following_error,
            position,
            rest * following_error(position.without, shaft) + hidden,
        ),
    )


def _note(times: float, shafts: list[Shaft], begin: list[Pair], speed: list[Pair], position: list[Pair]) -> str:
    """The figures, and how much of it the current costs that the inverter kept back."""
    parts = [
        f"{label} "
        + " and ".join(
            f"{figure(p.without, s):.3g} -> {figure(p.compensated, s):.3g}" for p, s in zip(pairs, shafts, strict=True)
        )
        for label, figure, pairs in (
            ("start", lost_at_start, begin),
            ("reversals of speed", lost_at_reversals, speed),
            ("of position", following_error, position),
        )
    ]
    costs = " and ".join(
        f"{_rms(pushed(p.compensated, s.axis, position=True, heavier=s.heavier)[round(SETTLE / TICK) :]):.2g}"
        for p, s in zip(position, shafts, strict=True)
    )
    return (
        f"friction x {times:g}, both axes, without -> with, rms [counts]: "
        + ", ".join(parts)
        + f"; taken out of the last: {costs}, for current that did not flow"
    )


def _panels(name: str, begin: Pair, speed: Pair, position: Pair) -> tuple[Panel, ...]:
    end = SETTLE + MEASURED
    return (
        _panel(f"{name}: start from rest", "behind [counts]", begin, behind, 0.0),
        _panel(f"{name}: reversals of speed", "behind [counts]", speed, behind, end - 1.0 / SPEED_FREQUENCY),
        _panel(
            f"{name}: reversals of position",
            "following error [counts]",
            position,
            lambda r: r.position_ref - r.shaft,
            end - 1.0 / WAY_FREQUENCY,
        ),
    )


def _panel(
    title: str, label: str, pair: Pair, signal: Callable[[Recording], NDArray[np.float64]], after: float
) -> Panel:
    first = round(after / TICK)
    curves = tuple(
        Curve(how, recording.time[first:], signal(recording)[first:])
        for how, recording in (("without", pair.without), ("with friction compensation", pair.compensated))
    )
    return Panel(title, "time [s]", label, curves)
