"""The record of a first fault against the true signals of the axis before it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from servo_msgs_py.board_port import active
from servo_msgs_py.fault_record import FaultRecord
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD
from servo_twin.board import Board
from servo_twin.fault_injection import HotPowerStage, OpenPhase, ShortedPhase
from servo_twin.simulation import enable
from servo_twin.validation.experiments.named_faults import fault_record

pytestmark = pytest.mark.usefixtures("level")

AXES = pytest.mark.parametrize("axis", [0, 1])


@pytest.fixture
def board() -> Iterator[Board]:
    with Board(seed=4) as board:
        enable(board)
        yield board


def apply_torque(board: Board, axis: int, i_q: float) -> None:
    """Lock the shaft of an axis and apply a torque."""
    board.lock_shaft(axis)
    board.write("cmd.mode", [2, 2])
    board.write("cmd.i_q", [i_q if k == axis else 0.0 for k in range(2)])


def fault(record: FaultRecord) -> str:
    return record.fault.name if record.fault else ""


@AXES
def test_record_contains_the_currents_of_the_32_ms_before_the_fault(board: Board, axis: int) -> None:
    """A known current, changed to another one 16 ms before an over-current; the shaft is locked."""
    apply_torque(board, axis, 0.5)
    board.run(0.05)
    theta = board.truth(axis).theta_m * board.plant.axes[axis].pole_pairs
    changed = board.time_ns * 1e-9
    apply_torque(board, axis, -1.5)
    board.run(0.016)
    broken = board.time_ns * 1e-9
    board.inject(ShortedPhase(axis, "a"))
    board.run(0.01)
    it = fault_record(board, axis)
    assert (fault(it), it.place, len(it.samples)) == ("OVER_CURRENT", "RUN/SPIN", 64)
    assert broken <= it.seconds < broken + 0.001
    time, i_q = it.seconds + it.samples["time"], it.samples["i_q"]
    before = time < changed
    after = (time > changed + 0.0015) & (time < broken)  # latched within 0.5 ms, and the current loop takes 1 ms
    assert before.sum() >= 30
    assert after.sum() >= 28
    noise = 7.5 * board.plant.axes[axis].i_noise
    np.testing.assert_allclose(i_q[before], 0.5, atol=noise)
    np.testing.assert_allclose(i_q[after], -1.5, atol=noise)
    np.testing.assert_allclose(it.samples["i_d"][before | after], 0.0, atol=noise)
    third = 2.0 * math.pi / 3.0
    assert it.samples["i_a"][after].mean() == pytest.approx(1.5 * math.sin(theta), abs=0.02)
    assert it.samples["i_b"][after].mean() == pytest.approx(1.5 * math.sin(theta - third), abs=0.02)


@AXES
@pytest.mark.parametrize("name", ["UNDER_VOLTAGE", "PHASE_LOST"])
def test_times_of_the_samples_agree_with_the_motion_of_the_shaft(board: Board, axis: int, name: str) -> None:
    """Electrical revolutions of 31 ms; faults raised by a monitor and by another check."""
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [100.0, -100.0])
    board.run(0.2)
    if name == "PHASE_LOST":
        board.inject(OpenPhase(axis, "b"))
    else:
        board.set_load(axis, math.copysign(0.05, board.truth(axis).omega_m))
        board.set_supply(8.0)
    truth = []
    for _ in range(round(0.4 / PERIOD)):
        board.run(PERIOD)
        now = board.truth(axis)
        truth.append((board.time_ns * 1e-9, now.theta_m, now.omega_m, now.u_dc))
    it = fault_record(board, axis)
    assert fault(it) == name
    moment, theta, omega, u_dc = np.array(truth).T
    time = it.seconds + it.samples["time"]
    seen = time > moment[0] + 2.0 * PERIOD
    assert seen.sum() >= 8
    pole_pairs = board.plant.axes[axis].pole_pairs
    wrong = it.samples["theta_e"] - pole_pairs * np.interp(time, moment, theta)
    wrong = (wrong + math.pi) % (2.0 * math.pi) - math.pi
    # An angle is read in the middle of its period; the monitors of axis 2 run before it is read again.
    maximum = pole_pairs * (2.0 * PERIOD * 100.0 * 1.05 + 2.0 * math.pi / COUNTS_PER_TURN)
    np.testing.assert_array_less(np.abs(wrong[seen]), maximum)
    np.testing.assert_allclose(it.samples["speed"][seen], np.interp(time, moment, omega)[seen], atol=3.0)
    np.testing.assert_allclose(it.samples["u_dc"][seen], np.interp(time, moment, u_dc)[seen], atol=0.25)


@AXES
def test_a_second_fault_does_not_overwrite_the_first(board: Board, axis: int) -> None:
    apply_torque(board, axis, 0.5)
    board.run(0.05)
    board.inject(HotPowerStage(axis, 120.0))
    board.run(0.01)
    first = fault_record(board, axis)
    assert fault(first) == "OVER_TEMPERATURE"
    board.set_supply(36.0)
    board.run(0.05)
    assert active(board, axis) == {"OVER_TEMPERATURE", "OVER_VOLTAGE"}
    later = fault_record(board, axis)
    assert (later.fault, later.tick, later.place) == (first.fault, first.tick, first.place)
    np.testing.assert_array_equal(later.samples.table(), first.samples.table())


@AXES
def test_a_fault_after_clearing_is_a_first_one_again(board: Board, axis: int) -> None:
    apply_torque(board, axis, 0.5)
    board.run(0.05)
    short = ShortedPhase(axis, "a")
    board.inject(short)
    board.run(0.01)
    before = fault_record(board, axis)
    assert fault(before) == "OVER_CURRENT"
    board.clear_fault(short)
    board.run(0.05)
    board.write("cmd.clear_faults", [1, 1])
    board.run(0.05)
    assert board.read_words(f"axis{axis + 1}.faults") == [0]
    board.set_supply(36.0)
    while board.read_words(f"axis{axis + 1}.faults") == [0]:
        board.run(0.001)
    after = fault_record(board, axis)
    assert (fault(after), after.place, len(after.samples)) == ("OVER_VOLTAGE", "STOP", 64)
    assert after.tick > before.tick
    np.testing.assert_allclose(after.samples["i_q"], 0.0, atol=7.5 * board.plant.axes[axis].i_noise)
    assert after.samples["u_dc"][-1] > 32.5
