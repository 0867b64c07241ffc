"""Homing to hard stops, from rubber to steel, and to switches at random places; no stop; an axis that is not homed."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.board import Board
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.pins import fit
from servo_twin.experiments.plant_limits import ripple
from servo_twin.experiments.rig import (
    COUNT,
    TICK_NS,
    choose_mode,
    command_position,
    command_speed,
    features,
    flag_mask,
    position_of,
    prepared,
    set_axis,
    spinning,
    watch,
)
from servo_twin.lockstep.replica import Replica
from servo_twin.plant import STIFFEST, PlantConfig

NAME: Final = "homing"
HELP: Final = """\
Beyond the reference design, whose position counts from where the rotor was first found (E41).
Shown: both axes turn to hard stops at random places to both sides, of random stiffness and damping, twice each:
spread, repeatability and place against the true angle of the stop, current and force of the contact. The same with home
switches, from outside and from on the switch. A stop that is missing is a named fault within the configured way. With
the feature HOMING an axis that is not homed refuses far set-points and stays near where it was enabled."""

KINDS: Final[Mapping[str, tuple[float, float]]] = {"rubber": (0.3, 3.0), "plastic": (3.0, 30.0), "steel": (30.0, 150.0)}
"""Stiffness of a stop [N m/rad]."""

TRIALS: Final = 4
DAMPING: Final = (0.05, 0.7)  # of the shaft on the stop
AWAY: Final = (0.3, 9.0)  # from where the shaft is at the start [rad]
ELSEWHERE: Final = 1.0  # from the stop, before the second homing [rad]
LONGEST: Final = 12.0  # of a homing [s]
NEAR: Final = 0.05  # where the contact is looked at closely [rad]
CLOSELY: Final = TICK_NS // 8
FAR: Final = 20.0  # [rad]
SPEED: Final = 60.0  # [rad/s]

SPREAD_MOST: Final = 3.0
"""Of three contacts, which differ in where friction lets the shaft come to rest [counts]."""

PLACE_MOST: Final = 2.0
"""Beyond what friction may hold back: a count at each end [counts]."""

ON_SWITCH: Final = (0.1, 0.6)  # beyond the edge, where a homing may begin [rad]
WIDE: Final = 30.0  # a switch is closed so far beyond its edge [rad]
BEYOND_EDGE: Final = (-1.0, 6.0)
"""Where the edge of a switch is found [counts]: a count of the encoder, and three slow ticks (one until it is read,
two of the filter) at the speed of the first approach. The others are slower in the mean, but not at every instant."""

SWITCH_SPREAD: Final = BEYOND_EDGE[1] - 1.0
"""Of three edges, which differ in the speed at each [counts]."""

CURRENT_MOST: Final = 1.25
"""Of the limit, the true current, the largest of some ten thousand instants: dead time and noise."""

OVERSHOOT: Final = 1.2
"""Speed at the contact over that of the configuration, by the ripple of the M/T method at so low a speed; and, squared,
what a lag of half a tick adds to the force."""


@dataclass(frozen=True)
class Settings:
    """What the board is configured with: speed [rad/s], current [A], reach [rad], turns."""

    speed: float
    current: float
    reach: float
    turns_max: float

    @classmethod
    def of(cls, board: Board) -> Settings:
        """Those of axis 1, which are those of both."""
        block, members = read_block(Replica(board), 0), AxisConfigTable.load().members
        return cls(*(block[f"home.{name}"] * members[f"home.{name}"].lsb for name in cls.__dataclass_fields__))


@dataclass(frozen=True)
class Stop:
    """A pair of end stops: distance from the start [rad], stiffness [N m/rad], damping [N m s]."""

    away: float
    stiffness: float
    damping: float


@dataclass(frozen=True)
class Contact:
    """What two homings of an axis to the same stop have shown.

    Attributes
    ----------
    done : bool
        Both have succeeded.
    spread : float
        Larger one of both [counts].
    repeats, place : float
        Distance of the two references, and of the first from where the current holds the shaft against the stop, beyond
        what friction may hold back [counts].
    current : float
        Largest true current over the limit, without the ripple.
    force : float
        Largest torque of the stop over what the current and the moving shaft can do to an ideal spring.
    """

    done: bool
    spread: float
    repeats: float
    place: float
    current: float
    force: float


def stops_of(plant: PlantConfig, seed: int, kind: str, trial: int) -> tuple[PlantConfig, list[Stop]]:
    """The plant with random stops on both axes."""
    rnd = random.Random(f"{NAME} {kind} {trial} {seed}")
    plant = plant.drawn(seed)
    low, high = (math.log(k) for k in KINDS[kind])
    stops: list[Stop] = []
    for axis, entry in enumerate(plant.axes):
        assert not isinstance(entry.theta_start, str)
        stiffness = min(math.exp(rnd.uniform(low, high)), STIFFEST * entry.inertia * plant.pwm_frequency**2)
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


def ask(board: Board, axis: int, method: str, position: float = 0.0) -> None:
    """Write ``cmd.home`` with the position of the reference [rad]."""
    set_axis(board, "cmd.home_position", axis, position)
    set_axis(board, "cmd.home", axis, board.catalogue.enums["home_method_t"][method])


def label(board: Board, axis: int, what: str) -> str:
    """``home_state`` or ``home_result`` of an axis in words."""
    return board.catalogue.label(f"{what}_t", board.read_raw(f"{axis_name(axis)}.{what}")[0])


@dataclass
class _Worst:
    """Of an axis during a homing: current [A], torque of the stop [N m]."""

    current: float = 0.0
    torque: float = 0.0


def _home(board: Board, method: str, stops: list[Stop]) -> list[_Worst]:
    """Home both axes; looks closely while a shaft hits its stop."""
    for axis in range(AXES):
        ask(board, axis, method)
    worst = [_Worst() for _ in range(AXES)]
    end = board.time_ns + round(LONGEST * 1e9)
    begun = False
    while board.time_ns < end:
        truths = [board.truth(axis) for axis in range(AXES)]
        close = False
        for axis, truth in enumerate(truths):
            entry = board.plant.axes[axis]
            deep = max(truth.theta_m - entry.stop_max, entry.stop_min - truth.theta_m)
            pushed = max(deep, 0.0) * stops[axis].stiffness
            worst[axis].torque = max(worst[axis].torque, pushed)
            worst[axis].current = max(worst[axis].current, abs(truth.i_q))
            close = close or (deep > -NEAR and abs(truth.omega_m) > 0.1)
        board.advance(board.time_ns + (CLOSELY if close else TICK_NS))
        states = [label(board, axis, "home_state") for axis in range(AXES)]
        begun = begun or "HOMING" in states
        if begun and "HOMING" not in states:
            break
    board.run(0.1)
    return worst


def _zeros(board: Board) -> list[float]:
    """True angle at which the position would be 0 [rad]."""
    return [board.truth(axis).theta_m - position_of(board, axis) * COUNT for axis in range(AXES)]


def contacts(plant: PlantConfig, seed: int, kind: str, trial: int) -> list[Contact]:
    """Home both axes twice to the same stops, from different places."""
    plant, stops = stops_of(plant, seed, kind, trial)
    way = 1.0 if trial % 2 == 0 else -1.0
    method = "STOP_POSITIVE" if way > 0.0 else "STOP_NEGATIVE"
    with spinning(plant, seed) as board:
        home = Settings.of(board)
        first = _home(board, method, stops)
        zeros = [_zeros(board)]
        results = [[label(board, axis, "home_result") for axis in range(AXES)]]
        spreads = [[float(board.read_raw(f"{axis_name(axis)}.home_spread")[0]) for axis in range(AXES)]]
        for axis in range(AXES):
            if label(board, axis, "home_state") == "KNOWN":
                command_position(board, axis, round(-way * min(ELSEWHERE, stops[axis].away) / COUNT))
        board.run(1.0)
        _home(board, method, stops)
        zeros.append(_zeros(board))
        results.append([label(board, axis, "home_result") for axis in range(AXES)])
        spreads.append([float(board.read_raw(f"{axis_name(axis)}.home_spread")[0]) for axis in range(AXES)])
    found: list[Contact] = []
    for axis, entry in enumerate(plant.axes):
        push = home.current * entry.torque_constant
        stick = entry.friction / stops[axis].stiffness / COUNT
        edge = entry.stop_max if way > 0.0 else entry.stop_min
        rest = edge + way * push / stops[axis].stiffness
        late = stops[axis].stiffness * OVERSHOOT * home.speed / plant.pwm_frequency  # a step of the plant
        hit = late + push + math.sqrt(push**2 + stops[axis].stiffness * entry.inertia * (OVERSHOOT * home.speed) ** 2)
        found.append(
            Contact(
                done=all(result[axis] == "DONE" for result in results),
                spread=max(spread[axis] for spread in spreads),
                repeats=max(abs(zeros[0][axis] - zeros[1][axis]) / COUNT - stick, 0.0),
                place=max(abs(zeros[0][axis] - rest) / COUNT - stick, 0.0),
                current=(first[axis].current - ripple(plant, axis, home.current)) / home.current,
                force=first[axis].torque / hit,
            )
        )
    return found


# ---- home switches ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Switch:
    """A homing to a switch: success, place of the reference beyond the switch's edge and spread [counts]."""

    done: bool
    place: float
    spread: float


