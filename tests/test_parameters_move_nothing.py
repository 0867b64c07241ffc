"""A parameter that is written sets no shaft in motion and speeds none up, in whatever state: over the real line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, get_args

import numpy as np
import pytest
from line_world import World
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import AXES, Catalogue, Variable
from servo_twin.level import Level

CATALOGUE: Final = Catalogue.load()
BAUD: Final = 115_200
MODES: Final = CATALOGUE.enums["control_mode_t"]
FEATURES: Final = {flag.name: flag.mask for flag in CATALOGUE.flags["features"]}
WATCHED: Final = 0.15
"""How long the shafts are watched after each write [s]."""

HELD: Final = {"ideal": 3 * 2.0 * np.pi / 4000, "registers": 8 * 2.0 * np.pi / 4000}
"""A held shaft stays within so much [rad]; where there are switches it hunts by a few counts more."""

EXPECTED: Final = {"FAULT", "STOP", "READY", "FREEWHEEL", "HOST_SILENT", "FOLLOWING_ERROR", "OVER_SPEED"}
"""States and faults in which a parameter may end a motion."""

FASTER: Final = 1.6
"""A turning one gains no more than this [rad/s]: its ripple."""

FASTER_SENSORLESS: Final = 4.0
"""The same where the observer gives the speed [rad/s]."""


def values(variable: Variable) -> list[int]:
    """Raw numbers to write: both ends of the range, its middle, every enumerator, every single feature."""
    low, high = variable.to_raw(variable.minimum), variable.to_raw(variable.maximum)
    if variable.name == "param.monitor":
        return [high]
    if variable.enum is not None:
        return sorted(CATALOGUE.enums[variable.enum].values())
    if variable.flags == "features":
        return [0, high, *(15 ^ flag.mask for flag in CATALOGUE.flags["features"])]
    return sorted({low, (low + high) // 2, high})


def disabled(world: World) -> None:
    world.host.write("cmd.enable", 0, 0)
    world.run(0.3, world.host.keep_alive)
    world.run(1.3, world.host.keep_alive)
    assert world.states() == ["STOP"] * AXES


def holding(world: World) -> None:
    pass


def moving(world: World) -> None:
    """A position move that takes longer than the test, at less than the speed that is asked for later."""
    world.host.write("param.speed_limit", 50.0, 50.0)
    world.host.write("cmd.position", 1e4, -1e4)
    world.run(0.5, world.host.keep_alive)


def turning(world: World) -> None:
    """A speed set-point of which the limit has taken a part."""
    world.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    world.host.write("cmd.speed", 200.0, -200.0)
    world.run(0.3, world.host.keep_alive)
    world.host.write("param.speed_limit", 50.0, 50.0)
    world.run(0.5, world.host.keep_alive)


def held_at_a_soft_limit(world: World) -> None:
    """Speed set-points that soft limits have brought to 0."""
    world.host.write("param.position_max", 5.0, 5.0)
    world.host.write("param.position_min", -5.0, -5.0)
    world.host.write_raw("param.features", *[FEATURES["POSITION_LIMITS"] | 15] * AXES)
    world.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    world.host.write("cmd.speed", 50.0, -50.0)
    world.run(2.0, world.host.keep_alive)


def pushing(world: World) -> None:
    """Torque set-points that a lowered speed limit holds back."""
    world.host.write("cmd.mode", *[MODES["TORQUE"]] * AXES)
    world.host.write("param.speed_limit", 50.0, 50.0)
    world.host.write("cmd.i_q", 3.0, -3.0)
    world.run(0.1, world.host.keep_alive)
    world.host.write("param.i_q_limit", 0.5, 0.5)
    world.run(0.7, world.host.keep_alive)


def expired(world: World) -> None:
    world.host.write("param.command_timeout", 0.1)
    world.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    world.host.write("cmd.speed", 50.0, -50.0)
    world.run(0.5, world.host.keep_alive)


def stopped(world: World) -> None:
    """A quick stop out of a motion."""
    turning(world)
    world.host.command("QUICK_STOP")
    world.run(0.5, world.host.keep_alive)


def in_fault(world: World) -> None:
    turning(world)
    world.host.write_raw("param.features", *[FEATURES["OVER_SPEED"] | 15] * AXES)
    world.host.write("param.over_speed", 10.0, 10.0)
    world.run(4.0, world.host.keep_alive)
    assert world.states() == ["FAULT OVER_SPEED"] * AXES


def sensorless_ready(world: World) -> None:
    """Without an encoder, asked for a speed that the limit makes too slow to start."""
    disabled(world)
    world.host.write("param.feedback", *[CATALOGUE.enums["feedback_kind_t"]["OBSERVER"]] * AXES)
    world.host.write("param.speed_limit", 1.0, 1.0)
    world.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    world.host.write("cmd.enable", 1, 1)
    world.run(1.0, world.host.keep_alive)
    world.host.write("cmd.speed", 100.0, -100.0)
    world.run(0.5, world.host.keep_alive)
    assert world.states() == ["READY"] * AXES


def sensorless_turning(world: World) -> None:
    sensorless_ready(world)
    world.host.write("param.speed_limit", 100.0, 100.0)
    world.host.write("cmd.speed", 200.0, -200.0)
    world.run(3.0, world.host.keep_alive)
    assert world.states() == ["SPIN"] * AXES


STATES: Final = (
    disabled, holding, moving, turning, held_at_a_soft_limit, pushing, expired, stopped, in_fault, sensorless_ready,
    sensorless_turning,
)  # fmt: skip


@pytest.fixture(params=get_args(Level))
def worlds(request: pytest.FixtureRequest) -> Iterator[Callable[[], World]]:
    """Makes boards with both axes under control and set-points that do not expire."""
    made: list[World] = []

    def fresh() -> World:
        for world in made:
            world.close()
        made[:] = [World(request.param, BAUD)]
        world = made[0]
        world.host.write("param.command_timeout", 0.0)
        world.host.write("param.host_timeout", 5.0)
        world.enable()
        return world

    yield fresh
    for world in made:
        world.close()


@pytest.mark.parametrize("reach", STATES, ids=lambda function: function.__name__)
def test_parameter_written(worlds: Callable[[], World], reach: Callable[[World], None]) -> None:
    faster = FASTER_SENSORLESS if reach is sensorless_turning else FASTER
    world: World | None = None
    for variable in parameters(CATALOGUE):
        for raw in values(variable):
            if world is None:
                world = worlds()
                reach(world)
                before, states = {v.name: world.board.read_raw(v.name) for v in parameters(CATALOGUE)}, world.states()
            world.host.keep_alive()
            start = world.now
            was = np.abs(world.line.log.omega[-100:]).mean(axis=0)
            world.host.write_raw(variable.name, *[raw] * variable.count)
            world.run(WATCHED)
            world.host.write_raw(variable.name, *before[variable.name])
            world.run(WATCHED)
            _, omega = world.since(start, world.line.log.omega)
            what = f"{variable.name} = {raw}"
            gain = float((np.abs(omega).max(axis=0) - was).max())
            if was.max() < 1.0:
                assert world.travel(start) <= HELD[world.board.level], what
            else:
                assert gain <= faster, f"{what}: faster by {gain:.1f} rad/s"
            stopped_by = set(" ".join(world.states()).split()) - set(" ".join(states).split())
            assert stopped_by <= EXPECTED, what
            if world.states() != states or (was.max() > 1.0 and np.abs(omega[-1]).max() < 0.97 * was.max()):
                world = None  # a fault or a lower limit has ended that motion
