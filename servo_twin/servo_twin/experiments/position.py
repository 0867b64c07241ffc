"""Position moves: shaped steps and ramps without overshoot and without a limit cycle (DRM 2.7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.board import Board
from servo_twin.experiments.dead_time_torque import pushed, whole_counts
from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import move_speeds, path_settles
from servo_twin.experiments.rig import (
    COUNT,
    TICK,
    Recording,
    command_position,
    position_of,
    set_axis,
    spinning,
    stays_from,
    watch,
)
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "position"
HELP: Final = """\
Position set-points of both axes: steps, which the path filter shapes, and ramps, 0.01, 1 and 100 turns far.
The reference design wants no overshoot and no oscillation of the position (2.7.3); it shows no measurement."""

DISTANCES: Final = (0.01, 1.0, 100.0)  # [turns]
MOST_COUNTS: Final = 2.0
SETTLE: Final = 0.5
"""Allowed from the end of the speed-limited ramp until the shaft has arrived [s]: path filter and position loop.

More where a heavy shaft makes the path filter slow."""

RAMP_SPEED: Final = 0.5  # of the speed limit
RAMP_LEAST: Final = 0.2  # [s]
REST: Final = 1.0  # recorded after the shaft should have arrived [s]

SEED_OVERSHOOT: Final = "2.7.3: position must not overshoot"
SEED_CYCLE: Final = "2.7.3: position must not oscillate"
SEED_NONE: Final = "no figure given"


@dataclass(frozen=True)
class Move:
    """What one move gave; counts unless it says otherwise.

    Attributes
    ----------
    overshoot : float
        Farthest beyond the target.
    cycle : float
        From the lowest to the highest position after arrival, over the last half second.
    error : float
        Mean distance from the target over that time.
    settling : float or None
        From the end of the set-point's ramp until the shaft stays within 2 counts, and what it swerves [s].
    recording : Recording
        All of it.
    swerve, swing : float
        What current that the inverter keeps back moves the shaft once the set-point has arrived: from where it would
        be, and over the last half second from the lowest to the highest.
    """

    overshoot: float
    cycle: float
    error: float
    settling: float | None
    recording: Recording
    swerve: float = 0.0
    swing: float = 0.0


def measure(recording: Recording, target: int, ramp_end: float, shaft: AxisPlant) -> Move:
    """Judge a move of a shaft that began with the recording; `target` in counts, `ramp_end` in seconds."""
    position = recording.position
    last = recording.part(recording.time[-1] - REST / 2.0).position
    near = np.abs(recording.position_ref - target) <= MOST_COUNTS
    after = float(recording.time[int(np.argmax(near))]) if near.any() else float(recording.time[-1])
    swerve = whole_counts(recording, shaft, after)
    swing = pushed(recording, shaft, position=True)[-last.size :]
    window = MOST_COUNTS + swerve
    direction = 1.0 if target >= position[0] else -1.0
    arrived = stays_from(recording, position, target - window, target + window)
    return Move(
        overshoot=max(float((direction * (position - target)).max()), 0.0) + 0.0,
        cycle=float(np.ptp(last)),
        error=float(np.abs(last - target).mean()),
        settling=None if arrived is None else max(arrived - ramp_end, 0.0),
        recording=recording,
        swerve=swerve,
        swing=float(round(np.ptp(swing))),
    )


def travel(board: Board, axis: int, turns: float, ramp: bool, settle: float = SETTLE) -> Move:
    """Move one axis by some turns from where it is; it may take `settle` to arrive [s]."""
    limits = board.read("param.speed_limit")
    assert isinstance(limits, list)
    most = limits[axis]
    start = position_of(board, axis)
    target = start + round(turns * COUNTS_PER_TURN)
    distance = abs(target - start) * COUNT
    duration = max(distance / (RAMP_SPEED * most), RAMP_LEAST) if ramp else distance / most

    def act(k: int) -> None:
        if ramp and k * TICK <= duration + TICK:
            command_position(board, axis, round(start + (target - start) * min(k * TICK / duration, 1.0)))
        elif not ramp and k == 0:
            command_position(board, axis, target)

    shaft = board.plant.axes[axis]
    return measure(watch(board, [axis], duration + settle + REST, act)[axis], target, duration, shaft)


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Every distance as step and as ramp, there and back, each axis by itself."""
    rows: list[Row] = []
    panels: list[Panel] = []
    speeds, lowered = move_speeds(plant, seed, together=False)
    settles = path_settles(plant, seed, SETTLE)
    with spinning(plant, seed) as board:
        for axis, speed in enumerate(speeds):
            set_axis(board, "param.speed_limit", axis, speed)
        for distance in DISTANCES:
            for ramp in (False, True):
                how = f"{'ramp' if ramp else 'step'} of {distance:g} turns"
                way = -distance if ramp else distance
                moves = [travel(board, axis, way, ramp, settle) for axis, settle in enumerate(settles)]
                for axis, (move, settle) in enumerate(zip(moves, settles, strict=True)):
                    rows.extend(_rows(f"{axis_name(axis)} {how}", move, settle))
                if not ramp:
                    panels.extend(_panels(how, moves))
    notes = ["settling: after the end of the speed-limited set-point", *([lowered] if lowered else [])]
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(what: str, move: Move, settle: float) -> tuple[Row, ...]:
    within, calm = Bound(most=MOST_COUNTS + move.swerve), Bound(most=MOST_COUNTS + move.swing)
    return (
        Row(f"{what}, overshoot", SEED_OVERSHOOT, move.overshoot, "counts", within),
        Row(f"{what}, limit cycle", SEED_CYCLE, move.cycle, "counts", calm),
        Row(f"{what}, steady-state error", SEED_NONE, move.error, "counts", within),
        Row(f"{what}, settling", SEED_NONE, move.settling, "s", Bound(most=settle)),
    )


def _panels(how: str, moves: list[Move]) -> tuple[Panel, Panel]:
    whole: list[Curve] = []
    error: list[Curve] = []
    for axis, move in enumerate(moves):
        r, colour = move.recording, f"C{axis}"
        turns = (r.position - r.position[0]) / COUNTS_PER_TURN
        shaped = (r.position_ref - r.position[0]) / COUNTS_PER_TURN
        whole.append(Curve(axis_name(axis), r.time, turns, colour))
        whole.append(Curve(f"{axis_name(axis)} set-point", r.time, shaped, f"{colour}--"))
        error.append(Curve(axis_name(axis), r.time, r.position_ref - r.position))
    return (
        Panel(how, "time [s]", "position [turns]", tuple(whole)),
        Panel(f"{how}: shaped set-point - position", "time [s]", "difference [counts]", tuple(error)),
    )
