"""``servo-tool scope`` with the recorders of fake boards on a real pty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_port import FakePort
from fake_servo import FakeServo
from fake_target import RO, FakeEntry, FakeTarget
from fake_target_v3 import FakeTargetV3
from servo_bridge.bursts import recording
from test_tool_record import connect_ticks

from servo_bridge import tool

pytest.importorskip("rerun")
pytestmark = pytest.mark.realtime


@pytest.fixture(autouse=True)
def at_the_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SERVO_PORT", str(tmp_path / "ttyFAKE"))
    monkeypatch.delenv("SERVO_BAUD", raising=False)
    monkeypatch.setattr(recording, "POLL", 0.001)


def curve(path: Path, entity: str) -> tuple[list[float], list[float]]:
    """Times [s] and values of a curve of a file."""
    from rerun.chunk import RrdReader

    times, values = np.empty(0), np.empty(0)
    for chunk in RrdReader(path).stream().filter(content=entity, is_static=False, components="Scalars:scalars"):
        batch = chunk.to_record_batch()
        times = np.append(times, np.asarray(batch["board_time"].cast("int64")) * 1e-9)
        values = np.append(values, batch["Scalars:scalars"].flatten().to_numpy(zero_copy_only=False))
    order = np.argsort(times, kind="stable")
    return times[order].tolist(), values[order].tolist()


def test_foreign_board_is_shown_with_the_clock_of_the_host(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [FakeEntry("saw", b"\xf5", 0x1000, 2, RO), FakeEntry("count", b"\xe1", 0x1002, 2, RO)]
    target = FakeTargetV3(tables=[rows], recorder_memory=512)
    target.build()

    def tick(number: int) -> None:
        target.set_int(0x1000, (number % 64 - 32) * 1024, 2)
        target.set_int(0x1002, number, 2)

    target.on_tick = tick
    file = tmp_path / "x.rrd"
    options = ("--trigger", "saw > 0.5", "--before", "10", "--points", "40", "--rate", "500")
    with FakePort(tmp_path / "ttyFAKE", target) as port:
        connect_ticks(target, port)
        assert tool.main(["scope", "saw", "count", *options, "--count", "1", "--save", str(file)]) == 0
    out = capsys.readouterr()
    assert "values are not scaled" in out.err
    assert "burst 1 at" in out.out
    times, saw = curve(file, "/burst/saw/board")
    assert len(times) == 41
    assert saw[9] <= 0.5 < saw[10]
    assert np.diff(times[:40]) == pytest.approx(np.full(39, 2e-3))
    assert len(curve(file, "/plot/count/board")[0]) > 2, "the burst has the variables of the telemetry"


@pytest.mark.parametrize("names", [["tick"], ["tick", "axis1.i_q"], ["axis1.i_q", "axis1.i_q"]])
def test_the_tick_is_shown_if_it_is_asked_for(tmp_path: Path, names: list[str]) -> None:
    board = FakeServo(recorder_memory=2048)
    board.on_tick = lambda number: board.put("tick", number % 2**32)
    file = tmp_path / "x.rrd"
    with FakePort(tmp_path / "ttyFAKE", board) as port:
        connect_ticks(board, port)
        options = ["--points", "40", "--telemetry", "axis1.i_q", "--count", "1", "--save", str(file)]
        assert tool.main(["scope", *names, *options]) == 0
    for entity in {f"/burst/{name.replace('.', '/')}/board" for name in names}:
        assert len(curve(file, entity)[0]) == 41
    assert not curve(file, "/burst/tick/board")[0] or "tick" in names


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["axis1.iq"], 1, "did you mean axis1.i_q"),
        (["axis1.i_q", "--telemetry", "axis1.sped"], 1, "did you mean axis1.speed"),
        (["axis1.i_q", "--telemetry", "snapshot"], 2, "block of bytes"),
        (["axis1.i_q", "--level"], 2, "add --trigger"),
        (["axis1.i_q", "--rate", "5000"], 2, "5333.33 or 4000 Hz"),
        (["axis1.i_q", "--save", "x.csv"], 2, "must end with .rrd"),
        (["axis1.i_q", "--connect", "127.0.0.1:9"], 2, "is not an address of a rerun viewer"),
        (["axis1.i_q", "--connect", "rerun+http://127.0.0.1:9/proxy"], 2, "no rerun viewer at"),
    ],
)
def test_variables_that_cannot_be_shown_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], status: int, text: str
) -> None:
    with FakePort(tmp_path / "ttyFAKE", FakeServo(recorder_memory=2048)):
        file = [] if {"--save", "--connect"} & set(arguments) else ["--save", str(tmp_path / "x.rrd")]
        assert tool.main(["scope", *arguments, *file]) == status
    err = capsys.readouterr().err
    assert text in err
    assert err.count("\n") == 1
    assert not (tmp_path / "x.rrd").exists()


def test_a_board_without_a_recorder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = FakeTarget(tables=[[FakeEntry("x", b"\xf1", 0x1000, 2, RO)]])
    target.build()
    with FakePort(tmp_path / "ttyFAKE", target):
        assert tool.main(["scope", "x", "--save", str(tmp_path / "x.rrd")]) == 1
    assert "no recorder 0; recorders: none" in capsys.readouterr().err


def test_wrong_options_show_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        tool.main(["scope", "x", "--count", "0"])
    assert "'0' is too small; write a whole number from 1" in capsys.readouterr().err
