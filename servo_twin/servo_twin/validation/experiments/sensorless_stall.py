"""Stall of a sensorless axis: detection time, also with an oscillating rotor, and false alarms."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import word, write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import RPM, level
from servo_twin.validation.experiments.sensorless import fault_names, follow, limits_of, started, without_fault

NAME: Final = "stall"
HELP: Final = """\
The shaft of an axis without an encoder is blocked: rigidly at three speeds, and by a stiff spring whose other end
oscillates, so that the rotor oscillates sinusoidally at the stalled position. The reference design detects a stall
from the variance of the last 64 observed speeds, and states that this fails if the rotor oscillates sinusoidally at
the stalled position (ST document, stall detection). Measured: time from the stall to outputs off, and the reported
fault; the notes give the time of the variance criterion alone. Then both axes run for a long time with random
set-points and load steps: a fault is permitted only if the load has stopped the shaft."""

SPEEDS: Final = (0.06, 0.2, 0.8)
"""Speeds before the stall, relative to the speed limit."""

AMPLITUDE: Final = math.radians(20.0)
"""Amplitude of the oscillation, mechanical [rad]."""

SPRING_FREQUENCY: Final = 80.0
"""Natural frequency of spring and inertia [Hz]: the motor torque deflects the spring by a few degrees only."""

FREQUENCIES: Final = (4.0, 8.0, 16.0)
"""Frequencies of the oscillation [Hz]."""

SIZE: Final = 64  # number of speeds in the criterion of the reference design
THRESHOLD: Final = 0.0625  # VARIANCE_THRESHOLD of the drive
HYSTERESIS: Final = 200  # RELIABILITY_HYSTERESYS of the drive, slow ticks

DETECTION_MAX: Final = (SIZE + HYSTERESIS) * TICK
"""Detection time of the criterion of the reference design, if every test fails after the stall [s]."""

OSCILLATING_MAX: Final = 0.5
"""Permitted time at full current with an encoder [s]; the reference design does not detect this stall."""

BEFORE: Final = 0.4  # time at constant speed before the stall [s]
OBSERVED: Final = 2.0  # time after the stall [s]

LONG: Final = 60.0  # duration of random operation [s]
LONG_REGISTERS: Final = 3.0  # duration at level registers, which takes about ten times as long [s]
HOLDS: Final = (0.05, 1.5)  # duration of one set-point [s]
RANGE: Final = (0.06, 1.0)  # set-points, relative to the speed limit
SAMPLE_NS: Final = 1_000_000
"""Sampling interval of the shafts [ns]."""

RECENT_NS: Final = 150_000_000
"""A fault within this time after standstill is not a false alarm, because the shaft was not observable [ns]."""

LOAD_STEP: Final = 0.25
"""Largest load torque against the motion, relative to the torque at the current limit."""


@dataclass(frozen=True)
class Stall:
    """Result of one stall."""

    detected: float | None  # from the stall to outputs off [s]
    faults: str  # reported faults
    variance_time: float | None  # detection time of the variance criterion alone [s]
    trace: Trace


def variance_detection_time(trace: Trace, since: float) -> float | None:
    """Detection time of the variance criterion: `HYSTERESIS` consecutive failed tests after a stall [s]."""
    speed = trace["speed"]
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
    """Block the shaft of an axis; with a frequency [Hz] it oscillates.

    The first run measures the detection time; the second one, with the fault disabled, the variance criterion.
    """
    detected, faults = _blocked(plant, seed, axis, part, frequency, stopped=True)
    time = float(detected.time[-1]) - BEFORE if faults else None
    undetected, _ = _blocked(plant, seed, axis, part, frequency, stopped=False)
    return Stall(time, faults, variance_detection_time(undetected, BEFORE), detected)


def _blocked(
    plant: PlantConfig, seed: int, axis: int, part: float, frequency: float | None, *, stopped: bool
) -> tuple[Trace, str]:
    """Trace from before the stall to the first fault, and the name of the fault."""
    with started(plant, seed, {axis: 1.0}) as board:
        if not stopped:
            without_fault(board, axis, "SPEED_FEEDBACK")
        write_axis(board, "cmd.speed", axis, part * limits_of(board, axis)[0])
        follow(board, [], BEFORE)
        blocked = round(BEFORE / TICK)
        pull = _spring(board, axis, frequency or 0.0)

        def act(k: int) -> bool:
            if k == blocked and frequency is None:
                board.lock_shaft(axis)
            elif k >= blocked and frequency is not None:
                pull((k - blocked) * TICK)
            return k > blocked and word(board, axis, "faults") != 0

        trace = follow(board, [axis], BEFORE + OBSERVED, act)[axis]
        return trace, fault_names(board, int(trace["faults"][-1]))


def _spring(board: Board, axis: int, frequency: float) -> Callable[[float], None]:
    """Load function of a damped spring at an oscillating angle; its argument is the time since the stall [s]."""
    inertia, spring_omega, omega = (
        board.plant.axes[axis].inertia,
        2.0 * math.pi * SPRING_FREQUENCY,
        2.0 * math.pi * frequency,
    )
    stiffness, friction = inertia * spring_omega**2, 1.4 * inertia * spring_omega
    centre: float | None = None

    def pull(time: float) -> None:
        nonlocal centre
        truth = board.truth(axis)
        if centre is None:
            centre = truth.theta_m
        angle, slope = AMPLITUDE * math.sin(omega * time), AMPLITUDE * omega * math.cos(omega * time)
        board.set_load(axis, stiffness * (truth.theta_m - centre - angle) + friction * (truth.omega_m - slope))

    return pull


@dataclass(frozen=True)
class Operation:
    """Result of the random operation."""

    false: tuple[str, ...]  # faults of rotating shafts
    true: tuple[str, ...]
    """Faults of shafts at standstill, stopped by load and ramps."""
    ran: float  # simulated time [s]


def operate(plant: PlantConfig, seed: int, seconds: float) -> Operation:
    """Random set-points and loads on both axes for `seconds` [s]; after a fault with another board."""
    source = random.Random(f"stall {seed}")
    false: list[str] = []
    true: list[str] = []
    ran = 0.0
    while ran < seconds:
        fault, standstill, time = _until_fault(plant, seed + len(false) + len(true), source, seconds - ran)
        ran += max(time, TICK)
        if fault:
            (true if standstill else false).append(fault)
    return Operation(tuple(false), tuple(true), ran)


def _until_fault(plant: PlantConfig, seed: int, source: random.Random, seconds: float) -> tuple[str, bool, float]:
    """Faults that ended a run, whether the shaft was at standstill, and the duration [s]."""
    directions = (1.0, -1.0)
    with started(plant, seed, dict(enumerate(directions))) as board:
        follow(board, [], BEFORE)
        acts = [_operator(board, axis, directions[axis], random.Random(source.random())) for axis in range(AXES)]
        slow = [0.5 * RANGE[0] * limits_of(board, axis)[0] for axis in range(AXES)]
        start, standstill = board.time_ns, [0] * AXES
        while (board.time_ns - start) * 1e-9 < seconds:
            pause = min(act(board.time_ns) for act in acts)
            board.advance(min(pause, board.time_ns + SAMPLE_NS))
            for axis in range(AXES):
                if directions[axis] * board.truth(axis).omega_m < slow[axis]:
                    standstill[axis] = board.time_ns
            for axis in range(AXES):
                if faults := word(board, axis, "faults"):
                    recently = standstill[axis] > 0 and board.time_ns - standstill[axis] < RECENT_NS
                    name = f"{axis_name(axis)} {fault_names(board, faults)}"
                    return name, recently, (board.time_ns - start) * 1e-9
        return "", False, (board.time_ns - start) * 1e-9


def _operator(board: Board, axis: int, direction: float, source: random.Random) -> Callable[[int], int]:
    """Function that changes set-point and load of one axis when due; returns the time of its next action [ns]."""
    limit, current = limits_of(board, axis)
    torque = LOAD_STEP * current * board.plant.axes[axis].torque_constant
    due = 0

    def act(now: int) -> int:
        nonlocal due
        if now >= due:
            speed = source.uniform(*RANGE)
            write_axis(board, "cmd.speed", axis, direction * speed * limit)
            board.set_load(axis, direction * torque * source.random() * min(speed / 0.2, 1.0))
            due = now + round(source.uniform(*HOLDS) * 1e9)
        return due

    return act


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes: blocked, oscillating, and random operation without a stall."""
    for axis in range(AXES):
        name, shown = axis_name(axis), {}
        rigid = "rigidly blocked at {:.0f} % of the speed limit"
        cases: list[tuple[str, float, float | None, str, float]] = [
            *((rigid.format(100.0 * p), p, None, "a fault by the variance", DETECTION_MAX) for p in SPEEDS),
            *((f"oscillating with {f:g} Hz", SPEEDS[1], f, "not detected", OSCILLATING_MAX) for f in FREQUENCIES),
        ]
        for what, part, frequency, reference, maximum in cases:
            stalled, judge = stall(plant, seed, axis, part, frequency), Judge(f"{name}, {what}, ", reference)
            time = None if stalled.detected is None else 1e3 * stalled.detected
            yield judge("time until outputs off", time, "ms", maximum=1e3 * maximum)
            named, error = stalled.faults == "SPEED_FEEDBACK", "error on speed feedback"
            yield judge.true("reported fault SPEED_FEEDBACK", named, reference=error)
            alone = (
                f"not in {OBSERVED:g} s"
                if stalled.variance_time is None
                else f"after {1e3 * stalled.variance_time:.0f} ms"
            )
            yield f"{name}, {what}: {stalled.faults or 'no fault'}; variance criterion alone: {alone}"
            shown["rigidly blocked" if frequency is None else f"{frequency:g} Hz"] = stalled.trace
        curves: list[Curve] = []
        for label, trace in shown.items():
            late = trace.time > BEFORE - 0.05
            curves.append(Curve(f"observed, {label}", 1e3 * (trace.time[late] - BEFORE), trace["speed"][late] / RPM))
        yield Panel(f"{name}: observed speed until the outputs are off", "time [ms]", "speed [rpm]", curves)
    long = operate(plant, seed, LONG if level() == "ideal" else LONG_REGISTERS)
    yield Judge("", NOT_SHOWN)("false alarms of both axes, random operation", len(long.false), maximum=0.0)
    yield f"random operation for {long.ran:.3g} s: false alarms {', '.join(long.false) or 'none'}"
    yield from (f"standstill by the load: {fault}" for fault in long.true)
