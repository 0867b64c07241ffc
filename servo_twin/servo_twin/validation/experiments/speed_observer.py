"""Speed observer compared with the M/T method: very low speed, following error, hold, disadvantages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from servo_msgs_py.board_port import word, write_word
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.dead_time_torque import displacement, displacement_counts
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import NominalShaft, nominal_shafts
from servo_twin.validation.experiments.rig import COUNT, RPM

NAME: Final = "speed-observer"
HELP: Final = """\
Beyond the reference design: an observer estimates the speed from position and current (feature SPEED_OBSERVER),
without waiting for an edge. Compared with the enhanced M/T method with the same gains, on a shaft with nominal inertia
and friction: 2 and 5 rpm, where edges of a track are 15 and 6 ms apart; the following error of a move with
feed-forward. Then position hold, also with other frictions and inertias. Disadvantages, given in the notes: lower
stiffness under load, and above some 10 rpm M/T is smoother."""

SPEEDS: Final = (2.0, 5.0)  # [rpm]
COST_SPEED: Final = 20.0  # [rpm]
SETTLE: Final = 1.0  # [s]
MEASURED: Final = 4.0  # [s]
MOVE: Final = 1.0  # [turns]
ARRIVED: Final = 0.7  # time of the move [s]
HELD: Final = 0.5  # [s]
HOLDS: Final = ((1.0, 1.0), (1.0, 0.2), (1.0, 3.0), (0.5, 1.0), (3.0, 1.0))
"""Inertia and friction for position hold, relative to the nominal values."""

LOAD: Final = 2.0  # load torque, as current [A]

CYCLE_MAX: Final = 2.0
"""Permitted peak-to-peak motion in position hold [counts]: one count to each side, the resolution of the encoder.

