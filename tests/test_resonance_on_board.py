"""``servo-tool resonance`` and a virtual board with a load on a spring, over its serial line in simulated time."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest
from servo_msgs_py.board_port import place, reached, write_axis
from servo_msgs_py.text_file import parse_toml
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.plant import PlantConfig
from servo_twin.sprung_load import SprungLoad
from servo_twin.validation.experiments.rig import set_up
from test_tune_on_board import BAUD, CONFIG, ToolBench, edited

CASE: Final = SprungLoad(150.0, 3.0, 0.02)
KEPT: Final = ("config.checksum", "cmd.mode", "cmd.enable", "cmd.speed", "param.features", "param.command_timeout")


@pytest.fixture
def bench() -> Iterator[ToolBench]:
    packaged = PlantConfig.load()
    plant = replace(packaged, axes=(CASE.of(packaged.axes[0]), packaged.axes[1]))
    with Board(plant, level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        yield ToolBench(board)


def oscillates(board: Board) -> bool:
    """Move axis 1 by 5 turns; whether an oscillation is found."""
    board.write("param.command_timeout", 0.0)
    board.write("param.host_timeout", 30.0)  # no program sends a keep-alive
    board.write("cmd.enable", [1, 0])
    assert reached(board, lambda: place(board, 0) == "SPIN", 8.0, 0.05)
    start = VirtualBoardAccess(board).read("axis1.position")[0]
    write_axis(board, "cmd.position", 0, start + 10.0 * math.pi)
    board.run(1.5)
    found = bool(board.read("axis1.oscillation"))
    board.write("cmd.enable", [0, 0])
    board.run(0.5)
    return found


def test_load_is_measured_and_the_bandwidth_that_tune_names_does_not_oscillate(
    bench: ToolBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The measurement leaves the board as it was."""
    board, true = bench.board, CASE.of(PlantConfig.load().axes[0])
    assert oscillates(board)
    before = [bench.raw(name) for name in KEPT]
    begin = board.clock()
    assert bench.tool("resonance", "axis1", "--enable", "-o", tmp_path / "load.toml") == 0
    assert board.clock() - begin < 90.0
    assert [bench.raw(name) for name in KEPT] == before
    assert "antiresonance" in capsys.readouterr().out
    text = (tmp_path / "load.toml").read_text(encoding="utf-8")
    group = parse_toml(text)["axis1"]["load"]
    assert group["inertia"] == pytest.approx(true.load_inertia, rel=0.03)
    assert group["stiffness"] == pytest.approx(true.shaft_stiffness, rel=0.03)

    file = tmp_path / "my.toml"
    file.write_text(CONFIG.read_text(encoding="utf-8") + text, encoding="utf-8")
    assert bench.tool("tune", file, "--dry-run") == 0
    warning = capsys.readouterr()
    assert "axis1.control.speed_bandwidth = 21 or less and axis1.control.position_gain = 16 or less" in (
        warning.out + warning.err
    )
    slower = edited(tmp_path, "slower.toml", control={"speed_bandwidth": 21, "position_gain": 16})
    assert bench.tool("tune", slower, "--axis", "1") == 0
    assert not oscillates(board)


def test_an_enabled_axis_stays_enabled_with_its_gains(bench: ToolBench) -> None:
    """Else the load of a vertical axis would fall at the end of the measurement."""
    board = bench.board
    board.write("param.command_timeout", 0.0)
    board.write("cmd.enable", [0, 1])
    assert reached(board, lambda: place(board, 1) == "SPIN", 8.0, 0.05)
    before = [bench.raw(name) for name in KEPT]
    assert bench.tool("resonance", "axis2") == 0
    board.run(0.2)
    assert place(board, 1) == "SPIN"
    assert [bench.raw(name) for name in KEPT] == before


def test_bode_names_a_part_of_the_gains_for_a_shaft_that_oscillates(
    bench: ToolBench, capsys: pytest.CaptureFixture[str]
) -> None:
    """A curve with the gains that the board has reduced is compared with nothing."""
    assert bench.tool("bode", "axis1", "speed", "--enable") == 1
    assert "(--gain 0.125)" in capsys.readouterr().err
    assert bench.tool("bode", "axis1", "speed", "--enable", "--gain", "0.125", "--json") == 0
    assert json.loads(capsys.readouterr().out)["gain"] == 0.125


def test_what_cannot_be_measured_is_refused(bench: ToolBench, capsys: pytest.CaptureFixture[str]) -> None:
    """With its remedy, and without motion."""
    board = bench.board
    assert bench.tool("resonance", "axis1") == 1
    assert "use --enable" in capsys.readouterr().err
    assert bench.tool("resonance", "axis1", "--enable", "--range", "0.5") == 1
    assert "--range" in capsys.readouterr().err
    assert place(board, 0) == "STOP"


def test_rigid_shaft_as_json(bench: ToolBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An earlier file is kept. The speed observer, which does not know the load, is on before and afterwards only."""
    set_up(bench.board, 1, SPEED_OBSERVER=True)
    bench.board.run(0.01)
    features = bench.raw("param.features")
    file = tmp_path / "load.toml"
    file.write_text("kept", encoding="utf-8")
    assert bench.tool("resonance", "axis2", "--enable", "--json", "-o", file) == 0
    assert file.read_text(encoding="utf-8") == "kept"
    assert bench.raw("param.features") == features
    found = json.loads(capsys.readouterr().out)
    assert found["rigid"]
    (inertia,) = found["values"]
    assert inertia["value"] == pytest.approx(PlantConfig.load().axes[1].inertia, rel=0.02)
