"""Identification of a motor over a serial line, and evaluation of the recording by the twin."""

from __future__ import annotations

import argparse
import copy
import json
import re
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from line_simulation import SimulatedLine
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.wire.session import connect
from servo_measurement.log import MeasurementLog
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board
from servo_twin.cli import main
from servo_twin.identification.trials import TARGETS
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig, servo_table

from servo_bridge import tool_identify

pytestmark = pytest.mark.slow

BAUD = 115_200


class _SignalledLine(SimulatedLine):
    """A line that raises a signal at given times [s]."""

    def __init__(self, board: Board, times: Sequence[float], number: signal.Signals) -> None:
        super().__init__(board)
        self._times, self._number = list(times), number

    def advance(self, until_ns: int) -> None:
        super().advance(until_ns)
        if self._times and self.board.time_ns * 1e-9 >= self._times[0]:
            self._times.pop(0)
            signal.raise_signal(self._number)


def _state(board: Board) -> dict[str, list[int]]:
    names = ["config.checksum", "cmd.mode", "cmd.i_q", "cmd.speed"]
    names += [name for name in board.catalogue.variables if name.startswith("param.")]
    return {name: board.read_words(name) for name in names}


def _identify(board: Board, folder: Path, line: SimulatedLine | None = None, current: str = "4") -> int:
    line = line or SimulatedLine(board)
    session = connect(Client(Line(line, baud=BAUD, clock=line.clock)), Catalogue.load())
    parser = argparse.ArgumentParser()
    tool_identify.add_arguments(parser)
    args = parser.parse_args(["--voltage", "24", "--current", current, "--r-on", "0.03", "--out", str(folder)])
    tool_identify.check(args)
    context: Any = argparse.Namespace(args=args, session=session, catalogue=session.catalogue)
    return tool_identify.identify(context)


def test_a_board_with_other_pins_requires_its_own_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = copy.deepcopy(dict(servo_table()))
    table["axis1"]["pins"] = {"brake": True}
    with Board(level="ideal", baud=BAUD, seed=4, servo=ServoConfig.of_table(table)) as board:
        assert _identify(board, tmp_path) == 1
    assert re.search(
        r"axis1 of the board has another pins\.fitted than .*servo\.toml; write --config", capsys.readouterr().err
    )


def test_a_refusal_leaves_the_files_of_an_earlier_measurement(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    earlier = tmp_path / "measurement.npz"
    earlier.write_text("earlier")
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        assert _identify(board, tmp_path, current="99") == 1
    assert "write --current 4 or less" in capsys.readouterr().err
    assert earlier.read_text() == "earlier"


def test_identification_over_a_line_writes_the_files(
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
    for name, aim in TARGETS.items():
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=aim), name
    assert json.loads((tmp_path / "estimates.json").read_text())["board_seconds"] < 66.0


@pytest.mark.parametrize(
    ("number", "presses"),
    [(signal.SIGINT, (40.0,)), (signal.SIGTERM, (40.0, 40.05, 40.2)), (signal.SIGHUP, (40.0,))],
)
def test_signal_keeps_the_recordings_and_restores_the_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, presses: tuple[float, ...]
) -> None:
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        before = _state(board)
        assert _identify(board, tmp_path, line=_SignalledLine(board, presses, number)) == 128 + number
        assert _state(board) == before
        assert board.read("axis1.state") == board.catalogue.enums["state_t"]["STOP"]
        assert abs(board.truth(0).omega_m) < 0.5
    log = MeasurementLog.load(tmp_path / "measurement.npz")
    assert log.labelled("sweep_q")
    assert number.name in log.notes["problem"]
