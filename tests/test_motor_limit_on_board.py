"""Automatic actions of the drive keep the current limit of a small motor; the current is that of the plant."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import pytest
from servo_msgs_py.board_port import choose, place, write_axis
from servo_msgs_py.text_file import read_toml
from servo_msgs_py.units import PERIOD_NS
from servo_tuning.reading import SERVO_TOML
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig
from servo_twin.validation.experiments.rig import fresh_board

LIMIT: Final = 1.0
"""Current limit of the motor of axis 1 [A]."""

RIPPLE: Final = 0.06
"""Permitted deviation of the controlled current: noise, dead time, overshoot [A]."""


@pytest.fixture(scope="module")
def small_motor() -> ServoConfig:
    """Committed configuration with a 1 A motor on axis 1."""
    table: dict[str, Any] = read_toml(SERVO_TOML)
    table["axis1"].setdefault("limits", {})["current"] = LIMIT
    table["axis1"].setdefault("rotor_search", {})["current"] = LIMIT
    return ServoConfig.of_table(table)


def largest(board: Board, seconds: float, end: Callable[[], bool]) -> float:
    """Largest current of axis 1 until the end, sampled twice per period [A]."""
    current, start = 0.0, board.time_ns
    while board.time_ns - start < seconds * 1e9:
        for _ in range(16):
            board.advance(board.time_ns + PERIOD_NS // 2)
            truth = board.truth(0)
            current = max(current, math.hypot(truth.i_d, truth.i_q))
        if end():
            return current
    raise AssertionError(f"not within {seconds} s: {place(board, 0)}")


@pytest.mark.parametrize("start", [0.0, 0.4, math.pi / 2.0, 2.5])
def test_the_rotor_search_stays_within_the_limit_of_the_motor(small_motor: ServoConfig, start: float) -> None:
    plant = PlantConfig.load().with_axis(0, theta_start=start)
    with fresh_board(plant, 3, small_motor) as board:
        board.run(0.1)
        write_axis(board, "cmd.enable", 0, 1)
        current = largest(board, 5.0, lambda: place(board, 0) == "SPIN")
    assert 0.5 * LIMIT < current <= LIMIT + RIPPLE


def test_failed_rotor_search_stays_within_the_limit_of_the_motor(small_motor: ServoConfig) -> None:
    """All phases of the search with full current: pulls in three directions and rotation of the vector."""
    with fresh_board(PlantConfig.load(), 3, small_motor) as board:
        board.lock_shaft(0)
        board.run(0.1)
        write_axis(board, "cmd.enable", 0, 1)
        current = largest(board, 5.0, lambda: place(board, 0) == "FAULT")
    assert LIMIT - RIPPLE < current <= LIMIT + RIPPLE


def test_stall_test_stays_within_the_limit_of_the_motor(small_motor: ServoConfig) -> None:
    with fresh_board(PlantConfig.load(), 3, small_motor) as board:
        board.run(0.1)
        write_axis(board, "cmd.enable", 0, 1)
        largest(board, 5.0, lambda: place(board, 0) == "SPIN")
        board.write("param.command_timeout", 0.0)
        board.lock_shaft(0)
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, 100.0)
        current = largest(board, 5.0, lambda: place(board, 0) == "FAULT")
    assert LIMIT - RIPPLE < current <= LIMIT + RIPPLE


def test_sensorless_start_stays_within_the_limit_of_the_motor(small_motor: ServoConfig) -> None:
    with fresh_board(PlantConfig.load(), 3, small_motor) as board:
        board.write("param.command_timeout", 0.0)
        board.write_raw("param.feedback", [1, 0])
        board.run(0.1)
        write_axis(board, "cmd.enable", 0, 1)
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, 150.0)
        current = largest(board, 5.0, lambda: place(board, 0) == "SPIN")
        current = max(current, largest(board, 0.5, lambda: board.truth(0).omega_m > 140.0))
    assert 0.25 * LIMIT < current <= LIMIT + RIPPLE
