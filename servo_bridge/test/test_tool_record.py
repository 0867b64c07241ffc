"""``servo-tool record`` with the recorders of fake boards on a real pty."""

from __future__ import annotations

import csv
import io
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fake_port import FakePort
from fake_servo import CATALOGUE, FakeServo
from fake_target import RO, FakeEntry, FakeTarget
from fake_target_v3 import FakeTargetV3
from servo_bridge.bursts import recording
from servo_bridge.tool_progress import progress_bar, show

from servo_bridge import tool

pytestmark = pytest.mark.realtime

Run = Callable[..., int]
MANY = [v.name for v in CATALOGUE.variables.values() if v.size in (2, 4) and v.count == 1][:62]
TICKS = 400  # ticks of the fast loop per request


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.setenv("SERVO_PORT", str(tmp_path / "ttyFAKE"))
    monkeypatch.delenv("SERVO_BAUD", raising=False)
    monkeypatch.setattr(recording, "POLL", 0.001)
    return lambda *arguments: tool.main(arguments)


@pytest.fixture
def servo(tmp_path: Path) -> Iterator[FakeServo]:
    """A servo board whose current is a sine of 2 A with a period of 100 ticks."""
    board = FakeServo(recorder_memory=2048)
    lsb = CATALOGUE["axis1.i_q"].lsb

    def tick(number: int) -> None:
        board.put("axis1.i_q", round(2.0 * math.sin(0.02 * math.pi * number) / lsb))
        board.put("tick", number % 2**32)

    board.on_tick = tick
    with FakePort(tmp_path / "ttyFAKE", board) as port:
        connect_ticks(board, port)
        yield board


def connect_ticks(board: FakeTarget, port: FakePort) -> None:
    """Run the loop only after the recorder is started, as the discovery of a board takes many requests."""
    feed = board.feed

    def fed(data: bytes) -> bytes:
        if any(recorder.state == 2 for recorder in board.recorders):
            board.advance(TICKS)
        return feed(data)

    board.feed = fed  # type: ignore[method-assign]


def rows_of(path: Path) -> tuple[list[str], list[list[float]]]:
    with path.open() as stream:
        head, *rows = csv.reader(stream)
    return head, [[float(cell) for cell in row] for row in rows]


def test_a_burst_is_recorded_around_its_trigger(
    servo: FakeServo, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(tmp_path / name) for name in ("burst.csv", "burst.npz", "burst.png")]
    output = [word for file in files for word in ("-o", file)]
    options = ["--trigger", "axis1.i_q > 1.0", "--before", "30%", "--rate", "8000", "--points", "100"]
    assert run("record", "--fast", "tick", "axis1.i_q", "cmd.position", *options, *output) == 0
    head, rows = rows_of(tmp_path / "burst.csv")
    assert head == ["time [s]", "tick [PWM periods]", "axis1.i_q [A]", "cmd.position[0] [rad]", "cmd.position[1] [rad]"]
    assert len(rows) == 100
    assert [row[0] for row in rows] == pytest.approx([(k - 30) * 125e-6 for k in range(100)])
    assert {round(b[1] - a[1]) for a, b in pairwise(rows)} == {2}
    assert rows[29][2] <= 1.0 < rows[30][2]
    arrays = np.load(tmp_path / "burst.npz")
    assert arrays["axis1.i_q"].tolist() == pytest.approx([row[2] for row in rows])
    assert arrays["time"][30] == 0.0
    assert (tmp_path / "burst.png").read_bytes().startswith(b"\x89PNG")
    assert "100 points, -0.00375 .. 0.008625 s in" in capsys.readouterr().out


def test_a_burst_without_a_trigger_fills_the_memory(servo: FakeServo, run: Run, tmp_path: Path) -> None:
    file = tmp_path / "x.csv"
    assert run("record", "--recorder", "0", "tick", "-o", str(file)) == 0
    _, rows = rows_of(file)
    assert len(rows) == (2048 - 64 - 32) // 4
    assert rows[0][0] == 0.0
    assert {b[1] - a[1] for a, b in pairwise(rows)} == {1}


