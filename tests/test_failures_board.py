"""Motion of the shafts at failures of senders, readers, cable or board: the rows of servo_bridge/doc/failures.md.

The tests use the serial line of a virtual board in simulated time: at three baud rates, at both levels, and with and
without a second client that only reads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np
import pytest
from line_simulation import BAUDS, LineSimulation
from servo_bridge.freemaster.commands import write_memory
from servo_bridge.freemaster.errors import Status, StatusError
from servo_msgs_py.board_port import active
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_twin.level import Level, chosen_level

CATALOGUE = Catalogue.load()
SPEED = 100.0  # rad/s
TIMEOUT = 0.5  # s, param.host_timeout and param.command_timeout after reset
RAMP = SPEED / 4000.0  # s, at param.acceleration_limit after reset
MARGIN = 0.1  # s, for the last write on the line, a slow tick, and the following error of the ramp
HOLDING = 3 * 2.0 * np.pi / 4000  # rad, largest motion of a held shaft
SPIN, STOP, SILENT = (["SPIN"] * AXES, ["STOP"] * AXES, ["FAULT HOST_SILENT"] * AXES)


@pytest.fixture(params=[pytest.param(False, id="alone"), pytest.param(True, id="beside a reader")])
def reader(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


@pytest.fixture(params=BAUDS)
def baud(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(params=get_args(Level))
def sim(request: pytest.FixtureRequest, baud: int, reader: bool) -> Iterator[LineSimulation]:
    """A board with both axes under control and at rest."""
    sim = LineSimulation(request.param, baud, reader=reader)
    sim.enable()
    yield sim
    sim.close()


def assert_standstill(sim: LineSimulation, seconds: float = 1.0) -> None:
    """Both shafts stay at rest for a time [s], with keep-alives."""
    start = sim.now
    sim.run(seconds, sim.host.keep_alive)
    assert sim.travel(start) <= HOLDING


def test_velocity_not_renewed(sim: LineSimulation) -> None:
    sim.reach_speed(SPEED)
    start = sim.now
    sim.run(1.0, sim.host.keep_alive)
    assert sim.speed_max(start + TIMEOUT - 0.1, start + TIMEOUT - 0.05) == pytest.approx(SPEED, rel=0.05)
    assert sim.stop_time(start) <= TIMEOUT + RAMP + MARGIN
    assert sim.travel(start) <= SPEED * (TIMEOUT + RAMP / 2 + 0.01)
    assert sim.states() == SPIN
    assert all("EXPIRED" in active(sim.board, axis, "limits") for axis in range(AXES))
    assert_standstill(sim)


def test_torque_not_renewed(sim: LineSimulation) -> None:
    sim.host.write("cmd.mode", *[CATALOGUE.enums["control_mode_t"]["TORQUE"]] * AXES)
    sim.host.write("cmd.i_q", 0.1, 0.1)  # up to the speed limit
    start = sim.now
    sim.run(1.5, sim.host.keep_alive)
    reached = sim.speed_max(start)
    assert reached > SPEED
    assert sim.stop_time(start) <= TIMEOUT + reached / 4000.0 + MARGIN
    assert sim.states() == SPIN
    assert all("EXPIRED" in active(sim.board, axis, "limits") for axis in range(AXES))
    assert_standstill(sim)


def test_position_not_renewed(sim: LineSimulation) -> None:
    sim.host.write("cmd.position", 20.0, -20.0)
    start = sim.now
    sim.run(1.5, sim.host.keep_alive)
    assert sim.travel(start) == pytest.approx(20.0, abs=0.1)
    assert sim.states() == SPIN
    assert not any("EXPIRED" in active(sim.board, axis, "limits") for axis in range(AXES))
    assert_standstill(sim)


def test_host_silent_moving(sim: LineSimulation) -> None:
    sim.reach_speed(SPEED)
    start = sim.now
    sim.run(1.5)
    assert sim.speed_max(start + TIMEOUT - 0.1, start + TIMEOUT - 0.05) == pytest.approx(SPEED, rel=0.05)
    assert sim.stop_time(start) <= TIMEOUT + RAMP + MARGIN
    assert sim.travel(start) <= SPEED * (TIMEOUT + RAMP / 2 + 0.01)
    assert sim.states() == SILENT
    assert_standstill(sim)


def test_host_silent_holding(sim: LineSimulation) -> None:
    start = sim.now
    sim.run(TIMEOUT - 0.1)
    assert sim.states() == SPIN
    sim.run(0.2)
    assert sim.states() == SILENT
    assert sim.travel(start) <= HOLDING


def test_cable_out_short(sim: LineSimulation) -> None:
    write_speed = sim.reach_speed(SPEED)
    start = sim.now
    sim.line.plugged = False
    sim.run(0.1, write_speed)
    sim.line.plugged = True
    sim.run(1.0, write_speed)
    assert sim.states() == SPIN
    _, omega = sim.since(start, sim.line.log.omega)
    assert np.abs(omega).min() > 0.9 * SPEED, "the set-points continue after the interruption"


@pytest.mark.parametrize("out", [0.7, 3.0])
def test_cable_out_long(sim: LineSimulation, out: float) -> None:
    write_speed = sim.reach_speed(SPEED)
    start = sim.now
    sim.line.plugged = False
    sim.run(out, write_speed)
    sim.line.plugged = True
    sim.run(0.5, write_speed)
    assert sim.stop_time(start) <= TIMEOUT + RAMP + MARGIN
    assert sim.states() == SILENT
    assert_restart_by_command_only(sim)


def assert_restart_by_command_only(sim: LineSimulation) -> None:
    """A set-point moves the shafts only after the faults are cleared and the drives enabled."""
    start, write_speed = sim.now, sim.speed_writer(SPEED)
    sim.run(0.3, write_speed)
    sim.host.command("CLEAR_FAULTS")
    sim.run(0.3, write_speed)
    assert sim.states() == STOP
    assert sim.travel(start) <= HOLDING
    sim.enable()
    assert_standstill(sim, 0.3)
    sim.reach_speed(SPEED)


def test_cable_noise(sim: LineSimulation) -> None:
    """Frames with a wrong checksum do not restart the host time-out and have no effect."""
    sim.reach_speed(SPEED)
    start = sim.now
    frame = bytearray(write_memory(sim.board.address("cmd.speed"), CATALOGUE["cmd.speed"].encode([SPEED] * 2)).frame)
    frame[-1] ^= 1
    answers = bytearray()

    def damaged() -> None:
        sim.line.write(bytes(frame))
        deadline = sim.board.time_ns + 50_000_000
        while data := sim.line.read(deadline):
            answers.extend(data)

    sim.run(1.2, damaged)
    assert Status.CHECKSUM in answers, "the board has detected the damage"
    assert sim.stop_time(start) <= TIMEOUT + RAMP + MARGIN
    assert sim.states() == SILENT


def test_board_restarted(sim: LineSimulation) -> None:
    """Set-points continue after the restart; enable and set-points from before are lost."""
    write_speed = sim.reach_speed(SPEED)
    sim.restart()
    sim.run(1.0, write_speed, sim.host.keep_alive)
    assert sim.states() == STOP
    assert sim.speed_max(0.0) < 0.1


def test_quick_stop(sim: LineSimulation) -> None:
    write_speed = sim.reach_speed(SPEED)
    start = sim.now
    sim.host.command("QUICK_STOP")
    sim.run(1.0, write_speed, sim.host.keep_alive)
    assert sim.stop_time(start) <= RAMP + MARGIN
    assert sim.states() == SPIN
    assert_standstill(sim)


class TestOneLine:
    """Tests that do not depend on the line speed."""

    @pytest.fixture(params=BAUDS[1:2])
    def baud(self, request: pytest.FixtureRequest) -> int:
        return int(request.param)

    def test_reader(self, baud: int) -> None:
        """A second client starts and stops to read."""
        sim = LineSimulation(chosen_level(), baud)
        sim.enable()
        write_speed = sim.reach_speed(SPEED)
        start = sim.now
        sim.run(0.3, write_speed)
        sim.run(0.5, write_speed, sim.host.read_snapshot)
        sim.run(0.3, write_speed)
        _, omega = sim.since(start, sim.line.log.omega)
        assert np.abs(omega - SPEED).max() < 0.05 * SPEED
        sim.close()

    @pytest.mark.parametrize(
        ("name", "raw"),
        [("cmd.mode", 9), ("cmd.enable", 2), ("param.feedback", 9), ("param.monitor", 99), ("param.host_timeout", 0)],
    )
    def test_value_out_of_range(self, sim: LineSimulation, name: str, raw: int) -> None:
        before = sim.board.read_words(name)
        with pytest.raises(StatusError, match="outside"):
            sim.host.write_raw(name, raw)
        assert sim.board.read_words(name) == before
        assert_standstill(sim, 0.2)
