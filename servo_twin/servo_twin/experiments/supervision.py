"""Following-error and over-speed faults: how soon the outputs are off, and that no legal move is taken for a fault."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.board import Board
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import current_limits, move_speeds
from servo_twin.experiments.rig import (
    TICK,
    Recording,
    choose_mode,
    command_position,
    command_speed,
    features,
    flag_mask,
    position_of,
    set_axis,
    spinning,
    watch,
)
from servo_twin.plant import PlantConfig

NAME: Final = "supervision"
HELP: Final = """\
Beyond the reference design, which knows no fault of the motion: the shaft leaves its set-point (feature
FOLLOWING_ERROR, param.following_error) or turns too fast (OVER_SPEED, param.over_speed).
Shown, without and with each: the shaft is blocked in a move; a load of 1.25 times the peak torque stops a move and
carries the shaft away; such a load drives the shaft of an axis in torque mode; a set-point asks for more speed than the
machine may see. Time from the cause to outputs off, and the name of the fault. Then the hardest moves that are legal,
and load steps of half the peak torque, must pass without a fault."""

FOLLOWING: Final = 1.0
"""Following error that is a fault [rad]."""

LOAD: Final = 1.25  # of the torque at the current limit
LEGAL_LOAD: Final = 0.5
CAUSE: Final = 0.3  # [s]
WATCHED: Final = 1.0  # after the cause [s]
FOLLOWING_LASTS: Final = 0.01  # a following error, until it is a fault [s]
OVER_SPEED_LASTS: Final = 0.002  # [s]
ANSWER: Final = 4.0 * TICK
"""For measuring, computing and switching off [s]."""

TURNS_SPEED: Final = 0.5  # of the speed limit, in speed and torque mode
OVER_SPEED: Final = 1.2  # of the speed that is asked for, or allowed in torque mode
ASKED: Final = 1.5  # too much, of the same
ACCELERATION: Final = 1000.0  # [rad/s^2]

SOONER_MOST: Final = 0.8
"""Part of the time that it takes without, if the outputs go off then at all."""

SHARE: Final = 0.55
"""Of the current limit, for accelerating: a move that is turned round on its way needs twice of it."""

HARD_MOVES: Final = (5.0, -5.0, 100.0)  # [turns], there and back without a rest
TURN_ROUND: Final = 0.12  # until the second set-point overrides the first [s]
REST: Final = 0.6  # [s]

SWITCHES: Final = ("FOLLOWING_ERROR", "OVER_SPEED")


@dataclass(frozen=True)
class Accident:
    """What followed a cause on one axis.

    Attributes
    ----------
    time : float or None
        From the cause until the outputs were off [s].
    fault : int
        Faults at that moment.
    turned : float
        Way of the shaft from the cause until then, or until the end [turns].
    recording : Recording
        All of it.
    """

    time: float | None
    fault: int
    turned: float
    recording: Recording


def accident(recording: Recording, cause: float, run: int) -> Accident:
    """Judge a recording; `cause` in seconds, `run` the main state in which the outputs are on."""
    off = (recording.state != run) & (recording.time > cause)
    first = int(np.argmax(off)) if off.any() else recording.time.size - 1
    begin = int(np.argmax(recording.time >= cause))
    return Accident(
        time=float(recording.time[first] - cause) if off.any() else None,
        fault=int(recording.faults[first]),
        turned=float(np.ptp(recording.theta[begin : first + 1])) / (2.0 * math.pi),
        recording=recording,
    )


@dataclass(frozen=True)
class Bench:
    """A plant and what it can be asked for.

    Attributes
    ----------
    plant, seed
        As everywhere.
    speeds : list of float
        Limits for moves that the plant can follow, by axis [rad/s].
    peaks : list of float
        Torque of each axis at its current limit [N m].
    """

    plant: PlantConfig
    seed: int
    speeds: list[float]
    peaks: list[float]

    @classmethod
    def of(cls, plant: PlantConfig, seed: int) -> Bench:
        speeds, _ = move_speeds(plant, seed, together=True, share=SHARE)
        currents = current_limits(plant, seed)
        return cls(
            plant,
            seed,
            speeds,
            [axis.torque_constant * current for axis, current in zip(plant.axes, currents, strict=True)],
        )


Prepare = Callable[[Board], None]
Act = Callable[[Board, int], None]


def play(bench: Bench, on: bool, prepare: Prepare, act: Act, seconds: float) -> tuple[dict[int, Recording], int]:
    """Run both axes with the features on or off; returns the recordings and the number of the state RUN."""
    with spinning(bench.plant, bench.seed) as board:
        for axis in range(AXES):
            features(board, axis, **dict.fromkeys(SWITCHES, on))
            set_axis(board, "param.following_error", axis, FOLLOWING)
            set_axis(board, "param.speed_limit", axis, bench.speeds[axis])
        prepare(board)
        both = watch(board, range(AXES), seconds, lambda k: act(board, k), may_fail=True)
        return both, board.catalogue.enums["state_t"]["RUN"]


def _far(board: Board) -> None:
    for axis in range(AXES):
        command_position(board, axis, position_of(board, axis) + 1000 * COUNTS_PER_TURN)


def _moderate(bench: Bench, mode: str) -> Prepare:
    """Half the speed, in speed or torque mode, and what is too fast."""

    def prepare(board: Board) -> None:
        for axis in range(AXES):
            speed = TURNS_SPEED * bench.speeds[axis]
            set_axis(board, "param.acceleration_limit", axis, ACCELERATION)
            set_axis(board, "param.over_speed", axis, OVER_SPEED * speed)
            choose_mode(board, axis, mode)
            if mode == "SPEED":
                command_speed(board, axis, speed)
            else:
                set_axis(board, "param.speed_limit", axis, speed)
                set_axis(board, "cmd.i_q", axis, 0.25 * bench.peaks[axis] / bench.plant.axes[axis].torque_constant)

    return prepare


def _at_cause(cause: Callable[[Board, int], None]) -> Act:
    """Do something to both axes at the time of the cause."""

    def act(board: Board, k: int) -> None:
        if k == round(CAUSE / TICK):
            for axis in range(AXES):
                cause(board, axis)

    return act


def blocked(bench: Bench, on: bool) -> list[Accident]:
    """The shaft is held fast in a move."""
    both, run = play(bench, on, _far, _at_cause(lambda board, axis: board.lock_shaft(axis)), CAUSE + WATCHED)
    return [accident(recording, CAUSE, run) for recording in both.values()]


def overloaded(bench: Bench, on: bool) -> list[Accident]:
    """A load that the drive cannot hold, against a move."""

    def cause(board: Board, axis: int) -> None:
        board.set_load(axis, LOAD * bench.peaks[axis])

    both, run = play(bench, on, _far, _at_cause(cause), CAUSE + WATCHED)
    return [accident(recording, CAUSE, run) for recording in both.values()]


def driven(bench: Bench, on: bool) -> list[Accident]:
    """A load that the drive cannot hold drives a shaft in torque mode; the cause is the passing of the limit."""

    def cause(board: Board, axis: int) -> None:
        board.set_load(axis, -LOAD * bench.peaks[axis])

    both, run = play(bench, on, _moderate(bench, "TORQUE"), _at_cause(cause), CAUSE + WATCHED)
    return [accident(r, _passes(r, _too_fast(bench, axis)), run) for axis, r in both.items()]


def overdone(bench: Bench, on: bool) -> list[Accident]:
    """A set-point asks for more speed than the machine may see."""

    def cause(board: Board, axis: int) -> None:
        command_speed(board, axis, ASKED * TURNS_SPEED * bench.speeds[axis])

    both, run = play(bench, on, _moderate(bench, "SPEED"), _at_cause(cause), CAUSE + WATCHED)
    return [accident(r, _passes(r, _too_fast(bench, axis)), run) for axis, r in both.items()]


def _too_fast(bench: Bench, axis: int) -> float:
    return OVER_SPEED * TURNS_SPEED * bench.speeds[axis]


def _passes(recording: Recording, speed: float) -> float:
    """Time at which the true speed passes a limit [s]; the end if it does not."""
    beyond = np.abs(recording.omega) > speed
    return float(recording.time[int(np.argmax(beyond))] if beyond.any() else recording.time[-1])


def legal(bench: Bench, forward: bool) -> int:
    """Both features on: the hardest moves, there and back, and load steps at rest; every fault that there was."""
    faults = 0
    turns = list(HARD_MOVES)

    def begin(board: Board) -> None:
        for axis in range(AXES):
            features(board, axis, SPEED_FORWARD=forward, ACCELERATION_FORWARD=forward, FRICTION=forward)

    def move(board: Board, k: int) -> None:
        if k % round(TURN_ROUND / TICK) == 0 and turns:
            far = turns.pop(0)
            for axis in range(AXES):
                command_position(board, axis, position_of(board, axis) + round(far * COUNTS_PER_TURN))

    def load(board: Board, k: int) -> None:
        share = {round(REST / TICK): LEGAL_LOAD, round(2.0 * REST / TICK): -LEGAL_LOAD, round(3.0 * REST / TICK): 0.0}
        if k in share:
            for axis in range(AXES):
                board.set_load(axis, share[k] * bench.peaks[axis])

    way = sum(map(abs, HARD_MOVES)) * 2.0 * math.pi
    for act, seconds in ((move, way / min(bench.speeds) + REST), (load, 4.0 * REST)):
        both, _ = play(bench, True, begin, act, seconds)
        faults |= int(np.bitwise_or.reduce([np.bitwise_or.reduce(r.faults) for r in both.values()]))
    return faults


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Every cause without and with, then what must not be taken for one."""
    bench = Bench.of(plant, seed)
    with spinning(plant, seed) as board:
        masks = {name: flag_mask(board, "faults", name) for name in SWITCHES}
        names = {flag.mask: flag.name for flag in board.catalogue.flags["faults"]}
    rows: list[Row] = []
    notes: list[str] = [f"following error {FOLLOWING:g} rad; moves at {min(bench.speeds):.3g} rad/s"]
    panels: list[Panel] = []
    for what, cause, name, bounds in (
        ("shaft blocked in a move", blocked, "FOLLOWING_ERROR", [blocked_most(bench, a) for a in range(AXES)]),
        (
            "too large a load in a move",
            overloaded,
            "FOLLOWING_ERROR",
            [overloaded_most(bench, a) for a in range(AXES)],
        ),
        ("driven by a load", driven, "OVER_SPEED", [OVER_SPEED_LASTS + ANSWER] * AXES),
        ("set-point too fast", overdone, "OVER_SPEED", [OVER_SPEED_LASTS + ANSWER] * AXES),
    ):
        without, supervised = cause(bench, False), cause(bench, True)
        for axis in range(AXES):
            pair = without[axis], supervised[axis]
            rows.extend(_rows(f"{axis_name(axis)}, {what}", pair[0], pair[1], masks[name], bounds[axis]))
            notes.append(f"{axis_name(axis)}, {what}: without {_story(pair[0], names)}; with {_story(pair[1], names)}")
        panels.append(_panel(what, without, supervised))
    for how, forward in (("", False), (", with feed-forward", True)):
        wrong = float(legal(bench, forward))
        rows.append(Row(f"hard moves and load steps{how}: faults", BEYOND, wrong, "", Bound(0.0, 0.0)))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def blocked_most(bench: Bench, axis: int) -> float:
    """The set-point goes on at the speed limit while the shaft stands [s]."""
    return FOLLOWING / bench.speeds[axis] + FOLLOWING_LASTS + ANSWER


