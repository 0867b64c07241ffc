"""Position moves with what is known about them fed forward: speed, acceleration, friction."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.experiments import rig
from servo_twin.experiments.dead_time_torque import swerve_at
from servo_twin.experiments.outcome import Curve, Item, Judge, Panel, Row, experiment
from servo_twin.experiments.plant_limits import move_speeds, nominal_shafts
from servo_twin.experiments.rig import COUNT, TICK, Recording
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "feed-forward"
HELP: Final = """\
Beyond the reference design: its position controller is proportional (E44), so the shaft lags the set-point by v / Kv;
it gives no figure for that. Here the speed of the shaped set-point is fed forward to the speed controller (feature
SPEED_FORWARD), and the current for its acceleration (ACCELERATION_FORWARD) and against friction (FRICTION). Shown:
following error, overshoot and settling of moves of 0.1, 1 and 100 turns, with none / speed / speed and acceleration /
all three, and the same gains."""

DISTANCES: Final = (0.1, 1.0, 100.0)  # [turns]
CHOICES: Final[Mapping[str, Mapping[str, bool]]] = {
    "none": {},
    "speed": {"SPEED_FORWARD": True},
    "speed, acceleration": {"SPEED_FORWARD": True, "ACCELERATION_FORWARD": True},
    "all": {"SPEED_FORWARD": True, "ACCELERATION_FORWARD": True, "FRICTION": True},
}
SPEED_LEFT_MAX: Final = 0.25
"""Part of the following error that may be left with the speed: the lag of E44 goes, that of the acceleration stays."""

ACCELERATION_LEFT_MAX: Final = 0.75
"""Part of that which may be left with the acceleration: the torque still comes a slow loop late."""

OVERSHOOT_OF_WRONG: Final = 0.1
OVERSHOOT_OF_FRICTION: Final = 1.0
"""Counts that current against a friction pushes which is not there, per part of the friction that is."""
"""Of the error that a wrong nominal inertia brings, what may come out beyond the target."""

REST: Final = 0.8  # recorded after the ramp's end [s]
ARRIVED: Final = 2.0  # [counts]
SETTLE_WORSE_MAX: Final = 0.01
"""A time constant of the path filter [s]."""

REFERENCE_LAG: Final = "E44: a plain gain trails"
REFERENCE_OVERSHOOT: Final = "2.7.3: position must not overshoot"


@dataclass(frozen=True)
class Move:
    """One move of one axis."""

    recording: Recording
    error: float  # largest distance of the true shaft from the shaped set-point [counts]
    overshoot: float  # farthest beyond the target [counts]
    settling: float | None
    """From the command until the shaft stays within 2 counts of the target, and what it swerves [s]."""
    swerve: float  # motion by current that the inverter keeps back, after the set-point has arrived [counts]

    @property
    def window(self) -> float:
        """Distance from the target within which the shaft has settled [counts].

        It comes down to it like exp(-t / lag), so that a wider one, on a plant that lets it swerve, is reached earlier.
        """
        return ARRIVED + self.swerve


def measure(recording: Recording, target: int, shaft: AxisPlant) -> Move:
    """Judge a move of a shaft that began at rest with the recording; `target` in counts."""
    swerve = swerve_at(recording, shaft, target, ARRIVED)
    error = float(np.abs(recording.position_ref - recording.shaft).max())
    settling = rig.arrives(recording, target, ARRIVED + swerve, 0.0)
    return Move(recording, error, rig.overshoot(recording, target), settling, swerve)


def travel(
    plant: PlantConfig, seed: int, turns: float, switches: Mapping[str, bool], speeds: list[float]
) -> list[Move]:
    """Both axes at once, from rest, with speed limits [rad/s]."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.features(board, axis, **switches)
            rig.set_axis(board, "param.speed_limit", axis, speeds[axis])
        targets = [rig.position_of(board, axis) + round(turns * COUNTS_PER_TURN) for axis in range(AXES)]

        def go() -> None:
            for axis, target in enumerate(targets):
                rig.command_position(board, axis, target)

        seconds = turns * COUNTS_PER_TURN * COUNT / min(speeds) + REST
        both = rig.watch(board, range(AXES), seconds, rig.at({TICK: go}))
    return [measure(both[axis], target, plant.axes[axis]) for axis, target in enumerate(targets)]


