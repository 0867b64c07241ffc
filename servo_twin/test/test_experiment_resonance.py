"""Loads on a spring, and the reaction of the drive to a current that oscillates for other reasons."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from servo_msgs_py.board_port import active, choose, first_fault, word, write_axis, write_word
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.units import TICK
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.sprung_load import SprungLoad
from servo_twin.validation.experiments import resonance, rig

CASE = SprungLoad(150.0, 3.0, 0.02)
SEED = 3


@pytest.fixture
def plant() -> PlantConfig:
    return PlantConfig.load()


@pytest.fixture
def board(plant: PlantConfig) -> Iterator[Board]:
    with rig.spinning(plant, SEED) as spinning:
        yield spinning


def limited(board: Board) -> bool:
    return "OSCILLATION" in active(board, 0, "limits")


def test_every_load_becomes_quiet(plant: PlantConfig) -> None:
    outcome = resonance.run(plant, SEED)
    assert outcome.agrees, [row.name for row in outcome.rows if not row.agrees]
    assert sum("time until found" in row.name for row in outcome.rows) >= 12


def test_the_gains_are_full_again_after_enabling(plant: PlantConfig) -> None:
    """Disabling does not forget; the next enabling does, and the oscillation is found anew."""
    soft = replace(plant, axes=(CASE.of(plant.axes[0]), CASE.of(plant.axes[1])))
    with rig.spinning(soft, SEED) as board:
        write_axis(board, "cmd.position", 0, 30.0)
        board.run(1.0)
        assert limited(board)
        frequency = word(board, 0, "oscillation")
        write_word(board, "cmd.enable", 0, 0)
        board.run(1.5)
        assert word(board, 0, "oscillation") == frequency
        write_word(board, "cmd.enable", 0, 1)
        board.run(0.05)
        rig.until(board, "enabled", lambda: word(board, 0, "oscillation") == 0 and not limited(board), 5.0)


def test_dither_at_a_low_current_limit_is_no_oscillation(plant: PlantConfig) -> None:
    """The dead time makes the current dither by more than the limit."""
    limit = 0.1
    with rig.at_level("registers"), rig.spinning(plant, SEED) as board:
        for axis in range(AXES):
            write_axis(board, "param.i_q_limit", axis, limit)
            write_axis(board, "cmd.position", axis, 31.4)
        for recorded in rig.record(board, range(AXES), 1.2).values():
            assert np.ptp(recorded["i_q"]) > limit
            assert not recorded["oscillation"].any()


def shaken(board: Board, ticks: int, act: Callable[[float], None], frequency: float = 60.0) -> None:
    """Call `act` with a sine."""
    for k in range(ticks):
        act(math.sin(2.0 * math.pi * frequency * k * TICK))
        board.run(TICK)


def test_a_large_oscillation_from_outside_ends_in_a_fault(board: Board, plant: PlantConfig) -> None:
    """Reduced gains do not end it."""
    torque = 4.0 * plant.axes[0].torque_constant
    shaken(board, 2800, lambda sine: board.set_load(0, torque * sine))
    assert first_fault(board, 0) == "OSCILLATION"
    assert not active(board, 1)
    assert word(board, 0, "oscillation") == pytest.approx(60, abs=3)


def test_cogging_is_named_and_the_gains_are_full_again(board: Board) -> None:
    """Cogging forces 12 periods per turn; the speed varies as without the trial of smaller gains."""
    board.set_plant("axis1.cogging_periods", 12)
    board.set_plant("axis1.cogging_torque", 0.03)
    rig.faults(board, 0, OSCILLATION=False)
    rig.set_up(board, 0, "SPEED", 2.0 * math.pi * 5.0)
    board.run(0.4)
    before = float(np.std(rig.record(board, [0], 0.4)[0]["omega"]))
    assert not limited(board)
    rig.faults(board, 0, OSCILLATION=True)
    variation = [float(np.std(rig.record(board, [0], 0.2)[0]["omega"])) for _ in range(8)]
    assert limited(board)
    assert not active(board, 0)
    assert word(board, 0, "oscillation") == pytest.approx(60, abs=3)
    assert max(variation) > 1.1 * before  # with an eighth of the gains
    assert variation[-1] == pytest.approx(before, rel=0.05)


def test_a_commanded_current_is_not_an_oscillation(board: Board) -> None:
    choose(board, "cmd.mode", 0, "TORQUE")
    currents: list[int] = []

    def act(sine: float) -> None:
        write_axis(board, "cmd.i_q", 0, 1.5 * sine)
        currents.append(word(board, 0, "i_q"))

    shaken(board, 2000, act)
    assert max(currents) - min(currents) > 2 * board.read_words("param.i_q_limit")[0] // 4
    assert word(board, 0, "oscillation") == 0
    assert not active(board, 0)
