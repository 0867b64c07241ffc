"""Position moves: shaped steps and ramps without overshoot and without a limit cycle (DRM 2.7)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_measurement.step_response import overshoot
from servo_msgs_py.board_port import read_axis, word, write_axis, write_word
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.dead_time_torque import displacement, displacement_at
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import move_speeds, path_settles
from servo_twin.validation.experiments.rig import COUNT

NAME: Final = "position"
HELP: Final = """\
Position set-points of both axes: steps, which the path filter shapes, and ramps, of 0.01, 1 and 100 turns. The
reference design requires no overshoot and no oscillation of the position (2.7.3); it shows no measurement."""

DISTANCES: Final = (0.01, 1.0, 100.0)  # [turns]
COUNTS_MAX: Final = 2.0
SETTLE: Final = 0.5
"""Permitted settling time after the end of the speed-limited ramp [s]: path filter and position loop.

Longer for a large inertia, because the path filter is slower."""

RAMP_SPEED: Final = 0.5  # relative to the speed limit
RAMP_MIN: Final = 0.2  # [s]
REST: Final = 1.0  # recorded after the permitted settling time [s]

REFERENCE_OVERSHOOT: Final = "2.7.3: position must not overshoot"
REFERENCE_CYCLE: Final = "2.7.3: position must not oscillate"
REFERENCE_NONE: Final = "no figure given"


@dataclass(frozen=True)
class Move:
    """Result of one move [counts], except where noted."""

    recording: Trace
    overshoot: float  # largest distance beyond the target
    cycle: float  # peak to peak of the position after arrival, over the last half second
    error: float  # mean distance from the target over the last half second
    settling: float | None
    """From the end of the ramp until the shaft stays within 2 counts plus the displacement by the inverter [s]."""
    displacement: float
    """Largest displacement by the inverter after the end of the set-point."""
    displacement_range: float  # peak to peak of this displacement over the last half second


def measure(recording: Trace, target: int, ramp_end: float, plant: PlantConfig, axis: int) -> Move:
    """Evaluate a move that starts with the recording; `target` in counts, `ramp_end` in seconds."""
    last = recording.part(recording.time[-1] - REST / 2.0)["position"]
    inverter_displacement = displacement_at(recording, plant, axis, target, COUNTS_MAX)
    displacement_range = displacement(recording, plant, axis, position=True)[-last.size :]
    return Move(
        recording,
        overshoot=overshoot(recording["position"], target),
        cycle=float(np.ptp(last)),
        error=float(np.abs(last - target).mean()),
        settling=rig.settling_time(recording, target, COUNTS_MAX + inverter_displacement, ramp_end),
        displacement=inverter_displacement,
        displacement_range=float(round(np.ptp(displacement_range))),
    )


def travel(board: Board, axis: int, turns: float, ramp: bool, settle: float = SETTLE) -> Move:
    """Move one axis by a number of revolutions; `settle` is the permitted settling time [s]."""
    limit, start = read_axis(board, "param.speed_limit", axis), word(board, axis, "position")
    target = start + round(turns * COUNTS_PER_TURN)
    distance = abs(target - start) * COUNT
    duration = max(distance / (RAMP_SPEED * limit), RAMP_MIN) if ramp else distance / limit

    def act(k: int) -> None:
        if ramp and k * TICK <= duration + TICK:
            write_word(board, "cmd.position", axis, round(start + (target - start) * min(k * TICK / duration, 1.0)))
        elif not ramp and k == 0:
            write_word(board, "cmd.position", axis, target)

    recording = rig.record(board, [axis], duration + settle + REST, act)[axis]
    return measure(recording, target, duration, board.plant, axis)


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every distance as step and as ramp, forth and back, each axis separately."""
    speeds, lowered = move_speeds(plant, seed, together=False)
    settles = path_settles(plant, seed, SETTLE)
    with rig.spinning(plant, seed) as board:
        for axis, speed in enumerate(speeds):
            write_axis(board, "param.speed_limit", axis, speed)
        for distance, ramp in itertools.product(DISTANCES, (False, True)):
            how, signed_distance = (
                f"{'ramp' if ramp else 'step'} of {distance:g} turns",
                -distance if ramp else distance,
            )
            moves = [travel(board, axis, signed_distance, ramp, settle) for axis, settle in enumerate(settles)]
            for axis, (move, settle) in enumerate(zip(moves, settles, strict=True)):
                judge, within = Judge(f"{axis_name(axis)} {how}, ", REFERENCE_NONE), COUNTS_MAX + move.displacement
                calm = COUNTS_MAX + move.displacement_range
                yield judge("overshoot", move.overshoot, "counts", maximum=within, reference=REFERENCE_OVERSHOOT)
                yield judge("limit cycle", move.cycle, "counts", maximum=calm, reference=REFERENCE_CYCLE)
                yield judge("steady-state error", move.error, "counts", maximum=within)
                yield judge("settling", move.settling, "s", maximum=settle)
            if not ramp:
                yield from _panels(how, [move.recording for move in moves])
    yield "settling: after the end of the speed-limited set-point"
    yield lowered


def _panels(how: str, recordings: list[Trace]) -> Iterator[Panel]:
    whole: list[Curve] = []
    for axis, r in enumerate(recordings):
        for what, y, style in (("", r["position"], ""), (" set-point", r["position_ref"], "--")):
            turns = (y - r["position"][0]) / COUNTS_PER_TURN
            whole.append(Curve(axis_name(axis) + what, r.time, turns, f"C{axis}{style}"))
    yield Panel(how, "time [s]", "position [turns]", whole)
    error = [Curve(axis_name(axis), r.time, r["position_ref"] - r["position"]) for axis, r in enumerate(recordings)]
    yield Panel(f"{how}: shaped set-point - position", "time [s]", "difference [counts]", error)
