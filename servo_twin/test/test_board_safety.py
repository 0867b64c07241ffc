"""Safety of motion on the virtual board: no unintended motion, no runaway, no enable at the wrong time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from servo_msgs_py.catalogue import numbers
from servo_msgs_py.units import SLOW_PERIODS
from servo_twin.board import Board
from servo_twin.simulation import enable, move, record
from servo_twin.validation.experiments.named_faults import fault_record, faults

pytestmark = pytest.mark.usefixtures("level")

FAULT, STOP, RUN = 0, 2, 3
SPIN = 3
FULL_CURRENT = 4.0


@pytest.fixture
def board() -> Iterator[Board]:
    with Board(seed=11) as board:
        enable(board)
        yield board


def spin(board: Board, speed: float) -> None:
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [speed, speed])
    board.run(0.6)


def test_record_ends_at_the_fault_and_not_at_the_end_of_its_ramp(board: Board) -> None:
    spin(board, 200.0)
    board.write("param.acceleration_limit", [1000.0, 1000.0])
    board.write("param.host_timeout", 0.4)
    board.serial_in(bytes.fromhex("2B 30 01 04 E8"))  # a host that sends one command: SENDAPPCMD KEEP_ALIVE ..
    board.run(0.01)
    board.serial_in(bytes.fromhex("2B 31 00 EC"))  # .. GETAPPCMDSTS
    board.run(0.35)
    assert faults(board, 0) == set()
    while not faults(board, 0):
        board.run(0.0005)
    captured = board.read_raw("tick")[0]
    assert board.read_raw("axis1.state")[0] == RUN, "the ramp has just begun"
    while board.read_raw("axis1.state")[0] != FAULT:
        board.run(0.001)
    assert board.read_raw("tick")[0] - captured > 0.15 * 16000
    record = fault_record(board, 0)
    assert (record.fault and record.fault.name, record.place) == ("HOST_SILENT", "RUN/SPIN")
    assert 0 <= captured - record.tick < 2 * SLOW_PERIODS, "between two snapshots"
    speeds = record.table[:, -1]
    assert speeds.size == 64
    assert speeds.min() > 190.0, "before the ramp"


def test_enable_waits_for_a_coasting_shaft(board: Board) -> None:
    spin(board, 300.0)
    board.set_supply(10.0)
    while board.read_raw("axis1.state") != [FAULT]:
        board.run(0.002)
    board.set_supply(24.0)
    board.run(0.05)
    board.write("cmd.clear_faults", [1, 1])
    board.run(0.02)
    assert board.read_raw("axis1.state") == [STOP]
    assert board.truth(0).omega_m > 150.0
    board.write("cmd.enable", [1, 1])
    while abs(board.truth(0).omega_m) > 5.0:
        board.run(0.0005)
        truth = board.truth(0)
        assert max(abs(truth.i_d), abs(truth.i_q)) < 1.0  # a winding short would brake with more than 5 A
    board.run(3.0)
    assert board.read_raw("axis1.substate") == [SPIN]
    assert board.stats().breaks == 0


@pytest.mark.parametrize(
    ("gap", "fault", "within"),
    [
        (0.004, "ANGLE_MISMATCH", 0.015),  # angle error of 92 degrees; filter of 2 ms and five slow ticks
        (0.007, "ENCODER_LOST", 0.007),  # 2 ms without a count, 4 ms of rotating voltage, one slow tick
        (0.010, "ENCODER_LOST", 0.007),
        (0.016, "ENCODER_LOST", 0.007),
        (0.050, "ENCODER_LOST", 0.007),
    ],
)
@pytest.mark.parametrize("speed", [200.0, -200.0])
def test_slipped_encoder_causes_a_fault_and_no_runaway(
    board: Board, gap: float, fault: str, within: float, speed: float
) -> None:
    spin(board, speed)
    board.connect_encoder(0, False)
    board.run(min(gap, within))
    if gap < within:
        board.connect_encoder(0, True)
        board.run(within - gap)
    assert faults(board, 0) == {fault}
    board.run(gap - min(gap, within))
    board.connect_encoder(0, True)
    board.run(0.1)
    assert board.read_raw("axis1.state") == [FAULT]
    assert faults(board, 0) == {fault}
    assert board.read_raw("axis2.state") == [RUN]  # the other axis continues


def test_dead_encoder_causes_a_fault(board: Board) -> None:
    spin(board, 100.0)
    board.connect_encoder(0, False)
    board.run(0.7)
    assert (board.read_raw("axis1.state"), faults(board, 0)) == ([FAULT], {"ENCODER_LOST"})


@pytest.mark.parametrize("command", [("cmd.quick_stop", 1), ("cmd.enable", 0)])
def test_a_stop_obeys_the_acceleration_limit(board: Board, command: tuple[str, int]) -> None:
    spin(board, 300.0)
    board.write("param.acceleration_limit", [1000.0, 1000.0])
    board.write_raw(command[0], [command[1]] * 2)
    board.run(0.15)
    for axis in range(2):
        assert board.truth(axis).omega_m == pytest.approx(150.0, abs=10.0)
    board.run(0.25)
    for axis in range(2):
        assert abs(board.truth(axis).omega_m) < 5.0


@pytest.mark.parametrize("acceleration", [50.0, 4000.0])
def test_a_lower_speed_limit_slows_down_and_is_no_fault(board: Board, acceleration: float) -> None:
    spin(board, 300.0)
    board.write("param.acceleration_limit", [acceleration] * 2)
    board.write("param.speed_limit", [100.0, 100.0])
    board.run(5.0)
    assert faults(board, 0) == faults(board, 1) == set()
    assert board.read("axis1.speed") == pytest.approx(100.0, abs=2.0)


def test_torque_ends_at_the_speed_limit(board: Board) -> None:
    board.write("cmd.mode", [2, 2])
    board.write("cmd.i_q", [1.0, 1.0])
    board.run(1.0)
    assert faults(board, 0) == set()
    assert 290.0 < board.truth(0).omega_m < 330.0


@pytest.mark.parametrize("i_q", [0.3, 0.5, 1.0])
def test_lower_current_limit_slows_moves_without_overshoot(board: Board, i_q: float) -> None:
    board.write("param.i_q_limit", [i_q, i_q])
    board.run(0.01)
    results, log = move(board, {0: 20000, 1: -20000}, 4.0)
    maximum = 2 if board.level == "ideal" else 5  # with 0.3 A one of 32 boards stopped 4 counts off
    for result in results:
        assert result.overshoot <= maximum
        assert result.steady_state <= maximum
    assert np.abs(board.si(log)["axis1.i_q_ref"]).max() <= i_q + 1e-3


def test_full_reversals_at_the_current_limit_are_no_runaway(board: Board) -> None:
    board.write("param.i_q_limit", [0.3, 0.3])
    board.write("param.acceleration_limit", [50000.0, 50000.0])
    for speed in (300.0, -300.0, 300.0):
        spin(board, speed)
        board.run(0.4)
        assert faults(board, 0) == faults(board, 1) == set()


def test_enable_of_a_turning_shaft_does_not_take_effect_later() -> None:
    with Board(seed=3) as board:
        board.run(0.03)
        board.set_load(0, -0.0025)  # more than the friction: an external torque keeps the shaft rotating
        board.run(0.5)
        board.write("cmd.enable", [1, 0])
        board.run(1.0)
        assert board.read_raw("axis1.state") == [RUN]  # waits in CALIB, outputs off
        board.run(26.0)
        assert board.read_raw("axis1.state") == [STOP]
        board.set_load(0, 0.0)
        board.run(10.0)
        assert board.read_raw("axis1.state") == [STOP]


def test_rotor_search_fails_with_a_blocked_shaft() -> None:
    """The shaft is blocked after its first movement, at different rotor angles."""
    for delay in (0.105, 0.11, 0.12, 0.13):
        with Board(seed=int(delay * 1e4)) as board:
            board.run(0.03)
            board.write("cmd.enable", [1, 0])
            board.run(0.14 + delay)
            board.lock_shaft(0)
            board.run(2.5)
            if board.read_raw("axis1.state") == [RUN]:
                assert board.read_raw("axis1.substate") == [SPIN], "the search has ended"
                theta = 2.0 * board.truth(0).theta_m
                (found,) = numbers(board.read("axis1.theta_e"))
                error = (found - theta + np.pi) % (2.0 * np.pi) - np.pi
                assert abs(error) < np.radians(35.0)
            else:
                assert faults(board, 0) <= {"ROTOR_SEARCH", "STALLED"}


BACK_MAX = 16
"""Reverse motion permitted after the end of a ramp [counts]; at most 12 on sixty boards."""


@pytest.mark.parametrize(("i_q", "acceleration"), [(4.0, 4000.0), (0.5, 4000.0), (0.2, 4000.0), (4.0, 50000.0)])
def test_stop_does_not_reverse_the_shaft(board: Board, i_q: float, acceleration: float) -> None:
    """With a low current limit or a steep ramp the shaft still rotates fast at the end of the ramp."""
    spin(board, 300.0)
    board.write("param.i_q_limit", [i_q, i_q])
    board.write("param.acceleration_limit", [acceleration, acceleration])
    board.run(0.001)
    board.write("cmd.quick_stop", [1, 1])
    log = record(board, 3.0)
    for axis in (0, 1):
        position = log[f"axis{axis + 1}.position"].astype(np.int64)
        assert position.max() - position[-1] <= BACK_MAX
        assert faults(board, axis) == set()
