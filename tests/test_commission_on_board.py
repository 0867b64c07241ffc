"""``servo-tool commission`` on virtual boards: in simulated time up to the first move, which is in real time."""

from __future__ import annotations

import dataclasses
import json
import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

import pytest
from chain import BRIDGE, Chain, wait_for
from line_simulation import SimulatedLine
from servo_bridge.commissioning.pack import PROGRESS
from servo_bridge.commissioning.recorded_move import RECORDING
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.tool_commands import Context
from servo_bridge.tool_commission_steps import STEPS, Step
from servo_bridge.tool_values import UsageError
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import connect
from servo_msgs_py.board_port import read_axis
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board
from servo_twin.cli import main as sim
from servo_twin.plant import PlantConfig

from servo_bridge import tool, tool_commission, tool_identify

BAUD: Final = 1_000_000
OFF: Final = ("board", "supply", "pins", "encoder")
NAMES: Final = [step.name for step in STEPS]


def _commission(board: Board, folder: Path, *more: str) -> int:
    """Exit status of the command for axis1 of a board."""
    line = SimulatedLine(board)
    session = connect(Client(Line(line, baud=BAUD, clock=line.clock)), Catalogue.load())
    words = ["commission", "axis1", "--voltage", "24", "--current", "4", "--r-on", "0.03", "--out", str(folder), *more]
    args = tool._parser().parse_args(words)
    args.check(args)
    return tool_commission.commission(Context(args, session.catalogue, session, "line", BAUD, LowLatency(True, "")))


def _done(folder: Path) -> dict[str, Any]:
    path = folder / "axis1" / PROGRESS
    return dict(json.loads(path.read_text(encoding="utf-8"))["steps"]) if path.exists() else {}