@dataclass(frozen=True)
class Mismatch:
    """True inertia or friction against the nominal value."""

    there: float  # true value
    nominal: float  # in the same unit

    @property
    def heavier(self) -> float:
        """What acceleration costs a loop tuned for less inertia; 1 for less than nominal."""
        return max(self.there / self.nominal, 1.0)

    @property
    def lighter(self) -> float:
        """By how much a late torque costs more than the acceleration itself; 1 for more than nominal."""
        return max(self.nominal / self.there, 1.0)

    @property
    def wrong(self) -> float:
        """Error of feed-forward over what is needed (ratio)."""
        return abs(self.there - self.nominal) / self.there


def error_bound(speed_error: float, inertia: Mismatch) -> float:
    """Following error that may be left with the acceleration fed forward, too [counts].

    A part of the error with the speed alone [counts], for the torque that comes late; the error that a wrong nominal
    inertia brings back; three counts.
    """
    return (ACCELERATION_LEFT_MAX * inertia.lighter + inertia.wrong) * speed_error + ARRIVED + 1.0


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every distance, every choice, both axes at once."""
    speeds, lowered = move_speeds(plant, seed, together=True)
    nominals = list(zip(plant.axes, nominal_shafts(plant, seed), strict=True))
    inertias = [Mismatch(entry.inertia, nominal.inertia) for entry, nominal in nominals]
    frictions = [Mismatch(entry.friction, nominal.friction) for entry, nominal in nominals]
    yield lowered
    for turns in DISTANCES:
        moves = {choice: travel(plant, seed, turns, on, speeds) for choice, on in CHOICES.items()}
        for axis in range(AXES):
            of_axis = {choice: both[axis] for choice, both in moves.items()}
            judge = Judge(f"{axis_name(axis)} {turns:g} turns, ")
            yield from _rows(judge, of_axis, inertias[axis], frictions[axis])
            curves = [
                Curve(choice, r.time, np.abs(r.position_ref - r.shaft) + 0.1)
                for choice, r in ((choice, move.recording) for choice, move in of_axis.items())
            ]
            title = f"{axis_name(axis)}, {turns:g} turns: following error"
            yield Panel(title, "time [s]", "set-point - shaft [counts]", curves, log_y=True)
        errors = {choice: " and ".join(f"{move.error:.3g}" for move in both) for choice, both in moves.items()}
        text = ", ".join(f"{choice} {both}" for choice, both in errors.items())
        yield f"{turns:g} turns, largest following error of both axes [counts]: {text}"


def _rows(judge: Judge, moves: Mapping[str, Move], inertia: Mismatch, friction: Mismatch) -> Iterator[Row]:
    none, speed = moves["none"], moves["speed"]
    left, maximum = speed.error / max(none.error, 1e-9), SPEED_LEFT_MAX * inertia.heavier
    yield judge("following error, speed over none", left, maximum=maximum, reference=REFERENCE_LAG)
    for choice in ("speed, acceleration", "all"):
        maximum = error_bound(speed.error, inertia)
        yield judge(f"following error, {choice}", moves[choice].error, "counts", maximum=maximum)
    forward = [move for choice, move in moves.items() if choice != "none"]
    pushed = OVERSHOOT_OF_FRICTION * (friction.lighter - 1.0)
    swerve = max(move.swerve for move in forward)
    maximum = ARRIVED + swerve + OVERSHOOT_OF_WRONG * inertia.wrong * speed.error + pushed
    beyond = max(move.overshoot for move in forward)
    yield judge("overshoot, worst", beyond, "counts", maximum=maximum, reference=REFERENCE_OVERSHOOT)
    later = _later(none.settling, [move.settling for move in forward])
    lag = none.error * COUNT / max(float(np.abs(none.recording.omega).max()), 1e-9)
    apart = SETTLE_WORSE_MAX + lag * math.log(max(move.window for move in moves.values()) / ARRIVED)
    yield judge("settling, latest less none", later, "s", maximum=SETTLE_WORSE_MAX, apart=apart)


def _later(without: float | None, forward: list[float | None]) -> float | None:
    """How much later the last of several moves settles [s]; None if one of them does not."""
    settled = [time for time in forward if time is not None]
    if without is None or len(settled) < len(forward):
        return None
    return max(settled) - without
