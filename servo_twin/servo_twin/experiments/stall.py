"""Stall of an axis without an encoder: how soon it is noticed, also when the rotor oscillates, and false alarms."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.experiments.rig import RPM, TICK, command_speed, level, word
from servo_twin.experiments.sensorless import Trace, fault_names, follow, limits_of, started, without_fault
from servo_twin.plant import PlantConfig

NAME: Final = "stall"
HELP: Final = """\
The shaft of an axis without an encoder is blocked: rigidly at three speeds, and by a stiff spring whose other end
oscillates, so that the rotor oscillates sinusoidally at the stalled position. The reference design detects a stall
from the variance of the last 64 observed speeds, and states that this fails if the rotor oscillates sinusoidally at
the stalled position (ST document, stall detection). Measured: time from the stall to outputs off, and the reported
fault; the notes give the time of the variance criterion alone. Then both axes run for a long time with random
set-points and load steps: a fault is permitted only if the load has stopped the shaft."""

SPEEDS: Final = (0.06, 0.2, 0.8)
"""Parts of the speed limit from which the shaft is stopped."""

SWING: Final = math.radians(20.0)
"""Amplitude of the oscillation, mechanical [rad]."""

STIFF: Final = 80.0
"""Frequency that the spring gives to the inertia [Hz]: the motor bends it by a few degrees only."""

FREQUENCIES: Final = (4.0, 8.0, 16.0)
"""Of the oscillation [Hz]."""

SIZE: Final = 64  # observed speeds of the reference design's criterion
THRESHOLD: Final = 0.0625  # VARIANCE_THRESHOLD of the drive
HYSTERESIS: Final = 200  # RELIABILITY_HYSTERESYS of the drive, slow ticks

NOTICED_MAX: Final = (SIZE + HYSTERESIS) * TICK
"""What the reference design's own criterion takes when every test fails from the stall on [s]."""

OSCILLATING_MAX: Final = 0.5
"""The reference design does not notice at all; so long may a shaft with an encoder stand at full current [s]."""

BEFORE: Final = 0.4  # the axis turns steadily for so long [s]
WATCHED: Final = 2.0  # after the stall [s]

LONG: Final = 60.0  # of random operation [s]
LONG_SLOWLY: Final = 3.0  # the same at register level, which takes about ten times as long [s]
HOLDS: Final = (0.05, 1.5)  # of one set-point [s]
RANGE: Final = (0.06, 1.0)  # of the set-points, parts of the speed limit
LOOK_NS: Final = 1_000_000
"""Between two looks at the shafts [ns]."""

RECENT_NS: Final = 150_000_000
"""A shaft that stood so short a time ago was not observable when its fault came [ns]."""

LOAD_STEP: Final = 0.25
"""Largest load against the motion, over the torque at the current limit."""


@dataclass(frozen=True)
class Stall:
    """A shaft that was caught."""

    noticed: float | None  # from the stall to outputs off [s]
    faults: str  # reported faults
    by_variance: float | None  # until the variance of the observed speed alone would have shown it [s]
    trace: Trace


def variance_tells(trace: Trace, since: float) -> float | None:
    """When so many tests of mean and variance in a row have failed after a stall [s]."""
    speed = trace.speed
    sums, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (speed, speed**2))
    mean = (sums[SIZE:] - sums[:-SIZE]) / SIZE
    variance = (squares[SIZE:] - squares[:-SIZE]) / SIZE - mean**2
    failed = variance >= mean**2 * THRESHOLD
    row = 0
    for k, bad in enumerate(failed):
        row = row + 1 if bad else 0
        if row > HYSTERESIS and (k + SIZE) * TICK > since:
            return (k + SIZE) * TICK - since
    return None


def stall(plant: PlantConfig, seed: int, axis: int, part: float, frequency: float | None) -> Stall:
    """Catch the shaft of an axis; with a frequency [Hz] it oscillates.

    A first run tells how soon the drive notices, a second one, in which it may not, what the variance says.
    """
    noticed, faults = _caught(plant, seed, axis, part, frequency, stopped=True)
    time = float(noticed.time[-1]) - BEFORE if faults else None
    unnoticed, _ = _caught(plant, seed, axis, part, frequency, stopped=False)
    return Stall(time, faults, variance_tells(unnoticed, BEFORE), noticed)


def _caught(
    plant: PlantConfig, seed: int, axis: int, part: float, frequency: float | None, *, stopped: bool
) -> tuple[Trace, str]:
    """A trace from before the stall until the first fault, and its name."""
    with started(plant, seed, {axis: 1.0}) as board:
        if not stopped:
            without_fault(board, axis, "SPEED_FEEDBACK")
        command_speed(board, axis, part * limits_of(board, axis)[0])
        follow(board, [], BEFORE)
        caught = round(BEFORE / TICK)
        pull = _spring(board, axis, frequency or 0.0)

        def act(k: int) -> bool:
            if k == caught and frequency is None:
                board.lock_shaft(axis)
            elif k >= caught and frequency is not None:
                pull((k - caught) * TICK)
            return k > caught and word(board, axis, "faults") != 0

        trace = follow(board, [axis], BEFORE + WATCHED, act)[axis]
        return trace, fault_names(board, int(trace.faults[-1]))


