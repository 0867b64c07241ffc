"""Mutual influence of two axes on one bus."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import read_axis, write_axis
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import current_limits, over_voltage, top_speed
from servo_twin.validation.experiments.rig import RPM

NAME: Final = "two-axes"
HELP: Final = """\
One axis holds its position or a constant speed while the other reverses on the same bus; then both brake together.
The reference design drives two motors from one supply and one controller (1, 4.3) and shows no measurement of their
influence on each other; the ripple compensation (2.3) has to keep it small. If the bus of the plant cannot absorb the
energy of both shafts at 3000 rpm, both brake from a lower speed."""

REVERSE: Final = 2500.0 * RPM  # largest speed of the disturbing axis
CURRENT: Final = 0.5  # current of a reversal, relative to the current limit
PERIOD: Final = 0.4  # period of the reversals [s]
CONSTANT: Final = 1500.0 * RPM  # speed of the observed axis
SETTLE: Final = 0.5  # [s]
MEASURED: Final = 1.6  # [s]
BRAKE_FROM: Final = 3000.0 * RPM  # largest initial speed
BRAKE_TIME: Final = 0.5  # [s]
STANDSTILL: Final = 0.01  # relative to the initial speed

BUS_VARIATION_MIN: Final = 0.05
"""Smallest variation of the bus by the other axis, relative to the variation without losses."""

HOLD_MAX: Final = 2.0  # [counts]
DEVIATION_MAX: Final = 1.0  # permitted increase of the deviation [% of the set-point]
UNDER_VOLTAGE: Final = 16.0  # [V]


Pair = tuple[Trace, Trace]
"""Recordings of the observed and of the disturbing axis."""


@dataclass(frozen=True)
class Reversals:
    """Speed set-points of the disturbing axis, with two reversals per period."""

    speed: float  # set-point, feasible with half of the current limit [rad/s]
    acceleration: float  # acceleration with half of the current limit [rad/s^2]

    @classmethod
    def of(cls, plant: PlantConfig, seed: int, axis: int) -> Reversals:
        acceleration = acceleration_of(plant, seed, axis)
        in_time = 0.35 * (0.5 * PERIOD) * acceleration  # a reversal takes 0.7 of the time between reversals
        return cls(min(top_speed(plant, [axis], REVERSE), in_time), acceleration)

    def bus_rise(self, plant: PlantConfig, axis: int) -> float:
        """Rise of the bus voltage by braking to standstill, without losses [V]."""
        energy = 0.5 * plant.axes[axis].inertia * self.speed**2
        return math.sqrt(plant.bus.u_source**2 + 2.0 * energy / plant.bus.capacitance) - plant.bus.u_source

    def prepare(self, board: Board, axis: int) -> Callable[[int], None]:
        """Set up the axis; returns the action for every slow tick."""
        rig.set_up(board, axis, "SPEED", parameters={"acceleration_limit": self.acceleration})
        half = round(0.5 * PERIOD / TICK)

        def act(k: int) -> None:
            if k % half == 0:
                write_axis(board, "cmd.speed", axis, self.speed if (k // half) % 2 == 0 else -self.speed)

        return act


def acceleration_of(plant: PlantConfig, seed: int, axis: int) -> float:
    """Acceleration with half of the current limit, within the range of the parameter [rad/s^2]."""
    entry = plant.axes[axis]
    torque = CURRENT * current_limits(plant, seed)[axis] * entry.torque_constant - entry.friction
    variable = Catalogue.load()["param.acceleration_limit"]
    assert variable.minimum is not None
    assert variable.maximum is not None
    return min(max(torque / entry.inertia, variable.minimum), variable.maximum)


def turn(plant: PlantConfig, seed: int, observed: int, reversals: Reversals | None, compensated: bool = True) -> Pair:
    """The observed axis rotates at constant speed, the other one is at standstill or reverses."""
    other = 1 - observed
    with rig.spinning(plant, seed) as board:
        rig.set_up(board, observed, "SPEED", CONSTANT, BUS_COMPENSATION=compensated)
        rig.record(board, [observed], SETTLE)
        act = None if reversals is None else reversals.prepare(board, other)
        both = rig.record(board, [observed, other], MEASURED, act)
    return both[observed], both[other]


def hold(plant: PlantConfig, seed: int, observed: int, reversals: Reversals) -> Trace:
    """The observed axis holds its position while the other axis reverses."""
    with rig.spinning(plant, seed) as board:
        return rig.record(board, [observed], MEASURED, reversals.prepare(board, 1 - observed))[observed]


def brake(plant: PlantConfig, seed: int, speed: float) -> dict[int, Trace]:
    """Both axes at a speed [rad/s], then set-point zero for both simultaneously."""
    accelerations = [acceleration_of(plant, seed, axis) for axis in range(AXES)]
    with rig.spinning(plant, seed) as board:
        for axis, feasible in enumerate(accelerations):
            feasible = min(read_axis(board, "param.acceleration_limit", axis), feasible)
            rig.set_up(board, axis, "SPEED", speed, parameters={"acceleration_limit": feasible})
        rig.record(board, [0], SETTLE)

        def stop() -> None:
            for axis in range(AXES):
                write_axis(board, "cmd.speed", axis, 0.0)

        return rig.record(board, range(AXES), BRAKE_TIME, rig.at({0.0: stop}), may_fail=True)


def deviation(recording: Trace) -> float:
    """Largest deviation of the true speed from `CONSTANT` [rad/s]."""
    return float(np.abs(recording["omega"] - CONSTANT).max())


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Each axis as the observed one, then both braking."""
    for observed in range(AXES):
        name, judge = axis_name(observed), Judge(axis_name(observed), NOT_SHOWN)
        reversals = Reversals.of(plant, seed, 1 - observed)
        alone, _ = turn(plant, seed, observed, None)
        together, other = turn(plant, seed, observed, reversals)
        without, _ = turn(plant, seed, observed, reversals, compensated=False)
        held = hold(plant, seed, observed, reversals)
        position_deviation = np.abs(held["position"] - held["position_ref"]).max()
        more = 100.0 * (deviation(together) - deviation(alone)) / CONSTANT
        variation, minimum = np.ptp(together["u_dc"]), BUS_VARIATION_MIN * reversals.bus_rise(plant, 1 - observed)
        reached, unfelt = np.ptp(other["omega"]) / (2.0 * reversals.speed), "2.3: the bus must not be felt"
        yield judge(
            ", the other reverses: bus voltage variation", variation, "V", minimum, over_voltage() - UNDER_VOLTAGE
        )
        yield judge(
            " rotates, the other reverses: additional deviation",
            more,
            "% of speed",
            maximum=DEVIATION_MAX,
            reference=unfelt,
        )
        yield judge(
            " holds, the other reverses: deviation", position_deviation, "counts", maximum=HOLD_MAX, reference=unfelt
        )
        yield judge(", the other reaches its speed", reached, "of set-point", 0.9, 1.2)
        yield (
            f"{name} at {CONSTANT / RPM:g} rpm, largest deviation: {deviation(alone) / RPM:.3g} rpm alone, "
            f"{deviation(together) / RPM:.3g} rpm with the other axis, {deviation(without) / RPM:.3g} rpm "
            "without bus compensation"
        )
        curves = (
            Curve("with the other axis", together.time, together["omega"] / RPM),
            Curve("alone", alone.time, alone["omega"] / RPM),
            Curve("bus [V] - 24 V, x 10, + 1500", together.time, 1500.0 + 10.0 * (together["u_dc"] - 24.0)),
        )
        yield Panel(f"{name} at constant speed, the other axis reverses", "time [s]", "speed [rpm]", curves)
    speed = top_speed(plant, range(AXES), BRAKE_FROM)
    stop, judge = brake(plant, seed, speed), Judge("both brake: ", NOT_SHOWN)
    limit, faults = "not shown; the drive's limit is 33 V", np.bitwise_or.reduce(stop[0]["faults"] | stop[1]["faults"])
    yield judge("highest bus voltage", stop[0]["u_dc"].max(), "V", maximum=over_voltage(), reference=limit)
    yield judge.none("faults", faults, reference="none")
    for axis, r in stop.items():
        speed_left = np.abs(r["omega"][-100:]).max() / RPM
        yield judge(f"{axis_name(axis)} at standstill: speed", speed_left, "rpm", maximum=STANDSTILL * speed / RPM)
    yield f"both brake from {speed / RPM:.4g} rpm"
    speeds = [Curve(f"{axis_name(axis)} [100 rpm]", r.time, r["omega"] / RPM / 100.0) for axis, r in stop.items()]
    bus = Curve("bus [V]", stop[0].time, stop[0]["u_dc"])
    yield Panel("both axes brake simultaneously", "time [s]", "bus [V], speed [100 rpm]", [bus, *speeds])