def overloaded_most(bench: Bench, axis: int) -> float:
    """Braked by at least what the load has more than the drive, the shaft falls behind a set-point that goes on [s]."""
    braking = (LOAD - 1.0) * bench.peaks[axis] / bench.plant.axes[axis].inertia
    return math.sqrt(2.0 * FOLLOWING / braking) + FOLLOWING_LASTS + ANSWER


def _rows(what: str, without: Accident, supervised: Accident, mask: int, most: float) -> tuple[Row, ...]:
    named = float(supervised.fault == mask)
    sooner = math.inf if without.time is None else without.time
    gained = None if supervised.time is None else supervised.time / sooner
    return (
        Row(f"{what}: outputs off after", BEYOND, supervised.time, "s", Bound(0.0, most)),
        Row(f"{what}: the fault's name is right", BEYOND, named, "", Bound(1.0, 1.0)),
        Row(f"{what}: time with over without", BEYOND, gained, "", Bound(most=SOONER_MOST)),
    )


def _story(event: Accident, names: Mapping[int, str]) -> str:
    if event.time is None:
        return f"no fault, {event.turned:.3g} turns"
    faults = " and ".join(name for mask, name in names.items() if event.fault & mask)
    return f"{faults} after {1e3 * event.time:.3g} ms, {event.turned:.3g} turns"


def _panel(title: str, without: list[Accident], supervised: list[Accident]) -> Panel:
    curves: list[Curve] = []
    for axis in range(AXES):
        for label, event in (("without", without[axis]), ("with", supervised[axis])):
            shown = _until_off(event)
            curves.append(
                Curve(f"{axis_name(axis)} {label}", event.recording.time[shown], event.recording.omega[shown])
            )
    return Panel(f"{title}: until the outputs are off", "time [s]", "speed [rad/s]", tuple(curves))


def _until_off(event: Accident) -> NDArray[np.bool_]:
    r = event.recording
    end = r.time[-1] if not r.faults.any() else r.time[int(np.argmax(r.faults != 0))]
    return np.asarray((r.time > CAUSE - 0.05) & (r.time <= end))