@pytest.fixture
def without_move(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the move, which needs processes in real time, and the refinement of the estimates."""

    def evaluated(args: Any, path: Path) -> int:
        return sim(["identify", "--recording", str(path), "--no-refinement", "--out", str(args.out)])

    monkeypatch.setattr(tool_identify, "_evaluated", evaluated)
    monkeypatch.setattr(tool_commission, "STEPS", [step for step in STEPS if step.name != "move"])


@pytest.mark.slow
def test_a_sequence_is_continued_after_the_supply_was_corrected(
    tmp_path: Path, without_move: None, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = PlantConfig.load()
    low = dataclasses.replace(plant, bus=dataclasses.replace(plant.bus, u_source=20.0))
    with Board(level="ideal", baud=BAUD, seed=4, plant=low) as board:
        board.run(0.1)
        begin = [board.truth(axis).theta_m for axis in range(2)]
        assert _commission(board, tmp_path, "--yes") == 1
        assert [board.truth(axis).theta_m for axis in range(2)] == pytest.approx(begin, abs=0.02)
    assert "supply: bus voltage is 20" in capsys.readouterr().err
    assert list(_done(tmp_path)) == ["board"]
    assert "bus voltage is 20" in (tmp_path / "axis1" / "report.html").read_text(encoding="utf-8")
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        assert _commission(board, tmp_path, "--yes") == 0, capsys.readouterr().err
        assert board.read_words("storage.sequence") == [1]
        assert read_axis(board, "param.i_q_limit", 0) == pytest.approx(4.0, rel=1e-3)
        assert read_axis(board, "param.speed_limit", 0) == pytest.approx(200.0, rel=1e-3)
        assert _commission(board, tmp_path, "--yes") == 0
    text = capsys.readouterr().out
    assert text.count("done before") == 4
    assert list(_done(tmp_path)) == NAMES[:-1]
    motor = {one["name"]: one["value"] for one in _done(tmp_path)["identify"]["figures"]}
    assert motor["pole_pairs"] == plant.axes[0].pole_pairs
    assert motor["r_s"] == pytest.approx(plant.axes[0].r_s, rel=0.1)
    files = {path.name for path in (tmp_path / "axis1").iterdir()}
    assert {"servo.toml", "plant.toml", "report.html", "bode_axis1_speed.png", "identify.png"} <= files
    with Board(level="ideal", baud=BAUD, seed=4) as board:  # the other axis goes on with these files
        args = tool._parser().parse_args(
            ["commission", "axis2", "--voltage", "24", "--current", "4", "--out", str(tmp_path), "--yes"]
        )
        args.check(args)
        assert (args.config, args.plant) == (tmp_path / "axis1" / "servo.toml", tmp_path / "axis1" / "plant.toml")


@pytest.fixture
def user(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Answers of a user at a terminal; an EOFError when there are none left."""
    answers: list[str] = []

    def answer(_: str) -> str:
        if not answers:
            raise EOFError
        return answers.pop(0)

    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    return answers


@pytest.mark.parametrize(
    ("answers", "done", "text"),
    [
        ([], ["board", "supply"], "pins: active inputs: none: change the wiring"),
        (["n"], ["board", "supply"], "pins: active inputs: none: change the wiring"),
        (["", "s"], list(OFF), "ended before the step 'identify'; the same command continues"),
        (
            ["", ""],
            ["board", "supply", "pins"],
            "encoder: one turn by hand is 0 rad, not 5.027 .. 7.54: lines per turn",
        ),
    ],
)
def test_nothing_moves_without_the_consent_of_the_user(
    tmp_path: Path, user: list[str], capsys: pytest.CaptureFixture[str], answers: list[str], done: list[str], text: str
) -> None:
    user += answers
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        begin = [board.truth(axis).theta_m for axis in range(2)]
        assert _commission(board, tmp_path) == 1
        assert [board.truth(axis).theta_m for axis in range(2)] == pytest.approx(begin, abs=0.02)
        assert board.read_words("axis1.state") == [board.catalogue.enums["state_t"]["STOP"]]
    assert text in capsys.readouterr().err
    assert list(_done(tmp_path)) == done


def test_a_board_of_another_commissioning_is_refused(
    tmp_path: Path, user: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with Board(level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        _commission(board, tmp_path)
        _commission(board, tmp_path, "--speed-max", "100")
    assert (
        "belongs to another commissioning: speed was 200.0, now 100.0; write another folder" in capsys.readouterr().err
    )


def test_without_a_terminal_the_steps_must_be_confirmed_by_an_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False)
    args = tool._parser().parse_args(
        ["commission", "axis1", "--voltage", "24", "--current", "4", "--out", str(tmp_path / "pack")]
    )
    with pytest.raises(UsageError, match="--yes confirms all of them"):
        args.check(args)
    assert not (tmp_path / "pack").exists()


@pytest.mark.realtime
def test_the_first_move_is_recorded_and_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool_commission, "STEPS", _only("board", "move"))
    chain = Chain(tmp_path, level="ideal")
    try:
        chain.board()
        words = ["--port", str(chain.port), "commission", "axis2", "--voltage", "24", "--current", "4", "--yes"]
        assert tool.main([*words, "--out", str(tmp_path)]) == 0
    finally:
        chain.end()
    assert "replay on the twin: identical" in capfd.readouterr().out
    folder = tmp_path / "axis2"
    assert (folder / RECORDING).stat().st_size > 10_000
    figures = {
        one["name"]: one["value"]
        for one in json.loads((folder / PROGRESS).read_text(encoding="utf-8"))["steps"]["move"]["figures"]
    }
    assert figures["moves in the recording"] == 2
    assert figures["move 1: largest error"] < 0.02
    assert (folder / "steps.png").is_file()


def _only(*names: str) -> list[Step]:
    return [step for step in STEPS if step.name in names]


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_an_end_in_the_move_stops_the_shaft_and_switches_off(tmp_path: Path, number: signal.Signals) -> None:
    chain = Chain(tmp_path, level="ideal")
    words = ["--port", str(chain.port), "commission", "axis1", "--voltage", "24", "--current", "4", "--yes"]
    code = (
        "from servo_bridge import tool, tool_commission as command; "
        "command.STEPS = [step for step in command.STEPS if step.name == 'move']; "
        f"raise SystemExit(tool.main({[*words, '--out', str(tmp_path)]!r}))"
    )
    names = ("axis1.state", "axis1.position", "axis1.faults")
    try:
        board = chain.board()
        program = subprocess.Popen(
            [sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, env=chain.environment, text=True
        )
        assert program.stdout is not None
        for line in program.stdout:
            if "at most" in line:  # the report of the path, before its start
                break
        time.sleep(1.0)
        program.send_signal(number)
        assert program.wait(20.0) == (-number if number == signal.SIGKILL else 128 + number)
        wait_for(lambda: not any(BRIDGE in command for command in chain.processes().values()), 20.0, board.text)
        values = chain.read_variables(*names)
        assert values["axis1.state"] == Catalogue.load().enums["state_t"]["STOP"]
        assert values["axis1.faults"] == 0
        assert 0.0 < values["axis1.position"] < math.tau
        assert chain.read_variables(names[1]) == {names[1]: values[names[1]]}  # at rest
    finally:
        chain.end()
