"""Two axes on one bus: what the one feels of the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import OVER_VOLTAGE, current_limits, top_speed
from servo_twin.experiments.rig import (
    RPM,
    TICK,
    Recording,
    choose_mode,
    command_speed,
    features,
    set_axis,
    spinning,
    watch,
)
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

HOLD_MOST: Final = 2.0  # [counts]
EVEN_MOST: Final = 1.0  # more deviation than alone [% of the set-point]
UNDER_VOLTAGE: Final = 16.0  # [V]


@dataclass(frozen=True)
class Pair:
    """The watched axis and the one that disturbs it."""

    watched: Recording
    other: Recording

    @property
    def swing(self) -> float:
        """From the lowest to the highest bus voltage [V]."""
        return float(np.ptp(self.watched.u_dc))

    def deviation(self, speed: float) -> float:
        """Largest deviation of the true speed from the set-point [rad/s]."""
        return float(np.abs(self.watched.omega - speed).max())


@dataclass(frozen=True)
class Reversals:
    """What the other axis does: set-points that change their sign twice a period.

    Attributes
    ----------
    speed, acceleration : float
        Of the set-point [rad/s], [rad/s^2]; as much as the plant's motor can do with a half of its current.
    """

    speed: float
    acceleration: float

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
        set_axis(board, "param.acceleration_limit", axis, self.acceleration)
        choose_mode(board, axis, "SPEED")
        half = round(0.5 * PERIOD / TICK)

        def act(k: int) -> None:
            if k % half == 0:
                command_speed(board, axis, self.speed if (k // half) % 2 == 0 else -self.speed)

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
    with spinning(plant, seed) as board:
        features(board, watched, BUS_COMPENSATION=compensated)
        choose_mode(board, watched, "SPEED")
        command_speed(board, watched, EVEN)
        watch(board, [watched], SETTLE)
        act = None if reversals is None else reversals.prepare(board, other)
        both = watch(board, [watched, other], MEASURED, act)
    return Pair(both[watched], both[other])


def hold(plant: PlantConfig, seed: int, watched: int, reversals: Reversals) -> Pair:
    """The watched axis holds its position while the other reverses."""
    other = 1 - watched
    with spinning(plant, seed) as board:
        both = watch(board, [watched, other], MEASURED, reversals.prepare(board, other))
    return Pair(both[watched], both[other])


def brake(plant: PlantConfig, seed: int, speed: float) -> dict[int, Recording]:
    """Both axes at a speed [rad/s], then set-point zero for both at once."""
    accelerations = [pushed(plant, seed, axis) for axis in range(AXES)]
    with spinning(plant, seed) as board:
        for axis, able in enumerate(accelerations):
            limits = board.read("param.acceleration_limit")
            assert isinstance(limits, list)
            set_axis(board, "param.acceleration_limit", axis, min(limits[axis], able))
            choose_mode(board, axis, "SPEED")
            command_speed(board, axis, speed)
        watch(board, [0], SETTLE)

        def act(k: int) -> None:
            if k == 0:
                for axis in range(AXES):
                    command_speed(board, axis, 0.0)

        return watch(board, range(AXES), BRAKE_TIME, act, may_fail=True)


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Each axis as the one that is watched, then both braking."""
    rows: list[Row] = []
    panels: list[Panel] = []
    notes: list[str] = []
    for watched in range(AXES):
        name = axis_name(watched)
        reversals = Reversals.of(plant, seed, 1 - watched)
        alone, together = (turn(plant, seed, watched, disturbed) for disturbed in (None, reversals))
        without = turn(plant, seed, watched, reversals, compensated=False)
        lift = reversals.lift(plant, 1 - watched)
        rows.extend(_rows(name, reversals, lift, alone, together, hold(plant, seed, watched, reversals)))
        notes.append(
            f"{name} at {EVEN / RPM:g} rpm, largest deviation: {alone.deviation(EVEN) / RPM:.3g} rpm alone, "
            f"{together.deviation(EVEN) / RPM:.3g} rpm with the other axis, {without.deviation(EVEN) / RPM:.3g} rpm "
            "without bus compensation"
        )
        panels.append(_panel(name, alone, together))
    speed = top_speed(plant, range(AXES), BRAKE_FROM)
    stop = brake(plant, seed, speed)
    rows.extend(_rows_brake(stop, speed))
    notes.append(f"both brake from {speed / RPM:.4g} rpm")
    panels.append(_panel_brake(stop))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(name: str, reversals: Reversals, lift: float, alone: Pair, together: Pair, held: Pair) -> tuple[Row, ...]:
    seed = "2.3: the bus must not be felt"
    more = 100.0 * (together.deviation(EVEN) - alone.deviation(EVEN)) / EVEN
    away = float(np.abs(held.watched.position - held.watched.position_ref).max())
    return (
        Row(
            f"{name}, the other reverses: bus swing",
            "not shown",
            together.swing,
            "V",
            Bound(BUS_SWING * lift, OVER_VOLTAGE - UNDER_VOLTAGE),
        ),
        Row(f"{name} turns, the other reverses: more deviation", seed, more, "% of speed", Bound(most=EVEN_MOST)),
        Row(f"{name} holds, the other reverses: deviation", seed, away, "counts", Bound(most=HOLD_MOST)),
        Row(
            f"{name}, the other reaches its speed",
            "not shown",
            float(np.ptp(together.other.omega) / (2.0 * reversals.speed)),
            "of set-point",
            Bound(0.9, 1.2),
        ),
    )


def _rows_brake(stop: dict[int, Recording], speed: float) -> list[Row]:
    highest = float(stop[0].u_dc.max())
    rows = [
        Row(
            "both brake: highest bus voltage",
            "not shown; the drive's limit is 33 V",
            highest,
            "V",
            Bound(most=OVER_VOLTAGE),
        ),
        Row(
            "both brake: faults",
            "none",
            float(np.bitwise_or.reduce(stop[0].faults | stop[1].faults)),
            "",
            Bound(0.0, 0.0),
        ),
    ]
    for axis, recording in stop.items():
        left = float(np.abs(recording.omega[-100:]).max() / RPM)
        rows.append(
            Row(f"both brake: {axis_name(axis)} stands", "not shown", left, "rpm", Bound(most=STANDS * speed / RPM))
        )
    return rows


def _panel(name: str, alone: Pair, together: Pair) -> Panel:
    curves = (
        Curve("with the other axis", together.watched.time, together.watched.omega / RPM),
        Curve("alone", alone.watched.time, alone.watched.omega / RPM),
        Curve("bus [V] - 24 V, x 10, + 1500", together.watched.time, 1500.0 + 10.0 * (together.watched.u_dc - 24.0)),
    )
    return Panel(f"{name} turns evenly, the other reverses", "time [s]", "speed [rpm]", curves)


def _panel_brake(stop: dict[int, Recording]) -> Panel:
    speed = [Curve(f"{axis_name(axis)} [100 rpm]", r.time, r.omega / RPM / 100.0) for axis, r in stop.items()]
    curves = (Curve("bus [V]", stop[0].time, stop[0].u_dc), *speed)
    return Panel("both axes brake at once", "time [s]", "bus [V], speed [100 rpm]", curves)
