"""What the shafts do when commanders, readers, the cable or the board fail, row by row of servo_bridge/doc/failures.md.

Everything here goes over the serial line of a virtual board, byte by byte, in simulated time: at three baud rates, at
both levels, alone and beside a second client that only reads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np
import pytest
from line_world import BAUDS, World
from servo_bridge.freemaster.commands import write_memory
from servo_bridge.freemaster.errors import Status, StatusError
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_twin.level import Level, chosen_level

CATALOGUE = Catalogue.load()
SPEED = 100.0  # rad/s
TIMEOUT = 0.5  # s, param.host_timeout and param.command_timeout after reset
RAMP = SPEED / 4000.0  # s, at param.acceleration_limit after reset
MARGIN = 0.1  # s for the last write on the line, a slow tick, and the shaft that trails its ramp
HOLDING = 3 * 2.0 * np.pi / 4000  # rad, so far a held shaft moves
SPIN, STOP, SILENT = (["SPIN"] * AXES, ["STOP"] * AXES, ["FAULT HOST_SILENT"] * AXES)


@pytest.fixture(params=[pytest.param(False, id="alone"), pytest.param(True, id="beside a reader")])
def reader(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


@pytest.fixture(params=BAUDS)
def baud(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(params=get_args(Level))
def world(request: pytest.FixtureRequest, baud: int, reader: bool) -> Iterator[World]:
    """A board with both axes under control and at rest."""
    world = World(request.param, baud, reader=reader)
    world.enable()
    yield world
    world.close()


def stays(world: World, seconds: float = 1.0) -> None:
    """Nothing moves from now on, while keep-alives go on."""
    start = world.now
    world.run(seconds, world.host.keep_alive)
    assert world.travel(start) <= HOLDING


def test_velocity_not_renewed(world: World) -> None:
    world.turn(SPEED)
    start = world.now
    world.run(1.0, world.host.keep_alive)
    assert world.fastest(start + TIMEOUT - 0.1, start + TIMEOUT - 0.05) == pytest.approx(SPEED, rel=0.05)
    assert world.rests_from(start) <= TIMEOUT + RAMP + MARGIN
    assert world.travel(start) <= SPEED * (TIMEOUT + RAMP / 2 + 0.01)
    assert world.states() == SPIN
    assert all("EXPIRED" in world.limits(axis) for axis in range(AXES))
    stays(world)


def test_torque_not_renewed(world: World) -> None:
    world.host.write("cmd.mode", *[CATALOGUE.enums["control_mode_t"]["TORQUE"]] * AXES)
    world.host.write("cmd.i_q", 0.1, 0.1)  # up to the speed limit
    start = world.now
    world.run(1.5, world.host.keep_alive)
    reached = world.fastest(start)
    assert reached > SPEED
    assert world.rests_from(start) <= TIMEOUT + reached / 4000.0 + MARGIN
    assert world.states() == SPIN
    assert all("EXPIRED" in world.limits(axis) for axis in range(AXES))
    stays(world)


def test_position_not_renewed(world: World) -> None:
    world.host.write("cmd.position", 20.0, -20.0)
    start = world.now
    world.run(1.5, world.host.keep_alive)
    assert world.travel(start) == pytest.approx(20.0, abs=0.1)
    assert world.states() == SPIN
    assert not any("EXPIRED" in world.limits(axis) for axis in range(AXES))
    stays(world)


def test_host_silent_moving(world: World) -> None:
    world.turn(SPEED)
    start = world.now
    world.run(1.5)
    assert world.fastest(start + TIMEOUT - 0.1, start + TIMEOUT - 0.05) == pytest.approx(SPEED, rel=0.05)
    assert world.rests_from(start) <= TIMEOUT + RAMP + MARGIN
    assert world.travel(start) <= SPEED * (TIMEOUT + RAMP / 2 + 0.01)
    assert world.states() == SILENT
    stays(world)


def test_host_silent_holding(world: World) -> None:
    start = world.now
    world.run(TIMEOUT - 0.1)
    assert world.states() == SPIN
    world.run(0.2)
    assert world.states() == SILENT
    assert world.travel(start) <= HOLDING


def test_cable_out_short(world: World) -> None:
    renew = world.turn(SPEED)
    start = world.now
    world.line.plugged = False
    world.run(0.1, renew)
    world.line.plugged = True
    world.run(1.0, renew)
    assert world.states() == SPIN
    _, omega = world.since(start, world.line.log.omega)
    assert np.abs(omega).min() > 0.9 * SPEED, "the commander is there and goes on"


@pytest.mark.parametrize("out", [0.7, 3.0])
def test_cable_out_long(world: World, out: float) -> None:
    renew = world.turn(SPEED)
    start = world.now
    world.line.plugged = False
    world.run(out, renew)
    world.line.plugged = True
    world.run(0.5, renew)
    assert world.rests_from(start) <= TIMEOUT + RAMP + MARGIN
    assert world.states() == SILENT
    comes_back_by_command_only(world)


def comes_back_by_command_only(world: World) -> None:
    """Faults are cleared, drives enabled, and only then a new set-point moves."""
    start, renew = world.now, world.renew(SPEED)
    world.run(0.3, renew)
    world.host.command("CLEAR_FAULTS")
    world.run(0.3, renew)
    assert world.states() == STOP
    assert world.travel(start) <= HOLDING
    world.enable()
    stays(world, 0.3)
    world.turn(SPEED)


def test_cable_noise(world: World) -> None:
    """Frames with a wrong checksum are no sign of life, and change nothing."""
    world.turn(SPEED)
    start = world.now
    frame = bytearray(write_memory(world.board.address("cmd.speed"), CATALOGUE["cmd.speed"].encode([SPEED] * 2)).frame)
    frame[-1] ^= 1
    answers = bytearray()

    def damaged() -> None:
        world.line.write(bytes(frame))
        deadline = world.board.time_ns + 50_000_000
        while data := world.line.read(deadline):
            answers.extend(data)

    world.run(1.2, damaged)
    assert Status.CHECKSUM in answers, "the board has seen the damage"
    assert world.rests_from(start) <= TIMEOUT + RAMP + MARGIN
    assert world.states() == SILENT


def test_board_restarted(world: World) -> None:
    """The commander goes on after it; what was enabled and commanded before is gone."""
    renew = world.turn(SPEED)
    world.restart()
    world.run(1.0, renew, world.host.keep_alive)
    assert world.states() == STOP
    assert world.fastest(0.0) < 0.1


def test_quick_stop(world: World) -> None:
    renew = world.turn(SPEED)
    start = world.now
    world.host.command("QUICK_STOP")
    world.run(1.0, renew, world.host.keep_alive)
    assert world.rests_from(start) <= RAMP + MARGIN
    assert world.states() == SPIN
    stays(world)


class TestOneLine:
    """What does not depend on the speed of the line."""

    @pytest.fixture(params=BAUDS[1:2])
    def baud(self, request: pytest.FixtureRequest) -> int:
        return int(request.param)

    def test_reader(self, baud: int) -> None:
        """A client that reads comes and goes."""
        world = World(chosen_level(), baud)
        world.enable()
        renew = world.turn(SPEED)
        start = world.now
        world.run(0.3, renew)
        world.run(0.5, renew, world.host.look)
        world.run(0.3, renew)
        _, omega = world.since(start, world.line.log.omega)
        assert np.abs(omega - SPEED).max() < 0.05 * SPEED
        world.close()

    @pytest.mark.parametrize(
        ("name", "raw"),
        [("cmd.mode", 9), ("cmd.enable", 2), ("param.feedback", 9), ("param.monitor", 99), ("param.host_timeout", 0)],
    )
    def test_value_out_of_range(self, world: World, name: str, raw: int) -> None:
        before = world.board.read_raw(name)
        with pytest.raises(StatusError, match="outside"):
            world.host.write_raw(name, raw)
        assert world.board.read_raw(name) == before
        stays(world, 0.2)
