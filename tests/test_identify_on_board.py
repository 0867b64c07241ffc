"""A motor identified over a serial line, and the recording evaluated by the twin."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest
from line_world import SimulatedLine
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.wire.session import connect
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board
from servo_twin.cli import main
from servo_twin.identification.trials import AIMS
from servo_twin.plant import PlantConfig

from servo_bridge import tool_identify

BAUD = 115_200


def _identify(board: Board, folder: Path, *options: str) -> int:
    line = SimulatedLine(board)
    session = connect(Client(Line(line, baud=BAUD, clock=line.clock)), Catalogue.load())
    parser = argparse.ArgumentParser()
    tool_identify.add_arguments(parser)
    args = parser.parse_args(["--voltage", "24", "--current", "4", "--r-on", "0.03", "--out", str(folder), *options])
    context: Any = argparse.Namespace(args=args, session=session, catalogue=session.catalogue)
    return tool_identify.identify(context)


def test_from_the_line_to_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        assert _identify(board, tmp_path) == 0
    captured = capsys.readouterr()
    assert "psi_m" in captured.out
    assert "install servo_twin" in captured.err
    recording = str(tmp_path / "measurement.npz")
    assert main(["identify", "--recording", recording, "--model", "ideal", "--out", str(tmp_path)]) == 0
    found, true = PlantConfig.load(tmp_path / "plant.toml").axes[0], PlantConfig.load().axes[0]
    for name, aim in AIMS.items():
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=aim), name
    assert json.loads((tmp_path / "estimates.json").read_text())["board_seconds"] < 60.0


def test_a_held_shaft_ends_with_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.lock_shaft(1)
        board.run(0.1)
        assert _identify(board, tmp_path, "--axis", "2") == 1
        assert board.read("axis2.state") == board.catalogue.enums["state_t"]["STOP"]
    assert "held" in capsys.readouterr().err
