"""Contacts and holding brakes of the virtual board, at both levels, and their part of the plant file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from servo_msgs_py.units import PERIOD
from servo_twin.board import Board
from servo_twin.fault_injection import CutWire, StalledCore
from servo_twin.level import Level
from servo_twin.plant import PinsPlant, PlantConfig, PlantError
from servo_twin.simulation import enable
from servo_twin.validation.experiments.pins import fit

LEVELS = pytest.mark.parametrize("level", ["ideal", "registers"])
HOME, LIMIT_MIN, LIMIT_MAX, ENABLE, BRAKE_OPEN = (1 << bit for bit in range(5))


def board_with(level: Level, **pins: float) -> Board:
    plant = PlantConfig.load()
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, theta_start=0.5, pins=replace(entry.pins, **pins))
    board = Board(plant, seed=3, level=level)
    board.write("param.command_timeout", 0.0)
    board.run(0.03)
    return board


def inputs(board: Board, axis: int = 0) -> int:
    return board.read_words(f"axis{axis + 1}.inputs")[0]


@LEVELS
def test_an_open_enable_circuit_opens_the_switches_without_software(level: Level) -> None:
    with board_with(level) as board:
        fit(board, "enable")
        enable(board)
        board.write_raw("cmd.mode", [2, 2])
        board.lock_shaft(0)
        board.lock_shaft(1)
        board.write("cmd.i_q", [2.0, 2.0])
        board.run(0.05)
        assert board.truth(0).i_q > 1.8
        board.inject(CutWire(0, "enable"))
        board.run(3.0 * PERIOD)
        assert abs(board.truth(0).i_q) < 1e-3
        assert board.truth(1).i_q > 1.8
        board.clear_fault()  # closed again: the latch keeps the switches open until the firmware has read it
        board.run(0.005)
        assert abs(board.truth(0).i_q) < 1e-3
        assert [flag.name for flag in board.catalogue.active("faults", board.read_words("axis1.faults")[0])] == [
            "ENABLE_INPUT"
        ]


@LEVELS
def test_an_enable_circuit_that_is_not_fitted_opens_nothing(level: Level) -> None:
    with board_with(level, enable_closed=0.0) as board:
        enable(board)
        assert inputs(board) == 0


@LEVELS
def test_switches_are_where_the_plant_has_them(level: Level) -> None:
    with board_with(level, home_from=3.0, home_to=6.0, limit_min=-20.0, limit_max=10.0) as board:
        fit(board, "home", "limit_min", "limit_max")
        board.write_raw("param.faults_enabled", [0, 0])
        enable(board)
        board.write_raw("cmd.mode", [1, 1])
        board.write("cmd.speed", [20.0, 20.0])
        seen: dict[int, float] = {}
        for _ in range(700):
            board.run(0.001)
            seen.setdefault(inputs(board), board.truth(0).theta_m)
        late = 20.0 * 0.003  # the filter, and one reading per millisecond
        assert 3.0 - late <= seen[HOME] <= 3.0 + 2.0 * late
        assert 10.0 - late <= seen[LIMIT_MAX] <= 10.0 + 2.0 * late
        assert set(seen) == {0, HOME, LIMIT_MAX}


@LEVELS
def test_the_brake_takes_its_time_and_a_reset_closes_it(level: Level) -> None:
    with board_with(level, brake_torque=0.1, brake_open_time=0.02, brake_close_time=0.01) as board:
        assert board.truth(0).brake_holds == 1.0
        fit(board, "brake")
        enable(board)
        board.run(0.1)
        assert board.truth(0).brake_holds == 0.0
        assert inputs(board) == BRAKE_OPEN
        board.inject(CutWire(0, "brake"))
        board.run(0.008)
        assert board.truth(0).brake_holds == 0.0
        board.run(0.004)
        assert board.truth(0).brake_holds == 1.0
        assert board.truth(1).brake_holds == 0.0
        board.clear_fault()
        board.run(0.03)
        assert board.truth(0).brake_holds == 0.0
        board.inject(StalledCore(0.2))
        board.run(0.1)  # the watchdog takes 50 ms
        assert board.truth(0).brake_holds == board.truth(1).brake_holds == 1.0


@LEVELS
def test_closed_brake_holds_up_to_its_torque(level: Level) -> None:
    with board_with(level, brake_torque=0.05) as board:
        start = board.truth(0).theta_m
        board.set_load(0, 0.05)
        board.run(0.05)
        assert board.truth(0).theta_m == start  # with the friction of the shaft
        board.set_load(0, 0.06)
        board.run(0.05)
        assert board.truth(0).theta_m < start - 0.1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[axis1.pins]\nlimit_max = nan", "limit_max"),
        ("[axis1.pins]\nbrake_torque = -1.0", "brake_torque"),
        ("[axis2.pins]\nenable_closed = 2", "enable_closed"),
        ("[axis1.pins]\nlimit_mux = 3.0", "limit_mux"),
        ("[axis1]\npins = 3", "pins"),
    ],
)
def test_a_plant_file_with_impossible_pins_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PlantError, match=words):
        PlantConfig.load(path)


def test_plant_file_contains_only_differences(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text("[axis2.pins]\nlimit_max = 12.5\n", encoding="utf-8")
    plant = PlantConfig.load(path)
    assert plant.axes[0].pins == PinsPlant(brake_open_time=0.03, brake_close_time=0.02)
    assert plant.axes[1].pins.limit_max == 12.5
    assert math.isinf(plant.axes[1].pins.limit_min)


def test_missing_wire_cannot_be_cut() -> None:
    with pytest.raises(ValueError, match="none of home"):
        CutWire(0, "reset").raw()  # type: ignore[arg-type]
