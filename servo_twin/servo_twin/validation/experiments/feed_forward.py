"""Position moves with feed-forward of speed, acceleration and friction."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_measurement.step_response import overshoot
from servo_msgs_py.board_port import word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.dead_time_torque import displacement_at
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.plant_limits import move_speeds, nominal_shafts
from servo_twin.validation.experiments.rig import COUNT, shaft_counts

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
SPEED_ERROR_RATIO_MAX: Final = 0.25
"""Permitted following error with speed feed-forward, relative to none: only the lag by the acceleration remains."""

ACCELERATION_ERROR_RATIO_MAX: Final = 0.75
"""Permitted following error with acceleration, relative to speed only: the torque is one slow loop late."""

INERTIA_OVERSHOOT_MAX: Final = 0.1
"""Permitted overshoot by a wrong nominal inertia, relative to its following error."""
FRICTION_OVERSHOOT_MAX: Final = 1.0
"""Permitted overshoot by an excessive friction current, per relative excess [counts]."""

REST: Final = 0.8  # recorded after the end of the ramp [s]
ARRIVED: Final = 2.0  # [counts]
SETTLING_INCREASE_MAX: Final = 0.01
"""Permitted increase of the settling time: a time constant of the path filter [s]."""

REFERENCE_LAG: Final = "E44: proportional position control: lag v / Kv"
REFERENCE_OVERSHOOT: Final = "2.7.3: position must not overshoot"


@dataclass(frozen=True)
class Move:
    """One move of one axis."""

    recording: Trace
    error: float  # largest distance of the true shaft from the shaped set-point [counts]
    overshoot: float  # largest distance beyond the target [counts]
    settling: float | None
    """From the command until the shaft stays within 2 counts of the target plus the displacement [s]."""
    displacement: float  # displacement by the inverter after the end of the set-point [counts]

    @property
    def window(self) -> float:
        """Distance from the target within which the shaft has settled [counts].

        The error decays like exp(-t / lag), so that a wider window, on a plant with displacement, is reached earlier.
        """
        return ARRIVED + self.displacement


def measure(recording: Trace, target: int, plant: PlantConfig, axis: int) -> Move:
    """Evaluate a move that starts at standstill with the recording; `target` in counts."""
    displacement = displacement_at(recording, plant, axis, target, ARRIVED)
    error = float(np.abs(recording["position_ref"] - shaft_counts(recording)).max())
    settling = rig.settling_time(recording, target, ARRIVED + displacement, 0.0)
    return Move(recording, error, overshoot(recording["position"], target), settling, displacement)


def travel(
    plant: PlantConfig, seed: int, turns: float, switches: Mapping[str, bool], speeds: list[float]
) -> list[Move]:
    """Move both axes simultaneously, from standstill, with speed limits [rad/s]."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.features(board, axis, **switches)
            write_axis(board, "param.speed_limit", axis, speeds[axis])
        targets = [word(board, axis, "position") + round(turns * COUNTS_PER_TURN) for axis in range(AXES)]

        def go() -> None:
            for axis, target in enumerate(targets):
                write_word(board, "cmd.position", axis, target)

        seconds = turns * COUNTS_PER_TURN * COUNT / min(speeds) + REST
        both = rig.record(board, range(AXES), seconds, rig.at({TICK: go}))
    return [measure(both[axis], target, plant, axis) for axis, target in enumerate(targets)]


@dataclass(frozen=True)
class Mismatch:
    """True and nominal inertia or friction."""

    true: float  # true value
    nominal: float  # nominal value, in the same unit

    @property
    def heavier(self) -> float:
        """True value relative to the nominal one, at least 1."""
        return max(self.true / self.nominal, 1.0)

    @property
    def lighter(self) -> float:
        """Nominal value relative to the true one, at least 1."""
        return max(self.nominal / self.true, 1.0)

    @property
    def wrong(self) -> float:
        """Relative error of the feed-forward."""
        return abs(self.true - self.nominal) / self.true


def error_bound(speed_error: float, inertia: Mismatch) -> float:
    """Permitted following error with acceleration feed-forward [counts].

    A fraction of the error with speed feed-forward alone [counts], for the delay of the torque; the error by a wrong
    nominal inertia; three counts.
    """
    return (ACCELERATION_ERROR_RATIO_MAX * inertia.lighter + inertia.wrong) * speed_error + ARRIVED + 1.0


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every distance, every choice, both axes simultaneously."""
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
                Curve(choice, r.time, np.abs(r["position_ref"] - shaft_counts(r)) + 0.1)
                for choice, r in ((choice, move.recording) for choice, move in of_axis.items())
            ]
            title = f"{axis_name(axis)}, {turns:g} turns: following error"
            yield Panel(title, "time [s]", "set-point - shaft [counts]", curves, log_y=True)
        errors = {choice: " and ".join(f"{move.error:.3g}" for move in both) for choice, both in moves.items()}
        text = ", ".join(f"{choice} {both}" for choice, both in errors.items())
        yield f"{turns:g} turns, largest following error of both axes [counts]: {text}"


def _rows(judge: Judge, moves: Mapping[str, Move], inertia: Mismatch, friction: Mismatch) -> Iterator[Row]:
    none, speed = moves["none"], moves["speed"]
    ratio, maximum = speed.error / max(none.error, 1e-9), SPEED_ERROR_RATIO_MAX * inertia.heavier
    yield judge("following error, speed / none", ratio, maximum=maximum, reference=REFERENCE_LAG)
    for choice in ("speed, acceleration", "all"):
        maximum = error_bound(speed.error, inertia)
        yield judge(f"following error, {choice}", moves[choice].error, "counts", maximum=maximum)
    forward = [move for choice, move in moves.items() if choice != "none"]
    friction_overshoot = FRICTION_OVERSHOOT_MAX * (friction.lighter - 1.0)
    displacement = max(move.displacement for move in forward)
    maximum = ARRIVED + displacement + INERTIA_OVERSHOOT_MAX * inertia.wrong * speed.error + friction_overshoot
    beyond = max(move.overshoot for move in forward)
    yield judge("largest overshoot", beyond, "counts", maximum=maximum, reference=REFERENCE_OVERSHOOT)
    later = _settling_increase(none.settling, [move.settling for move in forward])
    lag = none.error * COUNT / max(float(np.abs(none.recording["omega"]).max()), 1e-9)
    apart = SETTLING_INCREASE_MAX + lag * math.log(max(move.window for move in moves.values()) / ARRIVED)
    yield judge("additional settling time", later, "s", maximum=SETTLING_INCREASE_MAX, apart=apart)


def _settling_increase(without: float | None, forward: list[float | None]) -> float | None:
    """Additional settling time of the slowest of several moves [s]; None: one does not settle."""
    settled = [time for time in forward if time is not None]
    if without is None or len(settled) < len(forward):
        return None
    return max(settled) - without