def _spring(board: Board, axis: int, frequency: float) -> Callable[[float], None]:
    """Hold a shaft at an angle that swings, against friction of its own, at times since it was caught [s]."""
    inertia, stiff, omega = board.plant.axes[axis].inertia, 2.0 * math.pi * STIFF, 2.0 * math.pi * frequency
    stiffness, friction = inertia * stiff**2, 1.4 * inertia * stiff
    middle: float | None = None

    def pull(time: float) -> None:
        nonlocal middle
        truth = board.truth(axis)
        if middle is None:
            middle = truth.theta_m
        swing, slope = SWING * math.sin(omega * time), SWING * omega * math.cos(omega * time)
        board.set_load(axis, stiffness * (truth.theta_m - middle - swing) + friction * (truth.omega_m - slope))

    return pull


@dataclass(frozen=True)
class Operation:
    """A long run."""

    false: tuple[str, ...]  # faults of shafts that turned
    true: tuple[str, ...]
    """Faults of shafts that had come to a stand: load and ramps were too much for the speed controller."""
    ran: float  # simulated time [s]


def operate(plant: PlantConfig, seed: int, seconds: float) -> Operation:
    """Random set-points and loads on both axes for so many seconds; after a fault another board goes on."""
    source = random.Random(f"stall {seed}")
    false: list[str] = []
    true: list[str] = []
    ran = 0.0
    while ran < seconds:
        fault, stood, time = _until_fault(plant, seed + len(false) + len(true), source, seconds - ran)
        ran += max(time, TICK)
        if fault:
            (true if stood else false).append(fault)
    return Operation(tuple(false), tuple(true), ran)


def _until_fault(plant: PlantConfig, seed: int, source: random.Random, seconds: float) -> tuple[str, bool, float]:
    """Faults that ended a run, whether their shaft had stood, and the time that passed [s]."""
    ways = (1.0, -1.0)
    with started(plant, seed, dict(enumerate(ways))) as board:
        follow(board, [], BEFORE)
        acts = [_operator(board, axis, ways[axis], random.Random(source.random())) for axis in range(AXES)]
        slow = [0.5 * RANGE[0] * limits_of(board, axis)[0] for axis in range(AXES)]
        begun, stood = board.time_ns, [0] * AXES
        while (board.time_ns - begun) * 1e-9 < seconds:
            pause = min(act(board.time_ns) for act in acts)
            board.advance(min(pause, board.time_ns + LOOK_NS))
            for axis in range(AXES):
                if ways[axis] * board.truth(axis).omega_m < slow[axis]:
                    stood[axis] = board.time_ns
            for axis in range(AXES):
                if faults := word(board, axis, "faults"):
                    recently = stood[axis] > 0 and board.time_ns - stood[axis] < RECENT_NS
                    name = f"{axis_name(axis)} {fault_names(board, faults)}"
                    return name, recently, (board.time_ns - begun) * 1e-9
        return "", False, (board.time_ns - begun) * 1e-9


def _operator(board: Board, axis: int, way: float, source: random.Random) -> Callable[[int], int]:
    """Changes set-point and load of one axis when it is time; says when it wants to be asked again [ns]."""
    limit, current = limits_of(board, axis)
    torque = LOAD_STEP * current * board.plant.axes[axis].torque_constant
    due = 0

    def act(now: int) -> int:
        nonlocal due
        if now >= due:
            speed = source.uniform(*RANGE)
            command_speed(board, axis, way * speed * limit)
            board.set_load(axis, way * torque * source.random() * min(speed / 0.2, 1.0))
            due = now + round(source.uniform(*HOLDS) * 1e9)
        return due

    return act


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes: held fast, oscillating, and a long time without a stall."""
    for axis in range(AXES):
        name, shown = axis_name(axis), {}
        cases: list[tuple[str, float, float | None, str, float]] = [
            *((f"held fast from {100.0 * p:.0f} %", p, None, "a fault by the variance", NOTICED_MAX) for p in SPEEDS),
            *((f"oscillating with {f:g} Hz", SPEEDS[1], f, "not noticed", OSCILLATING_MAX) for f in FREQUENCIES),
        ]
        for what, part, frequency, says, maximum in cases:
            it, judge = stall(plant, seed, axis, part, frequency), Judge(f"{name}, {what}, ", says)
            time = None if it.noticed is None else 1e3 * it.noticed
            yield judge("outputs off after", time, "ms", maximum=1e3 * maximum)
            named, error = it.faults == "SPEED_FEEDBACK", "error on speed feedback"
            yield judge.true("is called SPEED_FEEDBACK", named, reference=error)
            alone = f"nothing in {WATCHED:g} s" if it.by_variance is None else f"after {1e3 * it.by_variance:.0f} ms"
            yield f"{name}, {what}: {it.faults or 'nothing'}; the variance alone tells {alone}"
            shown["held fast" if frequency is None else f"{frequency:g} Hz"] = it.trace
        curves: list[Curve] = []
        for label, trace in shown.items():
            late = trace.time > BEFORE - 0.05
            curves.append(Curve(f"observed, {label}", 1e3 * (trace.time[late] - BEFORE), trace.speed[late] / RPM))
        yield Panel(f"{name}: observed speed until the outputs are off", "time [ms]", "speed [rpm]", curves)
    long = operate(plant, seed, LONG if level() == "ideal" else LONG_SLOWLY)
    yield Judge("", NOT_SHOWN)("false alarms of both axes, random operation", len(long.false), maximum=0.0)
    yield f"random operation for {long.ran:.3g} s: false alarms {', '.join(long.false) or 'none'}"
    yield from (f"there the load brought a shaft to a stand: {fault}" for fault in long.true)
