"""Safety of motion on the virtual board: no unintended motion, no runaway, no enable at the wrong time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from servo_msgs_py.board_port import active
from servo_twin.board import Board
from servo_twin.simulation import enable, move, record

pytestmark = pytest.mark.usefixtures("level")


@pytest.fixture
def board() -> Iterator[Board]:
    with Board(seed=11) as board:
        enable(board)
        yield board


def spin(board: Board, speed: float) -> None:
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [speed, speed])
    board.run(0.6)


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
        assert active(board, 0) == active(board, 1) == set()


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
        assert active(board, axis) == set()
