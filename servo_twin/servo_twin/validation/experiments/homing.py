"""Homing to hard stops (rubber to steel) and to switches; missing stop; axis that is not homed."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.board_port import active, word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK_NS

from servo_twin.board import Board
from servo_twin.plant import STOP_STIFFNESS_MAX, PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.pins import fit
from servo_twin.validation.experiments.plant_limits import ripple
from servo_twin.validation.experiments.rig import COUNT, shaft_counts

NAME: Final = "homing"
HELP: Final = """\
Beyond the reference design, whose position is relative to the rotor search (E41). Shown: both axes home to
hard stops at random positions on both sides, with random stiffness and damping, twice each: spread, repeatability and
position error against the true angle of the stop, current and force of the contact. The same with home switches,
starting off and on the switch. A missing stop is a fault within the configured distance. With the feature HOMING an
axis that is not homed refuses far set-points and stays near the position at which it was enabled."""

KINDS: Final[Mapping[str, tuple[float, float]]] = {"rubber": (0.3, 3.0), "plastic": (3.0, 30.0), "steel": (30.0, 150.0)}
"""Stiffness of a stop [N m/rad]."""

TRIALS: Final = 4
DAMPING: Final = (0.05, 0.7)  # damping ratio of the shaft at the stop
AWAY: Final = (0.3, 9.0)  # distance from the start [rad]
SECOND_START: Final = 1.0  # distance from the stop before the second homing [rad]
HOMING_TIMEOUT: Final = 12.0  # timeout of a homing [s]
NEAR: Final = 0.05  # distance from the stop with fine sampling [rad]
FINE_STEP: Final = TICK_NS // 8
FAR: Final = 20.0  # [rad]
SPEED: Final = 60.0  # [rad/s]

SPREAD_MAX: Final = 3.0
"""Permitted spread of three contacts, which differ by friction [counts]."""

PLACE_MAX: Final = 2.0
"""Permitted error in addition to the error by friction [counts]: one count at each end."""

START_ON_SWITCH: Final = (0.1, 0.6)  # start beyond the edge of a switch [rad]
SWITCH_WIDTH: Final = 30.0  # width of a switch [rad]
BEYOND_EDGE: Final = (-1.0, 6.0)
"""Permitted position of the detected edge of a switch [counts]: a count of the encoder, and three slow ticks (one until
reading, two of the filter) at the speed of the first approach. The other approaches are slower on average only."""

SWITCH_SPREAD: Final = BEYOND_EDGE[1] - 1.0
"""Permitted spread of three edges, which differ by the speed at each [counts]."""

CURRENT_MAX: Final = 1.25
"""Largest true current relative to the limit, of some ten thousand samples: dead time and noise."""

OVERSHOOT: Final = 1.2
"""Speed at the contact relative to the configured one: ripple of the M/T method at low speed; squared, also the
additional force by a lag of half a tick."""


@dataclass(frozen=True)
class Settings:
    """Configuration of the homing of a board."""

    speed: float  # [rad/s]
    current: float  # [A]
    reach: float  # [rad]
    turns_max: float  # [turns]

    @classmethod
    def of(cls, board: Board) -> Settings:
        """Settings of axis 1; axis 2 has the same."""
        block, members = read_block(board, 0), AxisConfigTable.load().members
        return cls(*(block[f"home.{name}"] * members[f"home.{name}"].lsb for name in cls.__dataclass_fields__))


@dataclass(frozen=True)
class Stop:
    """A pair of end stops: distance from the start [rad], stiffness [N m/rad], damping [N m s]."""

    away: float  # distance from the start [rad]
    stiffness: float  # [N m/rad]
    damping: float  # [N m s]


@dataclass(frozen=True)
class Contact:
    """Result of two homings of an axis to the same stop."""

    done: bool  # both have succeeded
    spread: float  # larger spread of both [counts]
    repeats: float  # distance of the two references, minus the permitted error by friction [counts]
    place: float  # first reference from the equilibrium at the stop, minus the error by friction [counts]
    current: float  # largest true current relative to the limit, without the ripple
    force: float  # largest torque of the stop relative to that of an ideal spring with this current and kinetic energy


def stops_of(plant: PlantConfig, seed: int, kind: str, trial: int) -> tuple[PlantConfig, list[Stop]]:
    """Plant with random stops on both axes."""
    rnd = random.Random(f"{NAME} {kind} {trial} {seed}")
    plant = plant.drawn(seed)
    low, high = (math.log(k) for k in KINDS[kind])
    stops: list[Stop] = []
    for axis, entry in enumerate(plant.axes):
        assert not isinstance(entry.theta_start, str)
        stiffness = min(math.exp(rnd.uniform(low, high)), STOP_STIFFNESS_MAX * entry.inertia * plant.pwm_frequency**2)
        damping = 2.0 * rnd.uniform(*DAMPING) * math.sqrt(stiffness * entry.inertia)
        stops.append(Stop(rnd.uniform(*AWAY), stiffness, damping))
        plant = plant.with_axis(
            axis,
            stop_min=entry.theta_start - stops[-1].away,
            stop_max=entry.theta_start + stops[-1].away,
            stop_stiffness=stiffness,
            stop_damping=damping,
        )
    return plant, stops


def start_homing(board: Board, axis: int, method: str, position: float = 0.0) -> None:
    """Write ``cmd.home`` with the position of the reference [rad]."""
    write_axis(board, "cmd.home_position", axis, position)
    write_axis(board, "cmd.home", axis, board.catalogue.enums["home_method_t"][method])


def _labels(board: Board, what: str) -> list[str]:
    """``home_state`` or ``home_result`` of both axes as text."""
    return [board.catalogue.label(f"{what}_t", word(board, axis, what)) for axis in range(AXES)]


def _home(board: Board, method: str, stops: list[Stop]) -> tuple[list[float], list[float]]:
    """Home both axes: largest current [A] and stop torque [N m] of each, with fine sampling at the contact."""
    for axis in range(AXES):
        start_homing(board, axis, method)
    currents, torques = [0.0] * AXES, [0.0] * AXES
    end = board.time_ns + round(HOMING_TIMEOUT * 1e9)
    started = False
    while board.time_ns < end:
        fine = False
        for axis, entry in enumerate(board.plant.axes):
            truth = board.truth(axis)
            penetration = max(truth.theta_m - entry.stop_max, entry.stop_min - truth.theta_m)
            torques[axis] = max(torques[axis], max(penetration, 0.0) * stops[axis].stiffness)
            currents[axis] = max(currents[axis], abs(truth.i_q))
            fine = fine or (penetration > -NEAR and abs(truth.omega_m) > 0.1)
        board.advance(board.time_ns + (FINE_STEP if fine else TICK_NS))
        states = _labels(board, "home_state")
        started = started or "HOMING" in states
        if started and "HOMING" not in states:
            break
    board.run(0.1)
    return currents, torques


def _wait(board: Board, longest: float) -> None:
    """Run until no axis is homing, at most `longest` [s]."""
    board.run(0.01)
    end = board.time_ns + round(longest * 1e9)
    while board.time_ns < end and "HOMING" in _labels(board, "home_state"):
        board.write("cmd.enable", [1.0] * AXES)  # keep-alive of the host
        board.run(0.1)


def _spreads(board: Board) -> list[float]:
    return [float(word(board, axis, "home_spread")) for axis in range(AXES)]


def _zeros(board: Board) -> list[float]:
    """True angle at which the position would be 0 [rad]."""
    return [board.truth(axis).theta_m - word(board, axis, "position") * COUNT for axis in range(AXES)]


def contacts(plant: PlantConfig, seed: int, kind: str, trial: int) -> list[Contact]:
    """Home both axes twice to the same stops, from different positions."""
    plant, stops = stops_of(plant, seed, kind, trial)
    direction = 1.0 if trial % 2 == 0 else -1.0
    method = "STOP_POSITIVE" if direction > 0.0 else "STOP_NEGATIVE"
    with rig.spinning(plant, seed) as board:
        home = Settings.of(board)
        currents, torques = _home(board, method, stops)
        zeros, results, spreads = [_zeros(board)], [_labels(board, "home_result")], [_spreads(board)]
        for axis, state in enumerate(_labels(board, "home_state")):
            if state == "KNOWN":
                write_word(board, "cmd.position", axis, round(-direction * min(SECOND_START, stops[axis].away) / COUNT))
        board.run(1.0)
        _home(board, method, stops)
        zeros.append(_zeros(board))
        results.append(_labels(board, "home_result"))
        spreads.append(_spreads(board))
    found: list[Contact] = []
    for axis, entry in enumerate(plant.axes):
        push = home.current * entry.torque_constant
        stick = entry.friction / stops[axis].stiffness / COUNT
        edge = entry.stop_max if direction > 0.0 else entry.stop_min
        equilibrium = edge + direction * push / stops[axis].stiffness
        late = stops[axis].stiffness * OVERSHOOT * home.speed / plant.pwm_frequency  # an integration step of the plant
        hit = late + push + math.sqrt(push**2 + stops[axis].stiffness * entry.inertia * (OVERSHOOT * home.speed) ** 2)
        found.append(
            Contact(
                done=all(result[axis] == "DONE" for result in results),
                spread=max(spread[axis] for spread in spreads),
                repeats=max(abs(zeros[0][axis] - zeros[1][axis]) / COUNT - stick, 0.0),
                place=max(abs(zeros[0][axis] - equilibrium) / COUNT - stick, 0.0),
                current=(currents[axis] - ripple(plant, axis, home.current)) / home.current,
                force=torques[axis] / hit,
            )
        )
    return found


# ---- home switches ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Switch:
    """Result of a homing to a switch."""

    done: bool
    place: float  # position of the reference beyond the edge of the switch [counts]
    spread: float  # spread of the reference [counts]


def to_switches(plant: PlantConfig, seed: int, trial: int) -> list[Switch]:
    """Home both axes to switches at random angles, in every second trial with a start on the switch."""
    rnd = random.Random(f"{NAME} switch {trial} {seed}")
    plant, direction = plant.drawn(seed), (1.0 if trial // 2 % 2 == 0 else -1.0)
    edges: list[float] = []
    for axis, entry in enumerate(plant.axes):
        assert not isinstance(entry.theta_start, str)
        away = rnd.uniform(*AWAY) if trial % 2 == 0 else -rnd.uniform(*START_ON_SWITCH)
        edges.append(entry.theta_start + direction * away)
        closed = sorted((edges[-1], edges[-1] + direction * SWITCH_WIDTH))
        plant = plant.with_axis(axis, pins=replace(entry.pins, home_from=closed[0], home_to=closed[1]))
    with rig.prepared(lambda board: fit(board, "home")), rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            start_homing(board, axis, "SWITCH_POSITIVE" if direction > 0.0 else "SWITCH_NEGATIVE")
        _wait(board, HOMING_TIMEOUT)
        zeros, results, spreads = _zeros(board), _labels(board, "home_result"), _spreads(board)
        return [
            Switch(result == "DONE", direction * (zero - edge) / COUNT, spread)
            for result, zero, edge, spread in zip(results, zeros, edges, spreads, strict=True)
        ]


# ---- missing references ----------------------------------------------------------------------------------------------


def missing(plant: PlantConfig, seed: int) -> Iterator[Row]:
    """Home both axes to missing stops."""
    with rig.spinning(plant, seed) as board:
        home = Settings.of(board)
        starts = [board.truth(axis).theta_m for axis in range(AXES)]
        for axis in range(AXES):
            start_homing(board, axis, "STOP_NEGATIVE")
        _wait(board, 2.0 * math.pi * home.turns_max / home.speed + 1.0)
        board.run(0.2)
        for axis, result in enumerate(_labels(board, "home_result")):
            judge = Judge(f"{axis_name(axis)}, no stop: ")
            turned = abs(board.truth(axis).theta_m - starts[axis]) / (2.0 * math.pi)
            yield judge.true("NOT_FOUND", result == "NOT_FOUND")
            yield judge.true("fault HOMING alone", active(board, axis, "faults") == {"HOMING"})
            yield judge("rotation", turned, "turns", home.turns_max, home.turns_max + 0.1)


@dataclass(frozen=True)
class Unhomed:
    """Axes with the feature HOMING that are not homed, with a far position and a speed as set-points."""

    start: list[int]  # position at the enable [counts]
    stationary: dict[int, Trace]  # after the far position set-point
    turning: dict[int, Trace]  # with the speed set-point
    reach: float  # permitted distance [counts]
    mask: int  # bit of the expected limit


def unhomed(plant: PlantConfig, seed: int) -> Unhomed:
    """Write a far position and then a speed to both axes."""
    with rig.spinning(plant, seed) as board:
        mask, reach = board.catalogue.flag("limits", "NOT_HOMED").mask, Settings.of(board).reach / COUNT
        start = [word(board, axis, "position") for axis in range(AXES)]
        for axis in range(AXES):
            rig.features(board, axis, HOMING=True)
        board.run(0.01)
        for axis in range(AXES):
            write_word(board, "cmd.position", axis, start[axis] + round(FAR / COUNT))
        stationary = rig.record(board, range(AXES), 0.3)
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", SPEED)
        return Unhomed(start, stationary, rig.record(board, range(AXES), 1.0), reach, mask)


# ---- the experiment --------------------------------------------------------------------------------------------------


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """All kinds of stops, a missing stop, and axes that are not homed."""
    places: list[Curve] = []
    for kind in KINDS:
        found = [c for trial in range(TRIALS) for c in contacts(plant, seed, kind, trial)]
        judge = Judge(f"{kind}: ")
        yield judge.none("failed homings", sum(not c.done for c in found))
        yield judge("spread", max(c.spread for c in found), "counts", maximum=SPREAD_MAX)
        yield judge("repeatability", max(c.repeats for c in found), "counts", maximum=PLACE_MAX)
        yield judge("position error", max(c.place for c in found), "counts", maximum=PLACE_MAX)
        yield judge("largest current", max(c.current for c in found), "of the limit", maximum=CURRENT_MAX)
        yield judge("largest force", max(c.force for c in found), "of an ideal spring", 0.3, 1.0)
        places.append(_places(kind, [c.place for c in found], "o"))
    switches = [one for trial in range(TRIALS) for one in to_switches(plant, seed, trial)]
    judge, off = Judge("switch: "), [s.place for s in switches]
    yield judge.none("failed homings", sum(not s.done for s in switches))
    yield judge("spread", max(s.spread for s in switches), "counts", maximum=SWITCH_SPREAD)
    yield judge("smallest distance beyond the edge", min(off), "counts", *BEYOND_EDGE)
    yield judge("largest distance beyond the edge", max(off), "counts", *BEYOND_EDGE)
    places.append(_places("switch", off, "x"))
    yield from missing(plant, seed)
    unreferenced = unhomed(plant, seed)
    curves: list[Curve] = []
    for axis, (stationary, turning) in enumerate(
        zip(unreferenced.stationary.values(), unreferenced.turning.values(), strict=True)
    ):
        judge, direction = Judge(f"{axis_name(axis)}, not homed: "), shaft_counts(turning) - unreferenced.start[axis]
        named = stationary["limits"][-1] & turning["limits"][-1] & unreferenced.mask
        yield judge("motion by a refused far set-point", np.ptp(shaft_counts(stationary)), "counts", maximum=2.0)
        yield judge(
            "rotation by a speed set-point",
            direction.max(),
            "counts",
            0.9 * unreferenced.reach,
            unreferenced.reach + 4.0,
        )
        yield judge.true("limit flag set", bool(named))
        curves.append(Curve(axis_name(axis), turning.time, direction / COUNTS_PER_TURN))
    beyond = "distance from the stop minus friction / stiffness, or from the edge of a switch"
    yield f"{2 * TRIALS} pairs of homings each; position of the reference: {beyond}"
    yield Panel("position of the reference", "homing", "error beyond friction [counts]", places)
    yield Panel("speed set-point, not homed", "time [s]", "position from the enable [turns]", curves)


def _places(label: str, places: list[float], style: str) -> Curve:
    return Curve(label, np.arange(1.0, len(places) + 1.0), np.array(places), style)
