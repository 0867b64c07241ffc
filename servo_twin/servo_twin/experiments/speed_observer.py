"""Speed observer against the M/T method: very low speed, tracking, holding, and what it costs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.board import Board
from servo_twin.experiments.dead_time_torque import pushed, whole_counts
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import Belief, believed
from servo_twin.experiments.rig import (
    COUNT,
    RPM,
    TICK,
    Recording,
    choose_mode,
    command_position,
    command_speed,
    features,
    spinning,
    watch,
)
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "speed-observer"
HELP: Final = """\
Beyond the reference design: an observer takes the speed from position and current (feature SPEED_OBSERVER), without
the wait for an edge. Shown against the enhanced M/T method with the same gains, on a shaft with the inertia and the
friction that the controller believes in: 2 and 5 rpm, where the last edge is tens of milliseconds old; the following
error of a move with feed-forward. Then holding a position, also with other frictions and inertias.
What it costs stands in the notes: a load makes the shaft give way more, and from some 10 rpm on M/T is the smoother."""

SPEEDS: Final = (2.0, 5.0)  # [rpm]
COST_SPEED: Final = 20.0  # [rpm]
SETTLE: Final = 1.0  # [s]
MEASURED: Final = 4.0  # [s]
MOVE: Final = 1.0  # [turns]
ARRIVED: Final = 0.7  # from the set-point on [s]
HELD: Final = 0.5  # [s]
HOLDS: Final = ((1.0, 1.0), (1.0, 0.2), (1.0, 3.0), (0.5, 1.0), (3.0, 1.0))
"""Inertia and friction while a position is held, over what the controller believes."""

LOAD: Final = 2.0  # [A] worth of torque

CYCLE_MOST: Final = 2.0
"""Counts: one to either side, which is what the encoder can tell.

More by what the current that the inverter keeps back around zero moves the shaft to either side (dead_time_torque.py):
friction does not hold a light or light-running one against it, and whether it comes to rest all the same is chance. And
more where the M/T method does no better: neither sees less than a count.
"""

MEAN_MOST: Final = 1.0
"""Deviation of the true mean from the set-point [%]: two counts in 4 s at 2 rpm are 0.4 %."""

BETTER: Final = 1.0


@dataclass(frozen=True)
class Pair:
    """The same run with the M/T method and with the observer."""

    without: Recording
    observed: Recording


def both(plant: PlantConfig, seed: int, axis: int, play: Callable[[Board], Recording]) -> Pair:
    """Play something to a fresh board, once with and once without the observer."""

    def once(observer: bool) -> Recording:
        with spinning(plant, seed) as board:
            features(board, axis, SPEED_OBSERVER=observer)
            return play(board)

    return Pair(once(False), once(True))


def creep(plant: PlantConfig, seed: int, axis: int, speed: float) -> Pair:
    """A constant speed [rad/s], once it has settled."""

    def play(board: Board) -> Recording:
        choose_mode(board, axis, "SPEED")
        command_speed(board, axis, speed)
        return watch(board, [axis], SETTLE + MEASURED)[axis].part(SETTLE)

    return both(plant, seed, axis, play)


def shaft(plant: PlantConfig, axis: int, belief: Belief, inertia: float = 1.0, friction: float = 1.0) -> PlantConfig:
    """Plant with so many times the inertia and the friction that the controller believes in."""
    return plant.with_axis(axis, inertia=inertia * belief.inertia, friction=friction * belief.friction)


def move(plant: PlantConfig, seed: int, axis: int) -> Pair:
    """A move with feed-forward, and the hold after it."""

    def play(board: Board) -> Recording:
        features(board, axis, SPEED_FORWARD=True, ACCELERATION_FORWARD=True)
        start = board.read_raw(f"{axis_name(axis)}.position")[0]
        command_position(board, axis, start + round(MOVE * COUNTS_PER_TURN))
        return watch(board, [axis], ARRIVED + HELD)[axis]

    return both(plant, seed, axis, play)


def push(plant: PlantConfig, seed: int, axis: int) -> Pair:
    """A load step at standstill, within what the motor can hold."""
    motor = plant.axes[axis]

    def play(board: Board) -> Recording:
        board.set_load(axis, 1.5 * motor.pole_pairs * motor.psi_m * LOAD)
        return watch(board, [axis], HELD)[axis]

    return both(plant, seed, axis, play)


def rms(recording: Recording, speed: float) -> float:
    """Root mean square of the true speed's deviation [rad/s]."""
    return float(np.sqrt(np.mean((recording.omega - speed) ** 2)))


