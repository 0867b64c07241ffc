"""``servo-tool ripple`` and a virtual board with cogging, over its serial line in simulated time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from servo_msgs_py.board_port import place, reached, write_axis
from servo_msgs_py.text_file import parse_toml
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.rig import RPM, set_up
from test_tune_on_board import BAUD, CONFIG, ToolBench

TORQUE: Final = 0.02  # N m
PERIODS: Final = 12  # per turn
SPEED: Final = 60.0 * RPM
KEPT: Final = ("config.checksum", "cmd.mode", "cmd.enable", "cmd.speed", "param.features", "param.command_timeout")


@pytest.fixture
def bench() -> Iterator[ToolBench]:
    plant = PlantConfig.load().with_axis(0, cogging_torque=TORQUE, cogging_periods=PERIODS, cogging_phase=0.7)
    with Board(plant, level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        yield ToolBench(board)


def home(board: Board) -> None:
    write_axis(board, "cmd.home", 0, board.catalogue.enums["home_method_t"]["HERE"])
    board.run(0.01)


def speed_ripple(bench: ToolBench, *, on: bool) -> float:
    """RMS deviation of the true speed of axis 1 in one turn [rad/s]."""
    set_up(bench.board, 0, "SPEED", SPEED, TORQUE_RIPPLE=on)
    bench.board.run(0.5)
    bench.line.advance(bench.board.time_ns + 1_000_000_000)
    speed = np.array(bench.line.log.omega)[-500:, 0]
    return float(np.sqrt(np.mean((speed - SPEED) ** 2)))


def test_cogging_is_measured_and_compensated(
    bench: ToolBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The speed ripple at 60 rpm falls by 80 %; the measurement leaves the board as it was."""
    board, file = bench.board, tmp_path / "my.toml"
    home(board)
    before = [bench.raw(name) for name in KEPT]
    begin = board.clock()
    assert bench.tool("ripple", "axis1", "--enable", "-o", tmp_path / "ripple.toml") == 0
    assert "8 turns in each direction at 9.41 rad/s" in capsys.readouterr().out
    assert board.clock() - begin < 90.0
    assert [bench.raw(name) for name in KEPT] == before

    text = (tmp_path / "ripple.toml").read_text(encoding="utf-8")
    (found,) = parse_toml(text)["axis1"]["torque_ripple"]["harmonics"]
    assert found["order"] == PERIODS
    assert found["amplitude"] == pytest.approx(TORQUE, rel=0.03)

    board.write("param.command_timeout", 0.0)
    board.write("param.host_timeout", 30.0)  # no program sends a keep-alive
    board.write("cmd.enable", [1, 0])
    assert reached(board, lambda: place(board, 0) == "SPIN", 8.0, 0.05)
    uneven = speed_ripple(bench, on=False)
    file.write_text(CONFIG.read_text(encoding="utf-8") + text, encoding="utf-8")
    assert bench.tool("tune", file) == 0
    even = speed_ripple(bench, on=True)
    assert even < 0.2 * uneven
    assert uneven > 0.1 * SPEED


def test_what_cannot_be_measured_is_refused(bench: ToolBench, capsys: pytest.CaptureFixture[str]) -> None:
    """Each with its remedy, and without motion."""
    board = bench.board

    def refused(*arguments: str) -> str:
        assert bench.tool("ripple", "axis1", *arguments) == 1
        return capsys.readouterr().err

    assert "home the axis first" in refused("--enable")
    home(board)
    assert "use --enable" in refused()
    assert "use at most" in refused("--enable", "--speed", "100")
    assert "use at least 0.25" in refused("--enable", "--speed", "0.1")
    set_up(board, 0, SPEED_OBSERVER=True)
    board.run(0.01)
    assert "SPEED_OBSERVER" in refused("--enable")
    set_up(board, 0, SPEED_OBSERVER=False, POSITION_LIMITS=True, parameters={"position_max": math.pi})
    board.run(0.01)
    assert "soft limit" in refused("--enable")
    assert place(board, 0) == "STOP"
