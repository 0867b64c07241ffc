"""Two axes on one bus: what the one feels of the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name

from servo_twin.board import Board
from servo_twin.experiments import rig
from servo_twin.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.experiments.plant_limits import OVER_VOLTAGE, current_limits, top_speed
from servo_twin.experiments.rig import RPM, TICK, Recording
from servo_twin.plant import PlantConfig

NAME: Final = "two-axes"
HELP: Final = """\
One axis holds its position or turns evenly while the other reverses on the same bus; then both brake at once.
The reference design drives two motors from one supply and one controller (1, 4.3) and shows no measurement of their
influence on each other; the ripple compensation (2.3) has to keep it small. Where the bus of the plant cannot take what
comes back from both shafts at 3000 rpm, both brake from less."""

REVERSE: Final = 2500.0 * RPM  # of the axis that disturbs, at most
PUSH: Final = 0.5  # of the current limit, while it reverses
PERIOD: Final = 0.4  # of its reversals [s]
EVEN: Final = 1500.0 * RPM  # of the axis that is watched
SETTLE: Final = 0.5  # [s]
MEASURED: Final = 1.6  # [s]
BRAKE_FROM: Final = 3000.0 * RPM  # at most
BRAKE_TIME: Final = 0.5  # [s]
STANDS: Final = 0.01  # of the speed that both have braked from

BUS_SWING: Final = 0.05
"""Part of what the other axis could do to the bus without losses; less than this and it has not disturbed it."""

HOLD_MAX: Final = 2.0  # [counts]
EVEN_MAX: Final = 1.0  # more deviation than alone [% of the set-point]
UNDER_VOLTAGE: Final = 16.0  # [V]


Pair = tuple[Recording, Recording]
"""The watched axis and the one that disturbs it."""


@dataclass(frozen=True)
class Reversals:
    """What the other axis does: set-points that change their sign twice a period."""

    speed: float  # of the set-point [rad/s]; as much as the plant's motor can do with a half of its current
    acceleration: float  # likewise [rad/s^2]

    @classmethod
    def of(cls, plant: PlantConfig, seed: int, axis: int) -> Reversals:
        acceleration = pushed(plant, seed, axis)
        in_time = 0.35 * (0.5 * PERIOD) * acceleration  # from one speed to the other in 0.7 of the time between
        return cls(min(top_speed(plant, [axis], REVERSE), in_time), acceleration)

    def lift(self, plant: PlantConfig, axis: int) -> float:
        """How far braking to a stop would lift the bus without losses [V]."""
        energy = 0.5 * plant.axes[axis].inertia * self.speed**2
        return math.sqrt(plant.bus.u_source**2 + 2.0 * energy / plant.bus.capacitance) - plant.bus.u_source

    def prepare(self, board: Board, axis: int) -> Callable[[int], None]:
        """Set the axis up; returns what has to be done in every slow tick."""
        rig.set_up(board, axis, "SPEED", parameters={"acceleration_limit": self.acceleration})
        half = round(0.5 * PERIOD / TICK)

        def act(k: int) -> None:
            if k % half == 0:
                rig.command_speed(board, axis, self.speed if (k // half) % 2 == 0 else -self.speed)

        return act


def pushed(plant: PlantConfig, seed: int, axis: int) -> float:
    """Acceleration with a half of the current limit, as far as it can be set [rad/s^2]."""
    entry = plant.axes[axis]
    torque = PUSH * current_limits(plant, seed)[axis] * entry.torque_constant - entry.friction
    variable = Catalogue.load()["param.acceleration_limit"]
    assert variable.minimum is not None
    assert variable.maximum is not None
    return min(max(torque / entry.inertia, variable.minimum), variable.maximum)


def turn(plant: PlantConfig, seed: int, watched: int, reversals: Reversals | None, compensated: bool = True) -> Pair:
    """The watched axis turns evenly, the other rests or reverses."""
    other = 1 - watched
    with rig.spinning(plant, seed) as board:
        rig.set_up(board, watched, "SPEED", EVEN, BUS_COMPENSATION=compensated)
        rig.watch(board, [watched], SETTLE)
        act = None if reversals is None else reversals.prepare(board, other)
        both = rig.watch(board, [watched, other], MEASURED, act)
    return both[watched], both[other]


def hold(plant: PlantConfig, seed: int, watched: int, reversals: Reversals) -> Recording:
    """The watched axis holds its position while the other reverses."""
    with rig.spinning(plant, seed) as board:
        return rig.watch(board, [watched], MEASURED, reversals.prepare(board, 1 - watched))[watched]


def brake(plant: PlantConfig, seed: int, speed: float) -> dict[int, Recording]:
    """Both axes at a speed [rad/s], then set-point zero for both at once."""
    accelerations = [pushed(plant, seed, axis) for axis in range(AXES)]
    with rig.spinning(plant, seed) as board:
        for axis, able in enumerate(accelerations):
            able = min(rig.get_axis(board, "param.acceleration_limit", axis), able)
            rig.set_up(board, axis, "SPEED", speed, parameters={"acceleration_limit": able})
        rig.watch(board, [0], SETTLE)

        def stop() -> None:
            for axis in range(AXES):
                rig.command_speed(board, axis, 0.0)

        return rig.watch(board, range(AXES), BRAKE_TIME, rig.at({0.0: stop}), may_fail=True)


def deviation(recording: Recording) -> float:
    """Largest deviation of the true speed from `EVEN` [rad/s]."""
    return float(np.abs(recording.omega - EVEN).max())


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Each axis as the one that is watched, then both braking."""
    for watched in range(AXES):
        name, judge = axis_name(watched), Judge(axis_name(watched), NOT_SHOWN)
        reversals = Reversals.of(plant, seed, 1 - watched)
        alone, _ = turn(plant, seed, watched, None)
        together, other = turn(plant, seed, watched, reversals)
        without, _ = turn(plant, seed, watched, reversals, compensated=False)
        held = hold(plant, seed, watched, reversals)
        away = np.abs(held.position - held.position_ref).max()
        more = 100.0 * (deviation(together) - deviation(alone)) / EVEN
        swing, minimum = np.ptp(together.u_dc), BUS_SWING * reversals.lift(plant, 1 - watched)
        reached, unfelt = np.ptp(other.omega) / (2.0 * reversals.speed), "2.3: the bus must not be felt"
        yield judge(", the other reverses: bus swing", swing, "V", minimum, OVER_VOLTAGE - UNDER_VOLTAGE)
        yield judge(
            " turns, the other reverses: more deviation", more, "% of speed", maximum=EVEN_MAX, reference=unfelt
        )
        yield judge(" holds, the other reverses: deviation", away, "counts", maximum=HOLD_MAX, reference=unfelt)
        yield judge(", the other reaches its speed", reached, "of set-point", 0.9, 1.2)
        yield (
            f"{name} at {EVEN / RPM:g} rpm, largest deviation: {deviation(alone) / RPM:.3g} rpm alone, "
            f"{deviation(together) / RPM:.3g} rpm with the other axis, {deviation(without) / RPM:.3g} rpm "
            "without bus compensation"
        )
        curves = (
            Curve("with the other axis", together.time, together.omega / RPM),
            Curve("alone", alone.time, alone.omega / RPM),
            Curve("bus [V] - 24 V, x 10, + 1500", together.time, 1500.0 + 10.0 * (together.u_dc - 24.0)),
        )
        yield Panel(f"{name} turns evenly, the other reverses", "time [s]", "speed [rpm]", curves)
    speed = top_speed(plant, range(AXES), BRAKE_FROM)
    stop, judge = brake(plant, seed, speed), Judge("both brake: ", NOT_SHOWN)
    limit, faults = "not shown; the drive's limit is 33 V", np.bitwise_or.reduce(stop[0].faults | stop[1].faults)
    yield judge("highest bus voltage", stop[0].u_dc.max(), "V", maximum=OVER_VOLTAGE, reference=limit)
    yield judge.none("faults", faults, reference="none")
    for axis, r in stop.items():
        left = np.abs(r.omega[-100:]).max() / RPM
        yield judge(f"{axis_name(axis)} stands", left, "rpm", maximum=STANDS * speed / RPM)
    yield f"both brake from {speed / RPM:.4g} rpm"
    speeds = [Curve(f"{axis_name(axis)} [100 rpm]", r.time, r.omega / RPM / 100.0) for axis, r in stop.items()]
    bus = Curve("bus [V]", stop[0].time, stop[0].u_dc)
    yield Panel("both axes brake at once", "time [s]", "bus [V], speed [100 rpm]", [bus, *speeds])