def chance(pair: Pair, axis: AxisPlant, speed: float) -> float:
    """What the ratio of two deviations may be off by chance.

    The current that the inverter keeps back disturbs both runs alike. Of its part of the deviation each run shows
    another sample, of as many values as edges of track B have been seen: n values give a root mean square with a
    relative standard deviation of sqrt(1 / 2 n), and the ratio of two one of sqrt(1 / n).
    """
    edges = MEASURED * speed / COUNT / 2.0
    disturbed = np.gradient(pushed(pair.without, axis, position=False) * COUNT, TICK)
    share = min(float(np.mean(disturbed**2)) / rms(pair.without, speed) ** 2, 1.0)
    return share / math.sqrt(edges)


def following(recording: Recording) -> float:
    """Largest distance from the shaped set-point [counts]."""
    return float(np.abs(recording.position_ref - recording.position).max())


def held(recording: Recording) -> float:
    """True movement while the position is held, lowest to highest [counts]."""
    return float(np.ptp(recording.part(ARRIVED).theta)) / COUNT


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Everything on both axes, with and without."""
    rows: list[Row] = []
    notes: list[str] = []
    panels: list[Panel] = []
    for axis, belief in enumerate(believed(plant, seed)):
        name = axis_name(axis)
        known = shaft(plant, axis, belief)
        for rpm in SPEEDS:
            pair = creep(known, seed, axis, rpm * RPM)
            what = f"{name} at {rpm:g} rpm"
            error = 100.0 * abs(float(pair.observed.omega.mean()) / (rpm * RPM) - 1.0)
            ratio = rms(pair.observed, rpm * RPM) / rms(pair.without, rpm * RPM)
            better = Bound(most=BETTER + chance(pair, known.axes[axis], rpm * RPM))
            rows.append(Row(f"{what}, error of the true mean", BEYOND, error, "%", Bound(most=MEAN_MOST)))
            rows.append(Row(f"{what}, deviation with over without", BEYOND, ratio, "", better))
            panels.extend([_creep_panel(what, pair, rpm)] if axis == 0 else [])
        pair = move(known, seed, axis)
        ratio = following(pair.observed) / following(pair.without)
        rows.append(Row(f"{name}, following error with over without", BEYOND, ratio, "", Bound(most=BETTER)))
        panels.extend([_move_panel(name, pair)] if axis == 0 else [])
        for inertia, friction in HOLDS:
            other = shaft(plant, axis, belief, inertia, friction)
            rest = move(other, seed, axis)
            what = f"{name} holds, inertia x {inertia:g}, friction x {friction:g}, movement"
            pushed_most = whole_counts(rest.observed, other.axes[axis], ARRIVED, inertia)
            calm = Bound(most=max(CYCLE_MOST + 2.0 * pushed_most, held(rest.without)))
            rows.append(Row(what, BEYOND, held(rest.observed), "counts", calm))
        notes.extend(_costs(known, seed, axis, pair))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _costs(plant: PlantConfig, seed: int, axis: int, moved: Pair) -> list[str]:
    name = axis_name(axis)
    pushed = push(plant, seed, axis)
    angles = [float(np.degrees(np.abs(r.theta - r.theta[0]).max())) for r in (pushed.without, pushed.observed)]
    crept = creep(plant, seed, axis, COST_SPEED * RPM)
    rough = [rms(r, COST_SPEED * RPM) / RPM for r in (crept.without, crept.observed)]
    errors = [following(r) for r in (moved.without, moved.observed)]
    return [
        f"{name}: following error {errors[0]:.0f} counts without, {errors[1]:.0f} with it",
        f"{name}: gives way {angles[0]:.2g} deg to the torque of {LOAD:g} A without, {angles[1]:.2g} deg with it",
        f"{name} at {COST_SPEED:g} rpm: deviation {rough[0]:.2g} rpm without, {rough[1]:.2g} rpm with it",
    ]


def _creep_panel(title: str, pair: Pair, rpm: float) -> Panel:
    curves = [
        Curve(label, r.time, r.omega / RPM)
        for label, r in (
            ("M/T", pair.without.part(SETTLE, SETTLE + 1.0)),
            ("observer", pair.observed.part(SETTLE, SETTLE + 1.0)),
        )
    ]
    time = curves[0].x
    curves.append(Curve("set-point", time, np.full(time.size, rpm), "k--"))
    return Panel(f"{title}: true speed", "time [s]", "speed [rpm]", tuple(curves))


def _move_panel(name: str, pair: Pair) -> Panel:
    curves = [
        Curve(label, r.time, r.position_ref - r.position)
        for label, r in (("M/T", pair.without.part(0.0, 0.4)), ("observer", pair.observed.part(0.0, 0.4)))
    ]
    title = f"{name}, {MOVE:g} turn with feed-forward: shaped set-point - position"
    return Panel(title, "time [s]", "difference [counts]", tuple(curves))
