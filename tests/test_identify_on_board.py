"""Identification of a motor over a serial line, and evaluation of the recording by the twin."""

from __future__ import annotations

import argparse
import json
import math
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

from servo_bridge import tool_identify

pytestmark = pytest.mark.slow

BAUD = 115_200


class _WatchedLine(SimulatedLine):
    """A line that raises Ctrl-C at given times, and that is interrupted for some time.

    Parameters
    ----------
    presses : sequence of float
        Times of Ctrl-C [s].
    gap : tuple of float
        Start and end of the interruption [s].
    """

    def __init__(
        self,
        board: Board,
        presses: Sequence[float] = (),
        gap: tuple[float, float] = (0.0, 0.0),
        number: signal.Signals = signal.SIGINT,
    ) -> None:
        super().__init__(board)
        self._presses, self._gap, self._number = list(presses), gap, number

    def advance(self, until_ns: int) -> None:
        super().advance(until_ns)
        now = self.board.time_ns * 1e-9
        self.plugged = not self._gap[0] <= now < self._gap[1]
        if self._presses and now >= self._presses[0]:
            self._presses.pop(0)
            signal.raise_signal(self._number)


def _state(board: Board) -> dict[str, list[int]]:
    names = ["config.checksum", "cmd.mode", "cmd.i_q", "cmd.speed"]
    names += [name for name in board.catalogue.variables if name.startswith("param.")]
    return {name: board.read_raw(name) for name in names}


def _identify(board: Board, folder: Path, *options: str, line: SimulatedLine | None = None) -> int:
    line = line or SimulatedLine(board)
    session = connect(Client(Line(line, baud=BAUD, clock=line.clock)), Catalogue.load())
    parser = argparse.ArgumentParser()
    tool_identify.add_arguments(parser)
    args = parser.parse_args(["--voltage", "24", "--current", "4", "--r-on", "0.03", "--out", str(folder), *options])
    context: Any = argparse.Namespace(args=args, session=session, catalogue=session.catalogue)
    return tool_identify.identify(context)


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
    assert json.loads((tmp_path / "estimates.json").read_text())["board_seconds"] < 72.0


def test_blocked_shaft_ends_with_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.lock_shaft(1)
        board.run(0.1)
        assert _identify(board, tmp_path, "--axis", "2") == 1
        assert board.read("axis2.state") == board.catalogue.enums["state_t"]["STOP"]
    assert "blocked" in capsys.readouterr().err


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
        assert _identify(board, tmp_path, line=_WatchedLine(board, presses, number=number)) == 128 + number
        assert _state(board) == before
        assert board.read("axis1.state") == board.catalogue.enums["state_t"]["STOP"]
        assert abs(board.truth(0).omega_m) < 0.5
    log = MeasurementLog.load(tmp_path / "measurement.npz")
    assert log.labelled("sweep_q")
    assert number.name in log.notes["problem"]


def test_lost_line_is_reported_and_the_board_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        before = _state(board)
        assert _identify(board, tmp_path, line=_WatchedLine(board, gap=(40.0, 42.5))) == 1
        assert _state(board) == before
        assert abs(board.truth(0).omega_m) < 0.5
    assert "the line has failed" in capsys.readouterr().err
    assert MeasurementLog.load(tmp_path / "measurement.npz").labelled("sweep_q")


@pytest.mark.parametrize("turns", [3.0, 20.0])
def test_shaft_stays_within_the_permitted_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turns: float) -> None:
    monkeypatch.setattr(tool_identify, "_twin_installed", lambda: False)
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        line, begin = SimulatedLine(board), board.truth(0).theta_m
        _identify(board, tmp_path, "--turns-max", str(turns), line=line)
    farthest = max(abs(theta[0] - begin) for theta in line.log.theta) / (2.0 * math.pi)
    assert 0.4 * turns < farthest < turns