The displacement by the inverter (dead_time_torque.py) is added: with a small inertia or friction the shaft may not come
to standstill. The motion with the M/T method is always permitted.
"""

MEAN_MAX: Final = 1.0
"""Permitted error of the true mean speed [%]: two counts in 4 s at 2 rpm are 0.4 %."""

BETTER: Final = 1.0


Pair = tuple[Trace, Trace]
"""The same run with the M/T method and with the observer."""


def both(plant: PlantConfig, seed: int, axis: int, play: Callable[[Board], Trace]) -> Pair:
    """Run `play` on a new board without, and on another one with the observer."""

    def once(observer: bool) -> Trace:
        with rig.spinning(plant, seed) as board:
            rig.features(board, axis, SPEED_OBSERVER=observer)
            return play(board)

    return once(False), once(True)


def creep(plant: PlantConfig, seed: int, axis: int, speed: float) -> Pair:
    """A constant speed [rad/s], once it has settled."""

    def play(board: Board) -> Trace:
        rig.set_up(board, axis, "SPEED", speed)
        return rig.record(board, [axis], SETTLE + MEASURED)[axis].part(SETTLE)

    return both(plant, seed, axis, play)


def shaft(
    plant: PlantConfig, axis: int, nominal: NominalShaft, inertia: float = 1.0, friction: float = 1.0
) -> PlantConfig:
    """Plant with inertia and friction as multiples of the nominal values."""
    return plant.with_axis(axis, inertia=inertia * nominal.inertia, friction=friction * nominal.friction)


def move(plant: PlantConfig, seed: int, axis: int) -> Pair:
    """A move with feed-forward, and the hold after it."""

    def play(board: Board) -> Trace:
        rig.features(board, axis, SPEED_FORWARD=True, ACCELERATION_FORWARD=True)
        write_word(board, "cmd.position", axis, word(board, axis, "position") + round(MOVE * COUNTS_PER_TURN))
        return rig.record(board, [axis], ARRIVED + HELD)[axis]

    return both(plant, seed, axis, play)


def push(plant: PlantConfig, seed: int, axis: int) -> Pair:
    """A load step at standstill, within what the motor can hold."""

    def play(board: Board) -> Trace:
        board.set_load(axis, LOAD * plant.axes[axis].torque_constant)
        return rig.record(board, [axis], HELD)[axis]

    return both(plant, seed, axis, play)


def rms(recording: Trace, speed: float) -> float:
    """RMS deviation of the true speed [rad/s]."""
    return float(np.sqrt(np.mean((recording["omega"] - speed) ** 2)))


def ratio_uncertainty(without: Trace, plant: PlantConfig, axis: int, speed: float) -> float:
    """Statistical uncertainty of the ratio of two RMS deviations.

    The dead zone of the inverter disturbs both runs. Its part of the deviation is a random sample with one value per
    edge of track B: an RMS of n values has a relative standard deviation of sqrt(1 / (2 n)), the ratio of two of
    sqrt(1 / n).
    """
    edges = MEASURED * speed / COUNT / 2.0
    disturbed = np.gradient(displacement(without, plant, axis, position=False) * COUNT, TICK)
    share = min(float(np.mean(disturbed**2)) / rms(without, speed) ** 2, 1.0)
    return share / math.sqrt(edges)


def following(recording: Trace) -> float:
    """Largest following error against the shaped set-point [counts]."""
    return float(np.abs(recording["position_ref"] - recording["position"]).max())


def held(recording: Trace) -> float:
    """Peak-to-peak true motion in position hold [counts]."""
    return float(np.ptp(recording.part(ARRIVED)["theta"])) / COUNT


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """All runs on both axes, with and without the observer."""
    for axis, nominal in enumerate(nominal_shafts(plant, seed)):
        name, nominal_plant = axis_name(axis), shaft(plant, axis, nominal)
        for rpm in SPEEDS:
            speed, judge = rpm * RPM, Judge(f"{name} at {rpm:g} rpm, ")
            without, observed = creep(nominal_plant, seed, axis, speed)
            error = 100.0 * abs(float(observed["omega"].mean()) / speed - 1.0)
            better = BETTER + ratio_uncertainty(without, nominal_plant, axis, speed)
            yield judge("error of the mean true speed", error, "%", maximum=MEAN_MAX)
            yield judge("deviation with / without observer", rms(observed, speed) / rms(without, speed), maximum=better)
            if axis == 0:
                yield _creep_panel(f"{name} at {rpm:g} rpm", without, observed, rpm)
        judge = Judge(f"{name}, ")
        moved = without, observed = move(nominal_plant, seed, axis)
        ratio = following(observed) / following(without)
        yield judge("following error with / without observer", ratio, maximum=BETTER)
        if axis == 0:
            yield _move_panel(name, without, observed)
        for inertia, friction in HOLDS:
            other = shaft(plant, axis, nominal, inertia, friction)
            without, observed = move(other, seed, axis)
            inverter_displacement = displacement_counts(observed, other, axis, ARRIVED, inertia)
            motion_max = max(CYCLE_MAX + 2.0 * inverter_displacement, held(without))
            what = f"{name} holds, inertia x {inertia:g}, friction x {friction:g}, "
            yield Judge(what)("movement", held(observed), "counts", maximum=motion_max)
        yield from _costs(nominal_plant, seed, axis, moved)


def _costs(plant: PlantConfig, seed: int, axis: int, moved: Pair) -> Iterator[str]:
    name = axis_name(axis)
    angles = [float(np.degrees(np.abs(r["theta"] - r["theta"][0]).max())) for r in push(plant, seed, axis)]
    rough = [rms(r, COST_SPEED * RPM) / RPM for r in creep(plant, seed, axis, COST_SPEED * RPM)]
    errors = [following(r) for r in moved]
    yield f"{name}: following error {errors[0]:.0f} counts without, {errors[1]:.0f} with it"
    yield f"{name}: deflection by the torque of {LOAD:g} A {angles[0]:.2g} deg without, {angles[1]:.2g} deg with it"
    yield f"{name} at {COST_SPEED:g} rpm: deviation {rough[0]:.2g} rpm without, {rough[1]:.2g} rpm with it"


def _creep_panel(title: str, without: Trace, observed: Trace, rpm: float) -> Panel:
    parts = {"M/T": without.part(SETTLE, SETTLE + 1.0), "observer": observed.part(SETTLE, SETTLE + 1.0)}
    curves = [Curve(label, r.time, r["omega"] / RPM) for label, r in parts.items()]
    time = curves[0].x
    curves.append(Curve("set-point", time, np.full(time.size, rpm), "k--"))
    return Panel(f"{title}: true speed", "time [s]", "speed [rpm]", curves)


def _move_panel(name: str, without: Trace, observed: Trace) -> Panel:
    parts = {"M/T": without.part(0.0, 0.4), "observer": observed.part(0.0, 0.4)}
    curves = [Curve(label, r.time, r["position_ref"] - r["position"]) for label, r in parts.items()]
    title = f"{name}, {MOVE:g} turn with feed-forward: shaped set-point - position"
    return Panel(title, "time [s]", "difference [counts]", curves)
