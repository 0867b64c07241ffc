"""Mode TEST and test signals on the virtual board: current, rotor angle and speed."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_twin.board import Board
from servo_twin.level import Level

LEVELS: tuple[Level, ...] = ("ideal", "registers")


@pytest.fixture(params=LEVELS)
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """Both axes in TEST."""
    with Board(level=request.param, seed=5) as board:
        board.write("param.command_timeout", 0.0)
        board.run(0.05)
        board.write("cmd.mode", [board.catalogue.enums["control_mode_t"]["TEST"]] * 2)
        board.write("cmd.enable", [1, 1])
        board.run(0.3)
        assert all(board.read(f"axis{k}.substate") == board.catalogue.enums["substate_t"]["TEST"] for k in (1, 2))
        yield board


def signal(board: Board, point: str, amplitude: float, step: float, calls: int) -> None:
    """Start a test signal on both axes."""
    board.write("cmd.test_amplitude", [amplitude] * 2)
    board.write("cmd.test_step", [step] * 2)
    board.write("cmd.test_growth", [0.0] * 2)
    board.write("cmd.test_calls", [calls] * 2)
    board.write_raw("cmd.test_point", [board.catalogue.enums["test_point_t"][point]] * 2)


def sampled(board: Board, *names: str, seconds: float) -> list[NDArray[np.float64]]:
    """Variables of every PWM period, SI."""
    variables = [board.catalogue.variables[name] for name in names]
    board.sample(0, [(variable, 0) for variable in variables], round(seconds * 16000))
    board.run(seconds)
    log = board.sampled()
    board.end_sampling()
    return [variable.lsb * log[f"{variable.name}[0]"].astype(float) for variable in variables]


def test_the_rotor_follows_the_vector(board: Board) -> None:
    board.write("cmd.i_q", [1.5, 2.0])
    board.run(0.6)
    for axis, current in ((0, 1.5), (1, 2.0)):
        truth = board.truth(axis)
        assert truth.i_d == pytest.approx(current, rel=0.05)
        assert abs(truth.i_q) < 0.25 * current  # the vector's angle: friction holds the rotor back a little
        assert abs(math.remainder(2 * truth.theta_m, 2.0 * math.pi)) < 0.25
    before = [board.truth(axis).theta_m for axis in (0, 1)]
    board.write("cmd.speed", [6.0, -6.0])
    board.run(1.0)
    after = [board.truth(axis).theta_m for axis in (0, 1)]
    assert after[0] - before[0] == pytest.approx(6.0, rel=0.05)
    assert after[1] - before[1] == pytest.approx(-6.0, rel=0.05)


@pytest.mark.parametrize("point", ["I_D", "I_Q"])
def test_test_signal_is_in_the_current(board: Board, point: str) -> None:
    """0.4 A at 100 Hz, well within the bandwidth of the current controllers."""
    board.write("cmd.i_q", [1.5, 1.5])
    board.run(0.6)
    signal(board, point, 0.4 / 8.25, 100.0 / 16000.0, 1600)
    i_d, i_q, value = sampled(board, "axis1.i_d", "axis1.i_q", "axis1.test_signal", seconds=0.06)
    reference = value[160:] * 8.25
    excited, other = (i_d, i_q) if point == "I_D" else (i_q, i_d)
    part = float(np.dot(excited[160:] - excited[160:].mean(), reference) / np.dot(reference, reference))
    assert part == pytest.approx(1.0, abs=0.1)
    assert np.std(other[160:]) < 0.1


@pytest.mark.parametrize("point", ["I_D", "I_Q"])
def test_vector_and_signal_stay_within_the_current_limit(board: Board, point: str) -> None:
    board.write("param.i_q_limit", [2.0, 2.0])
    board.write("cmd.i_q", [1.2, 1.2])
    board.run(0.6)
    signal(board, point, 0.5, 100.0 / 16000.0, 3200)
    i_d, i_q = sampled(board, "axis1.i_d", "axis1.i_q", seconds=0.1)
    assert 1.8 < np.hypot(i_d, i_q).max() < 2.3


def test_a_signal_on_the_speed_turns_the_shaft(board: Board) -> None:
    board.write("cmd.enable", [0, 0])
    board.run(0.1)
    board.write("cmd.mode", [board.catalogue.enums["control_mode_t"]["SPEED"]] * 2)
    board.write("cmd.enable", [1, 1])
    board.run(3.0)
    board.write("cmd.speed", [50.0, 50.0])
    board.run(0.3)
    signal(board, "SPEED", 10.0 / 523.6, 5.0 / 2000.0, 2000)
    speed, reference = sampled(board, "axis1.speed", "axis1.speed_ref", seconds=0.6)
    assert np.ptp(reference[3200:]) == pytest.approx(20.0, rel=0.05)
    assert np.ptp(speed[3200:]) == pytest.approx(20.0, rel=0.25)
    assert np.mean(speed[3200:6400]) == pytest.approx(50.0, rel=0.05)
