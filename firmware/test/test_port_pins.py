"""Switches, enable input and holding brake of the port: pins, registers and safe levels."""

from __future__ import annotations

import pytest
from firmware_compiler import CompileC
from port_board import GPIO, PWM, FakeBoard

HOME, LIMIT_MIN, LIMIT_MAX, ENABLE = 1, 2, 4, 8
RAWDATA = GPIO["F"] + 0xA
DR, DDR, PER, PUR, PUS = 1, 2, 3, 0, 0xC
FSTS0 = 0xC7
DISMAP0 = 0x16


@pytest.fixture
def board(compile_c: CompileC) -> FakeBoard:
    return FakeBoard(compile_c)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("pin", "bit", "active_high"), [(0, HOME, False), (1, LIMIT_MIN, True), (2, LIMIT_MAX, True)])
def test_a_switch_has_its_pin_and_its_safe_level(
    board: FakeBoard, axis: int, pin: int, bit: int, active_high: bool
) -> None:
    mine = 1 << (3 * axis + pin)
    for level in (False, True):
        board[RAWDATA] = 0xFFFF & ~mine | (mine if level else 0)
        assert bool(board.lib.hal_inputs(board.hal, axis) & bit) == (level == active_high)
        board[RAWDATA] = mine if level else 0
        assert bool(board.lib.hal_inputs(board.hal, axis) & bit) == (level == active_high)


@pytest.mark.parametrize("axis", [0, 1])
def test_cut_wires_read_as_active_limits_and_not_enabled(board: FakeBoard, axis: int) -> None:
    """All pins have pull-ups: a cut wire reads high."""
    assert board[GPIO["F"] + PUR] & 0x203F == board[GPIO["F"] + PUS] & 0x203F == 0x203F
    assert board[GPIO["E"] + PUR] & 0x200 == board[GPIO["E"] + PUS] & 0x200 == 0x200
    assert board[GPIO["F"] + DDR] & 0x203F == 0
    board[RAWDATA] = 0xFFFF
    board[PWM[axis] + FSTS0] = 0x0232  # FFPIN 1, FFULL, flag 1
    assert board.lib.hal_inputs(board.hal, axis) == LIMIT_MIN | LIMIT_MAX


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("fsts", "closed"), [(0x0030, True), (0x0032, False), (0x0230, False), (0x0131, True)])
def test_the_enable_input_is_closed_without_its_flag_and_its_pin(
    board: FakeBoard, axis: int, fsts: int, closed: bool
) -> None:
    board[PWM[axis] + FSTS0] = fsts  # last one: an over-current, which is another fault
    assert bool(board.lib.hal_inputs(board.hal, axis) & ENABLE) == closed
    board[PWM[1 - axis] + FSTS0] = 0x0030
    assert board.lib.hal_inputs(board.hal, 1 - axis) & ENABLE


@pytest.mark.parametrize("axis", [0, 1])
def test_an_enable_input_in_use_opens_all_switches_of_its_axis(board: FakeBoard, axis: int) -> None:
    board.forget()
    board.lib.hal_enable_input(board.hal, axis, True)
    assert [board[PWM[axis] + 0x30 * sm + DISMAP0] & 0xFF for sm in range(3)] == [0x33] * 3
    assert board.writes[-1] == (PWM[axis] + FSTS0, 0x0032)  # FFULL stays set; only its own flag is cleared
    assert {address & 0xFF00 for address, _ in board.writes} == {PWM[axis]}
    board.lib.hal_enable_input(board.hal, axis, False)
    assert [board[PWM[axis] + 0x30 * sm + DISMAP0] & 0xFF for sm in range(3)] == [0x11] * 3


def test_clearing_an_over_current_does_not_close_the_enable_input(board: FakeBoard) -> None:
    board.forget()
    board.lib.hal_over_current_clear(board.hal, 0)
    assert all(value & 0x0002 == 0 for value in board.writes_of(PWM[0] + FSTS0))


def test_each_holding_brake_has_its_pin(board: FakeBoard) -> None:
    port = GPIO["D"]
    assert board[port + DR] & 0x60 == 0
    assert board[port + DDR] & 0x60 == 0x60
    board.lib.hal_holding_brake(board.hal, 0, True)
    assert board[port + DR] & 0x60 == 0x20
    board.lib.hal_holding_brake(board.hal, 1, True)
    assert board[port + DR] & 0x60 == 0x60
    board.lib.hal_holding_brake(board.hal, 0, False)
    assert board[port + DR] & 0x60 == 0x40


def test_the_brakes_are_closed_before_their_pins_are_outputs(compile_c: CompileC) -> None:
    board = FakeBoard(compile_c, initialised=False)
    board[GPIO["D"] + DR] = 0xFFFF
    board.forget()
    assert board.init()
    writes = [address for address, _ in board.writes]
    assert writes.index(GPIO["D"] + DR) < writes.index(GPIO["D"] + DDR)
