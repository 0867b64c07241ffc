"""Encoders with other lines, from the configuration of the axis to the twin."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.text_file import read_toml
from servo_msgs_py.units import TICK
from servo_tuning.checks import COUNT_TIME_FILTERS
from servo_tuning.reading import parse
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig
from servo_twin.simulation import enable, move
from servo_twin.validation.experiments import rig
from twin_rig import TwinRig, apart, worst, worst_counts

CONFIG: Final = Path(__file__).resolve().parents[2] / "firmware" / "config" / "servo.toml"
MOVE: Final = 20.0  # rad
PAIRS: Final = ((100, 1024), (2048, 2500), (4096, 16384), (8193, 10000))
"""Lines of both axes; with more than 8192 the counter reloads twice per turn."""
BANDWIDTH: Final = 25.0
"""Of the speed loop with 100 lines [Hz]: a higher one answers to one count with much current (`make tune` warns)."""


def table(lines: tuple[int, int]) -> Mapping[str, Any]:
    """``servo.toml`` with these encoders and the speeds that they permit."""
    result = copy.deepcopy(dict(read_toml(CONFIG)))
    for name, number in zip(("axis1", "axis2"), lines, strict=True):
        fastest = math.floor(2.0 * math.pi / (4 * number) / COUNT_TIME_FILTERS / BoardDescription.load().encoder_filter)
        result[name] |= {"encoder": {"lines": number}, "limits": {"speed": min(314.0, fastest)}}
        if number == min(LINES):
            result[name]["control"] = {"speed_bandwidth": BANDWIDTH, "position_gain": 20.0}
    return result


LINES: Final = {number for pair in PAIRS for number in pair}


def plant_of(lines: tuple[int, int]) -> PlantConfig:
    plant = PlantConfig.load()
    for axis, number in enumerate(lines):
        plant = plant.with_axis(axis, encoder_lines=float(number))
    return plant


@pytest.mark.parametrize("level", ["ideal", "registers"])
@pytest.mark.parametrize("lines", PAIRS)
def test_any_encoder_moves_the_shaft_to_its_set_point(lines: tuple[int, int], level: Any) -> None:
    """20 rad in opposite directions: the true angle is within the rest band, counts of the encoder or the contract."""
    configuration = parse(table(lines), Catalogue.load())
    with Board(plant_of(lines), level=level, seed=3, servo=ServoConfig.of(configuration)) as board:
        enable(board)
        start = [board.truth(axis).theta_m for axis in range(AXES)]
        before = [board.read_words(f"axis{axis + 1}.position")[0] for axis in range(AXES)]
        counts = round(MOVE / (2.0 * math.pi) * 4000)
        moves, _ = move(board, {0: before[0] + counts, 1: before[1] - counts}, 1.5)
        for axis, (one, sign) in enumerate(zip(moves, (1, -1), strict=True)):
            resolution = 2.0 * math.pi / min(4 * lines[axis], 4000)
            assert sign * (board.truth(axis).theta_m - start[axis]) == pytest.approx(MOVE, abs=3.0 * resolution)
            assert abs(one.reached - one.target) <= 2.5 * resolution / (2.0 * math.pi / 4000)
            assert board.read_words(f"axis{axis + 1}.faults") == [0]


def test_dither_of_a_coarse_encoder_is_no_oscillation() -> None:
    """The gains of 1000 lines answer to one count of 100 lines with ten times the current."""
    lines = (100, 100)
    configured = dict(table(lines))
    for name in ("axis1", "axis2"):
        del configured[name]["control"]
    servo = ServoConfig.of(parse(configured, Catalogue.load()))
    with rig.at_level("registers"), rig.fresh_board(plant_of(lines), 3, servo) as board:
        enable(board)

        def act(tick: int) -> None:
            if tick % 20 == 0:
                for axis in range(AXES):
                    write_axis(board, "cmd.position", axis, 0.5 * math.sin(2.0 * math.pi * 5.0 * tick * TICK))

        for recorded in rig.record(board, range(AXES), 1.5, act).values():
            assert np.ptp(recorded["i_q"]) > 2.0
            assert not recorded["oscillation"].any()


@pytest.mark.parametrize("lines", PAIRS)
def test_twin_with_the_same_encoders_has_no_residual(lines: tuple[int, int]) -> None:
    """The twin follows to the bit."""
    configuration = parse(table(lines), Catalogue.load())
    plant = plant_of(lines)
    servo = ServoConfig.of(configuration)
    with TwinRig(real_seed=7, twin_seed=7, plant=plant, twin_plant=plant, servo=servo) as rig:
        rig.enable_axes()
        turns = MOVE / (2.0 * math.pi)
        pairs = rig.move([turns, -turns], 1.0)
        assert worst_counts(pairs) == 0.0
        assert worst(pairs, "axis2.i_q") == 0.0
        assert apart(pairs) == []
        assert pairs[-1].real["axis1.position"] == pytest.approx(MOVE, abs=0.04)