def to_switches(plant: PlantConfig, seed: int, trial: int) -> list[Switch]:
    """Home both axes to switches that are closed from a random angle on, in every second trial from on the switch."""
    rnd = random.Random(f"{NAME} switch {trial} {seed}")
    plant, way = plant.drawn(seed), (1.0 if trial // 2 % 2 == 0 else -1.0)
    edges: list[float] = []
    for axis, entry in enumerate(plant.axes):
        assert not isinstance(entry.theta_start, str)
        away = rnd.uniform(*AWAY) if trial % 2 == 0 else -rnd.uniform(*ON_SWITCH)
        edges.append(entry.theta_start + way * away)
        closed = sorted((edges[-1], edges[-1] + way * WIDE))
        plant = plant.with_axis(axis, pins=replace(entry.pins, home_from=closed[0], home_to=closed[1]))
    with prepared(lambda board: fit(board, "home")), spinning(plant, seed) as board:
        for axis in range(AXES):
            ask(board, axis, "SWITCH_POSITIVE" if way > 0.0 else "SWITCH_NEGATIVE")
        board.run(0.01)
        end = board.time_ns + round(LONGEST * 1e9)
        while board.time_ns < end and any(label(board, axis, "home_state") == "HOMING" for axis in range(AXES)):
            board.write("cmd.enable", [1.0] * AXES)  # the host is there
            board.run(0.1)
        zeros = _zeros(board)
        return [
            Switch(
                label(board, axis, "home_result") == "DONE",
                way * (zeros[axis] - edges[axis]) / COUNT,
                float(board.read_raw(f"{axis_name(axis)}.home_spread")[0]),
            )
            for axis in range(AXES)
        ]


# ---- what cannot be found --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Missing:
    """A homing without a stop: result, whether the fault has its name, how far the shaft turned, and may [turns]."""

    result: str
    named: bool
    turned: float
    most: float


def missing(plant: PlantConfig, seed: int) -> list[Missing]:
    """Send both axes to stops that are not there."""
    with spinning(plant, seed) as board:
        mask, home = flag_mask(board, "faults", "HOMING"), Settings.of(board)
        starts = [board.truth(axis).theta_m for axis in range(AXES)]
        for axis in range(AXES):
            ask(board, axis, "STOP_NEGATIVE")
        board.run(0.01)
        longest = 2.0 * math.pi * home.turns_max / home.speed + 1.0
        end = board.time_ns + round(longest * 1e9)
        while board.time_ns < end and any(label(board, axis, "home_state") == "HOMING" for axis in range(AXES)):
            board.write("cmd.enable", [1.0] * AXES)  # the host is there
            board.run(0.1)
        board.run(0.2)
        return [
            Missing(
                label(board, axis, "home_result"),
                board.read_raw(f"{axis_name(axis)}.faults")[0] == mask,
                abs(board.truth(axis).theta_m - starts[axis]) / (2.0 * math.pi),
                home.turns_max,
            )
            for axis in range(AXES)
        ]


@dataclass(frozen=True)
class Unhomed:
    """An axis with the feature that is not homed.

    Attributes
    ----------
    refused, turned, reach : float
        Way after a far set-point and with a speed, and how far it may turn [counts].
    named : bool
        The limit has named itself.
    """

    refused: float
    turned: float
    reach: float
    named: bool


def unhomed(plant: PlantConfig, seed: int) -> tuple[list[Unhomed], Panel]:
    """Send both axes away, by a far position and by a speed."""
    with spinning(plant, seed) as board:
        mask, home = flag_mask(board, "limits", "NOT_HOMED"), Settings.of(board)
        here = [position_of(board, axis) for axis in range(AXES)]
        for axis in range(AXES):
            features(board, axis, HOMING=True)
        board.run(0.01)
        for axis in range(AXES):
            command_position(board, axis, here[axis] + round(FAR / COUNT))
        still = watch(board, range(AXES), 0.3)
        for axis in range(AXES):
            choose_mode(board, axis, "SPEED")
            command_speed(board, axis, SPEED)
        turning = watch(board, range(AXES), 1.0)
    found = [
        Unhomed(
            float(np.ptp(still[axis].shaft)),
            float((turning[axis].shaft - here[axis]).max()),
            home.reach / COUNT,
            bool((still[axis].limits[-1] & mask) and (turning[axis].limits[-1] & mask)),
        )
        for axis in range(AXES)
    ]
    curves = [
        Curve(axis_name(axis), turning[axis].time, (turning[axis].shaft - here[axis]) / COUNTS_PER_TURN)
        for axis in range(AXES)
    ]
    return found, Panel("speed set-point, not homed", "time [s]", "from where it was enabled [turns]", tuple(curves))


def run(plant: PlantConfig, seed: int) -> Outcome:
    """All kinds of stops, none, and an axis that is not homed."""
    rows: list[Row] = []
    curves: list[Curve] = []
    for kind in KINDS:
        found = [c for trial in range(TRIALS) for c in contacts(plant, seed, kind, trial)]
        rows.extend(_rows_kind(kind, found))
        numbers = np.arange(1.0, len(found) + 1.0)
        curves.append(Curve(kind, numbers, np.array([c.place for c in found]), "o"))
    switches = [one for trial in range(TRIALS) for one in to_switches(plant, seed, trial)]
    rows.extend(_rows_switch(switches))
    curves.append(Curve("switch", np.arange(1.0, len(switches) + 1.0), np.array([s.place for s in switches]), "x"))
    for axis, lost in enumerate(missing(plant, seed)):
        what = f"{axis_name(axis)}, no stop"
        named = Bound(1.0, 1.0)
        rows.append(Row(f"{what}: NOT_FOUND", BEYOND, float(lost.result == "NOT_FOUND"), "", named))
        rows.append(Row(f"{what}: fault HOMING alone", BEYOND, float(lost.named), "", named))
        rows.append(Row(f"{what}: turned", BEYOND, lost.turned, "turns", Bound(lost.most, lost.most + 0.1)))
    axes, panel = unhomed(plant, seed)
    for axis, it in enumerate(axes):
        what = f"{axis_name(axis)}, not homed"
        rows.append(Row(f"{what}: moves for a far set-point", BEYOND, it.refused, "counts", Bound(most=2.0)))
        rows.append(
            Row(f"{what}: turns by a speed", BEYOND, it.turned, "counts", Bound(0.9 * it.reach, it.reach + 4.0))
        )
        rows.append(Row(f"{what}: names itself", BEYOND, float(it.named), "", Bound(1.0, 1.0)))
    beyond = "beyond what friction over stiffness may hold back, or beyond the edge of a switch"
    notes = (f"{2 * TRIALS} pairs of homings each; places: {beyond}",)
    places = Panel("place of the reference", "homing", "off, beyond friction [counts]", tuple(curves))
    return Outcome(NAME, tuple(rows), (places, panel), notes)


def _rows_switch(found: list[Switch]) -> list[Row]:
    failed = float(sum(not s.done for s in found))
    places = [s.place for s in found]
    return [
        Row("switch: homings that fail", BEYOND, failed, "", Bound(0.0, 0.0)),
        Row("switch: spread", BEYOND, max(s.spread for s in found), "counts", Bound(most=SWITCH_SPREAD)),
        Row("switch: earliest beyond its edge", BEYOND, min(places), "counts", Bound(*BEYOND_EDGE)),
        Row("switch: latest beyond its edge", BEYOND, max(places), "counts", Bound(*BEYOND_EDGE)),
    ]


def _rows_kind(kind: str, found: list[Contact]) -> list[Row]:
    failed = float(sum(not c.done for c in found))
    return [
        Row(f"{kind}: homings that fail", BEYOND, failed, "", Bound(0.0, 0.0)),
        Row(f"{kind}: spread", BEYOND, max(c.spread for c in found), "counts", Bound(most=SPREAD_MOST)),
        Row(f"{kind}: repeats within", BEYOND, max(c.repeats for c in found), "counts", Bound(most=PLACE_MOST)),
        Row(f"{kind}: place", BEYOND, max(c.place for c in found), "counts", Bound(most=PLACE_MOST)),
        Row(
            f"{kind}: largest current", BEYOND, max(c.current for c in found), "of the limit", Bound(most=CURRENT_MOST)
        ),
        Row(f"{kind}: largest force", BEYOND, max(c.force for c in found), "of an ideal spring", Bound(0.3, 1.0)),
    ]
