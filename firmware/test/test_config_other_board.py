"""Tuning and plant on a board with other scales: the same values in SI, other raw numbers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest
from servo_msgs_py.board_description import DEFAULT_BOARD, VARIABLE

LAB: Final = """\
pwm_frequency  = 16000.0
dead_time      = 0.5e-6
switch_drop    = 0.1
timer_clock    = 1.0e6
encoder_filter = 100.0e-9
shunts = 2
low_side_time = 0.0
over_current = 0.0
flash_sectors = 2
flash_sector_words = 4096

[ranges]
bus_voltage = 62.7
current     = 41.25
"""
"""A board that does not exist."""

PROGRAM: Final = """
import json
import sys
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.text_file import read_toml
from servo_tuning.control_loops import control_loops
from servo_tuning.errors import ConfigError
from servo_tuning.reading import SERVO_TOML, parse
from servo_tuning.tuned import tuned
from servo_twin.board import Board
from servo_twin.board_memory import BoardError
from servo_twin.plant import PlantConfig

def entered(sign_current=0.5, **board):
    table = read_toml(SERVO_TOML)
    table["defaults"]["sensing"]["sign_current"] = sign_current
    table["board"] |= board
    try:
        return parse(table, Catalogue.load())
    except ConfigError as error:
        return str(error)

def refusal(configuration):
    if isinstance(configuration, str):
        return configuration
    try:
        tuned(configuration.axes[0], configuration)
    except ConfigError as error:
        return str(error)
    return ""

name, catalogue = sys.argv[1], Catalogue.load()
configuration = entered(name=name)
axis = tuned(configuration.axes[0], configuration)
loops, table = control_loops(axis.block), AxisConfigTable.load()
si = {path: table.value(path, axis.block) for path in ("i_q_limit", "speed_limit", "u_dc_max", "winding.resistance")}
gains = {"d": loops.used.current_d.kp, "q": loops.used.current_q.kp, "speed": loops.used.speed.kp}
plant = PlantConfig.load()
try:
    Board()
    virtual = ""
except BoardError as error:
    virtual = str(error)
print(json.dumps({
    "si": {**si, **gains, **vars(loops.motor)},
    "raw": axis.block,
    "hash": catalogue.hash,
    "plant": [plant.axes[1].i_full_scale, plant.bus.u_full_scale, plant.axes[0].dead_time],
    "virtual": virtual,
    "supply": refusal(entered(name=name, nominal_voltage=48.0, over_voltage=58.0)),
    "fine": refusal(entered(name=name, sign_current=0.08)),
    "default": refusal(entered(name="mc56f84789")),
}))
"""


def figures(board: str) -> Any:
    """Figures of a process for a board."""
    command = [sys.executable, "-c", PROGRAM, Path(board).stem]
    done = subprocess.run(command, env={**os.environ, VARIABLE: board}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_another_board_gives_the_same_values_with_other_scales(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(LAB, encoding="utf-8")
    lab, own = figures(str(file)), figures(DEFAULT_BOARD)
    assert lab["hash"] != own["hash"]
    assert lab["si"] == pytest.approx(own["si"], rel=2e-3)
    assert lab["raw"]["i_q_limit"] == pytest.approx(own["raw"]["i_q_limit"] * 8.25 / 41.25, abs=1)
    assert lab["raw"]["mt_speed.speed_per_ratio"] == pytest.approx(own["raw"]["mt_speed.speed_per_ratio"] * 1.28)
    assert lab["raw"]["current_loop.dead_time.duty"] == own["raw"]["current_loop.dead_time.duty"] // 2
    assert lab["plant"] == [41.25, 62.7, 0.5e-6]
    assert own["plant"] == [8.25, 36.3, 1e-6]
    assert "36.3 V, the largest bus voltage of the board mc56f84789" in own["supply"]
    assert "62.7 V" not in lab["supply"]
    assert "slope of sensing.sign_current" in lab["fine"]  # 0.08 A are four codes of such an ADC
    assert not own["fine"]
    assert "the file is for another board" in lab["default"]
    assert not own["default"]
    assert f"there is no firmware and no model of the board lab yet; known are {DEFAULT_BOARD}" in lab["virtual"]
    assert not own["virtual"]
