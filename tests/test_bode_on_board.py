"""``servo-tool bode`` and a virtual board: over its serial line in simulated time, and over a pty."""

from __future__ import annotations

import csv
import json
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from chain import FAST_BAUD, Chain
from line_simulation import SimulatedLine
from numpy.typing import NDArray
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.tool_commands import Context
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import connect
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board

from servo_bridge import tool

BAUD: Final = 115_200

Tool = Callable[..., int]


@pytest.fixture
def baud() -> int:
    return BAUD


@pytest.fixture
def board(baud: int) -> Iterator[Board]:
    with Board(level="ideal", baud=baud, seed=4) as board:
        board.run(0.1)
        yield board


class InterruptedLine(SimulatedLine):
    """Line that raises SIGHUP when axis 1 exceeds a speed [rad/s]."""

    interrupt_above: float | None = None

    def advance(self, until_ns: int) -> None:
        super().advance(until_ns)
        if self.interrupt_above is not None and abs(self.log.omega[-1][0]) > self.interrupt_above:
            self.interrupt_above = None
            signal.raise_signal(signal.SIGHUP)


@pytest.fixture
def line(board: Board) -> InterruptedLine:
    return InterruptedLine(board)


@pytest.fixture
def bode(line: InterruptedLine, baud: int) -> Tool:
    session = connect(Client(Line(line, baud=baud, clock=line.clock)), Catalogue.load())

    def run(*arguments: object) -> int:
        args = tool._parser().parse_args(["bode", *map(str, arguments)])
        args.check(args)
        return int(args.run(Context(args, Catalogue.load(), session, "line", baud, LowLatency(True, ""))))

    return run


def curves(path: Path, entity: str, timeline: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time line and values of a curve of a recording."""
    from rerun.chunk import RrdReader

    times, values = [], []
    stream = RrdReader(str(path)).stream()
    for chunk in stream.filter(content=entity, is_static=False, components="Scalars:scalars"):
        if timeline in chunk.timeline_names:
            batch = chunk.to_record_batch()
            times.append(np.asarray(batch[timeline].cast("int64")) * 1e-9)
            values.append(batch["Scalars:scalars"].flatten().to_numpy(zero_copy_only=False))
    return np.concatenate(times), np.concatenate(values)


def test_a_loop_is_measured_and_written(
    bode: Tool, board: Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rrd = tmp_path / "bode.rrd"
    assert bode("axis1", "speed", "--enable", "--repeat", 3, "--out", tmp_path, "--rrd", rrd, "--json") == 0
    output = capsys.readouterr()
    assert "axis1 rotates in alternating directions" in output.err
    found: dict[str, Any] = json.loads(output.out)
    assert found["measured"]["crossover"]["value"] == pytest.approx(found["predicted"]["crossover"], rel=0.05)
    assert found["measured"]["phase margin"]["value"] == pytest.approx(found["predicted"]["phase margin"], abs=3.0)

    with (tmp_path / "bode_axis1_speed.csv").open(encoding="utf-8") as file:
        head, *rows = list(csv.reader(file))
    table = np.array(rows, dtype=np.float64)
    assert head[:3] == ["frequency [Hz]", "gain [dB]", "phase [degrees]"]
    assert len(rows) == len(found["points"]) > 50
    crossed = np.argmax(table[:, 1] < 0.0)
    assert table[crossed, 0] == pytest.approx(found["measured"]["crossover"]["value"], rel=0.08)
    assert (tmp_path / "bode_axis1_speed.png").read_bytes()[:4] == b"\x89PNG"

    position, gain = curves(rrd, "/bode/axis1/speed/gain/predicted", "log_frequency")
    assert position == pytest.approx(np.log10(table[:, 0]), abs=1e-6)
    assert gain == pytest.approx(table[:, 6], abs=1e-4)
    assert board.read("axis1.faults") == 0
    assert board.read("cmd.enable") == [0, 0]
    assert board.catalogue.label("substate_t", board.read_words("axis1.substate")[0]) in ("READY", "FREEWHEEL")


def test_interruption_stops_the_shaft_and_restores_the_board(
    bode: Tool, board: Board, line: InterruptedLine, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write("cmd.enable", [1, 0])
    board.run(4.0)
    line.interrupt_above = 25.0
    with pytest.raises(KeyboardInterrupt):
        bode("axis1", "position")
    assert "Ctrl-C stops it" in capsys.readouterr().err
    assert abs(board.truth(0).omega_m) < 1.0
    assert max(abs(row[0]) for row in line.log.omega) > 20.0
    assert board.read("axis1.test_point") == 0
    assert board.read("param.command_timeout") == 0.5
    assert board.catalogue.label("substate_t", board.read_words("axis1.substate")[0]) == "SPIN"


def test_a_closed_output_leaves_the_files_and_the_board(
    bode: Tool, board: Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "write", _closed)
    with pytest.raises(BrokenPipeError):  # which the wrapper of the program turns into its status
        bode("axis1", "speed", "--enable", "--repeat", 2, "--out", tmp_path)
    assert (tmp_path / "bode_axis1_speed.csv").exists()
    assert board.read("cmd.enable") == [0, 0]
    assert board.read("axis1.faults") == 0


def _closed(_: str) -> int:
    raise BrokenPipeError


def test_missing_answer_gives_exit_status_1_and_the_reason(
    bode: Tool, board: Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bode("axis1", "speed") == 1
    assert "axis1 is not enabled" in capsys.readouterr().err
    assert bode("axis1", "speed", "--enable", "--from", 200, "--to", 400, "--repeat", 2) == 1
    output = capsys.readouterr()
    assert "crossover     not determined" in output.out
    assert "the gain is always below 1" in output.out
    assert bode("axis1", "position", "--enable", "--amplitude", 280, "--from", 300, "--to", 700) == 1
    assert "the board cannot generate the test signal" in capsys.readouterr().err
    assert bode("axis1", "speed", "--enable", "--amplitude", 0.1, "--speed", 100, "--repeat", 2) == 1
    assert "not confirmed: " in capsys.readouterr().out
    assert board.read("axis1.faults") == 0


@pytest.mark.parametrize("baud", [115_200, 38_400])
@pytest.mark.parametrize("loop", ["speed", "position"])
def test_shaft_stays_within_its_range_on_a_slow_line(
    bode: Tool, board: Board, line: InterruptedLine, loop: str, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write("cmd.enable", [1, 0])
    board.run(4.0)
    board.write("param.command_timeout", 2.0)
    start = board.truth(0).theta_m
    status = bode("axis1", loop, "--range", 60, "--repeat", 3)
    output = capsys.readouterr()
    assert status == 0, output.err
    assert board.read("param.command_timeout") == 2.0
    travel = max(abs(theta[0] - start) for theta in line.log.theta)
    assert 20.0 < travel < float(output.err.split("up to ")[1].split(" rad")[0])


@pytest.mark.realtime
@pytest.mark.slow
def test_a_board_on_a_pty_is_measured(tmp_path: Path) -> None:
    chain = Chain(tmp_path, FAST_BAUD, level="ideal")
    try:
        chain.board()
        # A loaded computer renews keep-alives and set-points late.
        chain.tool("set", "param.host_timeout", "4")
        chain.tool("set", "param.command_timeout", "4")
        found = json.loads(chain.tool("bode", "axis2", "speed", "--enable", "--repeat", "2", "--json"))
        assert found["measured"]["crossover"]["value"] == pytest.approx(found["predicted"]["crossover"], rel=0.05)
        assert found["measured"]["phase margin"]["value"] == pytest.approx(found["predicted"]["phase margin"], abs=3.0)
    finally:
        chain.end()