def test_a_recording_without_its_trigger_is_written_after_the_timeout(
    servo: FakeServo, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.csv"
    options = ("--trigger", "axis1.i_q > 3", "--timeout", "0.1", "--points", "50")
    assert run("record", "axis1.i_q", *options, "-o", str(file)) == 0
    assert "stopped before the trigger" in capsys.readouterr().out
    assert len(rows_of(file)[1]) == 50


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_a_burst_and_keeps_its_points(
    servo: FakeServo, run: Run, tmp_path: Path, number: signal.Signals
) -> None:
    """The recorder has no trigger; the signal comes while it runs."""
    signals = iter([number])
    tick = servo.on_tick
    assert tick is not None

    def signal_after_ticks(count: int) -> None:
        tick(count)
        if count > 10 * TICKS:
            for each in signals:
                os.kill(os.getpid(), each)

    servo.on_tick = signal_after_ticks
    file = tmp_path / "x.csv"
    assert run("record", "axis1.i_q", "--trigger", "axis1.i_q > 3", "--points", "50", "-o", str(file)) == 0
    assert len(rows_of(file)[1]) == 50


def test_a_closed_output_leaves_the_file(
    servo: FakeServo, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(_: str) -> int:
        raise BrokenPipeError

    file = tmp_path / "x.csv"
    monkeypatch.setattr(sys.stdout, "write", closed)
    assert run("record", "--recorder", "0", "tick", "-o", str(file)) == 128 + signal.SIGPIPE
    assert len(rows_of(file)[1]) > 100


def test_lost_line_ends_a_burst_with_the_reason(
    servo: FakeServo, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    feed = servo.feed

    def fed(data: bytes) -> bytes:
        answer = feed(data)
        return b"" if any(recorder.state == 2 for recorder in servo.recorders) else answer

    servo.feed = fed  # type: ignore[method-assign]
    file = tmp_path / "x.csv"
    assert run("record", "axis1.i_q", "--trigger", "axis1.i_q > 3", "-o", str(file)) == 1
    assert "has stopped responding" in capsys.readouterr().err
    assert not file.exists()


def test_a_recording_is_written_for_rerun(servo: FakeServo, run: Run, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    file = tmp_path / "burst.rrd"
    assert run("record", "tick", "axis1.i_q", "--points", "20", "-o", str(file)) == 0
    assert file.read_bytes().startswith(b"RRF")


BURST = ["record", "axis1.i_q", "--points", "20", "-o"]


@pytest.mark.parametrize(
    ("command", "name"),
    [
        *((BURST, f"burst.{suffix}") for suffix in ("csv", "npz", "png", "svg", "pdf", "rrd")),
        (["record", "axis1.i_q", "--duration", "0.01", "-o"], "line.csv"),
        (["save"], "parameters.toml"),
        (["save"], "parameters.json"),
        (["project"], "project.pmpx"),
        (["scope", "axis1.i_q", "--fast", "--count", "1", "--save"], "scope.rrd"),
    ],
)
def test_full_disk_is_one_line_with_the_name_of_the_file(
    servo: FakeServo, run: Run, tmp_path: Path, capfd: pytest.CaptureFixture[str], command: list[str], name: str
) -> None:
    (tmp_path / name).symlink_to("/dev/full")
    assert run(*command, str(tmp_path / name)) == 1
    (error,) = [line for line in capfd.readouterr().err.splitlines() if line.startswith("servo-tool: ")]
    assert str(tmp_path / name) in error
    assert "No space left on device" in error


@pytest.mark.parametrize(
    "command", [["record", "axis1.i_q", "--duration", "0.01", "-o"], [*BURST[:-1], "-o"], ["save"], ["project"]]
)
def test_a_file_is_written_into_a_new_folder(servo: FakeServo, run: Run, tmp_path: Path, command: list[str]) -> None:
    suffix = {"save": ".toml", "project": ".pmpx"}.get(command[0], ".csv")
    file = tmp_path / "new" / "[folder] #1" / f"x{suffix}"
    assert run(*command, str(file)) == 0
    assert file.stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["axis1.i_q", "--trigger", "axis1.i_q > 10"], 2, "outside the range of axis1.i_q: -8.25"),
        (["axis1.i_q", "--trigger", "axis1.iq > 1"], 1, "did you mean axis1.i_q"),
        (["axis1.i_q", "--trigger", "axis1.i_q is 1"], 2, "is not a trigger"),
        (["axis1.iq", "--fast"], 1, "did you mean axis1.i_q"),
        (["axis1.i_q", "--points", "5000"], 1, "976 points fit"),
        (["--fast", *MANY], 1, "record fewer"),
        (["axis1.i_q", "--slow"], 1, "no recorder 1; recorders: 0 .. 0"),
        (["axis1.i_q", "--fast", "--rate", "5000"], 2, "5333.33 or 4000 Hz, not 5000 Hz"),
        (["axis1.i_q", "--fast", "--duration", "1"], 2, "--duration is not for bursts"),
        (["axis1.i_q", "--level"], 2, "add --trigger"),
        (["axis1.i_q", "--before", "200", "--points", "100", "--trigger", "axis1.i_q > 1"], 1, "not less than all 100"),
        (["snapshot", "--fast"], 2, "block of bytes"),
        (["axis1.i_q", "--fast", "-o", "x.txt"], 2, "must end with one of .csv, .npz"),
    ],
)
def test_impossible_recordings_are_reported(
    servo: FakeServo,
    run: Run,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    status: int,
    text: str,
) -> None:
    file = tmp_path / "x.csv"
    assert run("record", *arguments, "-o", str(file)) == status
    err = capsys.readouterr().err
    assert text in err
    assert err.count("\n") == 1
    assert not file.exists()


@pytest.mark.parametrize(
    "arguments", [["--before", "130%"], ["--before", "some"], ["--fast", "--slow"], ["--points", "-1"]]
)
def test_wrong_options_show_the_usage(run: Run, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run("record", "x", "-o", "x.csv", *arguments)
    assert "usage: servo-tool" in capsys.readouterr().err


def test_info_prints_the_recorder(servo: FakeServo, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info") == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("recorder 0"))
    assert line.split(None, 2)[2] == "fast, 2048 bytes, 16000 Hz"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()])
def test_progress_is_one_line_of_a_terminal_and_erased_at_the_end(
    stream: io.StringIO, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", stream)
    with progress_bar() as bar:
        bar.mininterval = 0.0
        show(bar, "waiting")
        show(bar, "reading ", 1, 4)
        show(bar, "reading ", 4, 4)
    shown = [line.rstrip() for line in stream.getvalue().split("\r") if line.strip()]
    if not stream.isatty():
        assert shown == []
        return
    assert [line.partition("|")[0] for line in shown] == ["waiting", "reading  25%", "reading 100%"]
    assert stream.getvalue().endswith(f"{' ' * len(shown[-1])}\r")


@pytest.mark.parametrize("big_endian", [False, True])
def test_a_board_of_version_3_is_recorded(tmp_path: Path, run: Run, big_endian: bool) -> None:
    rows = [FakeEntry("saw", b"\xf5", 0x1000, 2, RO), FakeEntry("count", b"\xe1", 0x1002, 2, RO)]
    target = FakeTargetV3(tables=[rows], recorder_memory=512, big_endian=big_endian)
    target.build()

    def tick(number: int) -> None:
        target.set_int(0x1000, (number % 64 - 32) * 1024, 2)
        target.set_int(0x1002, number, 2)

    target.on_tick = tick
    file = tmp_path / "x.csv"
    with FakePort(tmp_path / "ttyFAKE", target) as port:
        connect_ticks(target, port)
        options = ("--trigger", "saw > 0.5", "--before", "10", "--points", "40", "--rate", "500")
        assert run("record", "saw", "count", *options, "-o", str(file)) == 0
    _, found = rows_of(file)
    assert len(found) == 40
    assert found[10][0] == 0.0
    assert found[11][0] == pytest.approx(2e-3)
    assert found[9][1] <= 0.5 < found[10][1]
    assert found[11][2] - found[10][2] == 2


def test_a_board_without_a_recorder_is_reported(tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    target = FakeTarget(tables=[[FakeEntry("x", b"\xf1", 0x1000, 2, RO)]])
    target.build()
    with FakePort(tmp_path / "ttyFAKE", target):
        assert run("record", "x", "--fast", "-o", str(tmp_path / "x.csv")) == 1
    assert "no recorder 0; recorders: none" in capsys.readouterr().err
