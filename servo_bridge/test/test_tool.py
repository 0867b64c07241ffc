"""servo-tool with fake boards on a real pty."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fake_port import FakePort, NoiseDevice
from fake_servo import CATALOGUE, FakeServo
from fake_target import CONST, ENUM, NONE, RO, RW, STRUCT, FakeEntry, FakeTarget
from fake_target_v3 import FakeTargetV3
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal

from servo_bridge import tool

pytestmark = pytest.mark.realtime

Run = Callable[..., int]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.setenv("SERVO_PORT", str(tmp_path / "ttyFAKE"))
    monkeypatch.delenv("SERVO_BAUD", raising=False)
    return lambda *arguments: tool.main(arguments)


@pytest.fixture
def foreign_target(tmp_path: Path) -> Iterator[FakeTarget]:
    rows = [
        FakeEntry("mode_t", ENUM, 0, 1, NONE),
        FakeEntry("ECO", CONST, 0, 0, NONE),
        FakeEntry("TURBO", CONST, 1, 0, NONE),
        FakeEntry("gain", b"\xf4:3.12", 0x1000, 2, RW),
        FakeEntry("mode", b"mode_t", 0x1002, 1, RW),
        FakeEntry("temperature", b"\xfa", 0x1004, 4, RO),
        FakeEntry("table", b"\xf1", 0x1010, 6, RW),
        FakeEntry("memory", None, 0x1020, 20, RO),
        FakeEntry("loop_t", STRUCT, 0, 6, NONE),
        FakeEntry("gain", b"\xf4:3.12", 0, 2, NONE),
        FakeEntry("limits", b"\xf1", 2, 4, NONE),
        FakeEntry("drive_t", STRUCT, 0, 12, NONE),
        FakeEntry("loops", b"loop_t", 0, 12, NONE),
        FakeEntry("drive", b"drive_t", 0x1040, 12, RW),
        FakeEntry("curve", b"\xf2", 0x1100, 400, RW),
        FakeEntry("page.htm", b"\xec:MEMFILE", 0x5000, 100, RW),
    ]
    target = FakeTarget(tables=[rows])
    target.build()
    with FakePort(tmp_path / "ttyFAKE", target):
        yield target


# ---- reading ------------------------------------------------------------------------------------------------------
def test_info_shows_the_board_and_its_contract(
    fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("info") == 0
    out = capsys.readouterr().out
    assert f"servo/{CATALOGUE.board.name} test target" in out
    assert next(line for line in out.splitlines() if line.startswith("hardware")).split()[1] == CATALOGUE.board.name
    assert "matches" in out
    assert "axis1.state" in out
    assert "FAULT" in out


@pytest.mark.parametrize("arguments", [("info",), ("get", "axis1.position"), ("set", "param.brake", "1")])
def test_reading_a_running_board_does_not_stop_it(
    fake_port: FakePort, fake_board: FakeServo, run: Run, arguments: tuple[str, ...]
) -> None:
    assert run(*arguments) == 0
    assert fake_board.host_signals == []


def test_vars_lists_the_variables_that_match(fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("vars", "cmd.*") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["NAME", "TYPE", "ACCESS", "UNIT", "LIMITS", "DESCRIPTION"]
    speed = next(line for line in lines if line.startswith("cmd.speed "))
    assert "frac32[2]" in speed
    assert "rw" in speed
    assert "rad/s" in speed
    assert "-419 .. 419" in speed
    assert len(lines) == 16


def test_vars_without_a_match_is_an_error(fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("vars", "nothing*") == 1
    assert "no variable matches" in capsys.readouterr().err


def test_get_prints_values_with_units_and_names(
    fake_port: FakePort, run: Run, fake_board: FakeServo, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_board.put("axis1.state", 2)
    fake_board.put("axis1.faults", 3)
    fake_board.put("cmd.position", 0, 4000)
    assert run("get", "axis1.state", "axis1.faults", "cmd.position", "cmd.position[1]", "param.host_timeout") == 0
    values = dict(line.split(" = ") for line in capsys.readouterr().out.splitlines() if " = " in line)
    assert {name.strip(): value.strip() for name, value in values.items()} == {
        "axis1.state": "2 (STOP)",
        "axis1.faults": "3 (OVER_VOLTAGE+UNDER_VOLTAGE)",
        "cmd.position": "0, 6.28318531 rad",
        "cmd.position[1]": "6.28318531 rad",
        "param.host_timeout": "0.5 s",
    }


def test_get_prints_json_and_raw_values(
    fake_port: FakePort, run: Run, fake_board: FakeServo, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_board.put("axis1.position", -4000)
    assert run("get", "--json", "axis1.position", "tick") == 0
    assert json.loads(capsys.readouterr().out)["axis1.position"] == pytest.approx(-6.283185307)
    assert run("get", "--json", "--raw", "axis1.position") == 0
    assert json.loads(capsys.readouterr().out) == {"axis1.position": -4000}


def test_get_of_an_unknown_name_is_an_error(fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("get", "axis1.positoin") == 1
    assert "did you mean axis1.position" in capsys.readouterr().err
    assert run("get", "cmd.position[2]") == 1
    assert "elements 0 .. 1" in capsys.readouterr().err


def test_watch_prints_a_line_per_sample(fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("watch", "tick", "u_dc", "--rate", "200", "--count", "3") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert "u_dc=0 V" in lines[0]
    ticks = [int(line.split("tick=")[1].split()[0]) for line in lines]
    assert ticks[0] < ticks[1] < ticks[2]


def test_record_writes_a_table(
    fake_port: FakePort, run: Run, fake_board: FakeServo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_board.put("axis1.i_q", 16384)
    file = tmp_path / "out.csv"
    assert run("record", "axis1.i_q", "cmd.position", "-o", str(file), "--duration", "0.3") == 0
    with file.open() as stream:
        head, *rows = csv.reader(stream)
    assert head == ["time [s]", "tick", "axis1.i_q [A]", "cmd.position[0] [rad]", "cmd.position[1] [rad]"]
    assert len(rows) > 10
    ticks = [int(row[1]) for row in rows]
    assert ticks == sorted(ticks)
    assert [float(r[0]) for r in rows] == pytest.approx([(t - ticks[0]) * 62.5e-6 for t in ticks], abs=1e-6)
    assert {row[2] for row in rows} == {"4.125"}
    assert f"{len(rows)} rows" in capsys.readouterr().out


def test_a_block_cannot_be_recorded(fake_port: FakePort, run: Run, tmp_path: Path) -> None:
    assert run("record", "snapshot", "-o", str(tmp_path / "x.csv")) == 2
    assert not (tmp_path / "x.csv").exists()


# ---- writing ------------------------------------------------------------------------------------------------------
def test_set_writes_and_shows_the_value_before(
    fake_port: FakePort, run: Run, fake_board: FakeServo, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("set", "cmd.speed", "-3,2.5") == 0
    raw = fake_board.get("cmd.speed")
    assert [r / 2**31 * 523.5987756 for r in raw] == pytest.approx([-3.0, 2.5], abs=1e-6)
    assert "(was 0, 0 rad/s)" in capsys.readouterr().out
    assert run("set", "cmd.speed", "-1", "--element", "1") == 0
    assert run("set", "cmd.speed[0]", "4") == 0
    assert [r / 2**31 * 523.5987756 for r in fake_board.get("cmd.speed")] == pytest.approx([4.0, -1.0], abs=1e-6)
    assert run("set", "cmd.mode", "speed,TORQUE") == 0
    assert fake_board.get("cmd.mode") == [1, 2]
    assert run("set", "--raw", "cmd.i_q", "0.25,-0.25") == 0
    assert fake_board.get("cmd.i_q") == [8192, -8192]
    assert [(name, offset) for name, offset, _ in fake_board.written] == [
        ("cmd.speed", 0), ("cmd.speed", 4), ("cmd.speed", 0), ("cmd.mode", 0), ("cmd.i_q", 0),
    ]  # fmt: skip


def test_parameter_that_the_board_changes_is_an_error(
    fake_port: FakePort, run: Run, fake_board: FakeServo, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = fake_board.on_write
    assert recorded is not None

    def changed(address: int, data: bytes) -> None:
        recorded(address, data)
        fake_board.put("param.host_timeout", 4000)

    fake_board.on_write = changed
    assert run("set", "param.host_timeout", "0.2") == 1
    assert "the board has another value of param.host_timeout than the written one" in capsys.readouterr().err


def test_flags_are_set_by_name(fake_port: FakePort, run: Run, fake_board: FakeServo) -> None:
    assert run("set", "param.features", "dead_time + FRICTION,none") == 0
    assert fake_board.get("param.features") == [0b11000, 0]
    assert run("set", "param.features[1]", "OVER_SPEED") == 0
    assert fake_board.get("param.features") == [0b11000, 1 << 9]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["cmd.speed", "1000,0"], "outside -419 .. 419"),
        (["cmd.speed", "nan,0"], "not a finite number"),
        (["cmd.speed", "1"], "1 value(s) given, 2 expected"),
        (["cmd.speed", "1,2", "--element", "0"], "2 value(s) given, 1 expected"),
        (["cmd.speed", "1", "--element", "2"], "elements 0 .. 1"),
        (["cmd.speed", "1", "--element", "-1"], "elements 0 .. 1"),
        (["cmd.speed[0]", "1", "--element", "0"], "already has an element"),
        (["cmd.speed", "fast,slow"], "'fast' is not a number"),
        (["cmd.mode", "warp,0"], "POSITION, SPEED, TORQUE"),
        (["cmd.mode", "SPEED+TORQUE,0"], "is not a number"),
        (["param.features[0]", "DEAD_TIME+WARP"], "'WARP' is not a number or one of the names none, ANTI_WINDUP"),
        (["param.features[0]", "1.5"], "param.features: 1.5 is not a whole number"),
        (["cmd.enable[0]", "0.6"], "cmd.enable: 0.6 is not a whole number"),
        (["cmd.mode", "0.4,1"], "cmd.mode: 0.4 is not a whole number"),
        (["--raw", "cmd.enable[0]", "0.6"], "is not an integer"),
        (["param.position_min[1]", "1001"], "exceeds param.position_max[1]"),
        (["param.position_max", "-1001,0"], "exceeds param.position_max[0]"),
        (["axis1.speed", "1"], "can only be read"),
    ],
)
def test_set_refuses_a_bad_value_with_its_reason(
    fake_port: FakePort,
    run: Run,
    fake_board: FakeServo,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    text: str,
) -> None:
    assert run("set", *arguments) == 2
    err = capsys.readouterr().err
    assert text in err
    assert err.count("\n") == 1
    assert fake_board.written == []


def test_refusal_of_a_value_by_the_board_reports_its_range(
    fake_port: FakePort, run: Run, fake_board: FakeServo, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, text in (
        (["--raw", "cmd.mode", "1,9"], "cmd.mode[1]: 9 is outside 0 .. 4"),
        (["--raw", "param.i_q_limit[0]", "-0.5"], "param.i_q_limit[0]: -4.125 is outside 0.1 .. 4 A"),
        (
            ["cmd.position[1]", "2e6"],
            "cmd.position[1]: 2000000 rad is more than 1.68663e+06 rad away from the shaft; move in steps",
        ),
    ):
        assert run("set", *arguments) == 1
        assert capsys.readouterr().err == f"servo-tool: {text}\n"
    assert fake_board.written == []


def test_load_reports_the_value_refused_by_the_board(
    fake_port: FakePort, run: Run, fake_board: FakeServo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A position set-point: all other ranges are checked by the tool."""
    file = str(tmp_path / "x.toml")
    assert run("save", file, "--match", "cmd.*") == 0
    fake_board.put("axis1.position", 2**30 + 1)
    fake_board.put("cmd.position", 1, 0)
    assert run("load", file) == 1
    assert "cmd.position: 0, 0 rad is more than 1.68663e+06 rad away from the shaft" in capsys.readouterr().err


# ---- parameter files ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["board.toml", "board.json"])
def test_saved_values_can_be_compared_and_loaded(
    fake_port: FakePort, run: Run, fake_board: FakeServo, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(tmp_path / name)
    assert run("save", file) == 0
    assert run("diff", file) == 0
    saved = fake_board.get("param.i_q_limit")
    fake_board.put("param.i_q_limit", 5000, 6000)
    fake_board.written.clear()
    capsys.readouterr()
    assert run("diff", file) == 1
    assert "param.i_q_limit: 1.2588501, 1.51062012 A -> 2.00006104, 2.00006104 A" in capsys.readouterr().out
    assert fake_board.written == []
    assert run("load", file) == 0
    assert fake_board.get("param.i_q_limit") == saved
    assert [n for n, _, _ in fake_board.written] == ["param.i_q_limit"]
    assert run("diff", file) == 0


def test_a_saved_limit_can_be_loaded_again(
    fake_port: FakePort, run: Run, fake_board: FakeServo, tmp_path: Path
) -> None:
    """A limit that is rounded to a raw number may be slightly out of its range."""
    for name in ("param.speed_limit", "param.acceleration_limit", "param.i_q_limit", "param.host_timeout"):
        v = CATALOGUE[name]
        raw = [v.to_raw(v.minimum), v.to_raw(v.maximum)][: v.count]
        fake_board.put(name, *raw)
    before = {e.name: fake_board.peek(e.address, e.size) for e in fake_board.tables[0] if e.name.startswith("param.")}
    file = str(tmp_path / "x.toml")
    assert run("save", file) == 0
    fake_board.put("param.speed_limit", 10**9, 10**9)
    assert run("load", file) == 0
    assert {
        e.name: fake_board.peek(e.address, e.size) for e in fake_board.tables[0] if e.name.startswith("param.")
    } == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not toml", "x.toml"),
        ("[other]\na = 1", "no table [parameters]"),
        ("[parameters]\n'param.speed_limit' = ['fast', 1]", "'fast' is not a number"),
        ("[parameters]\n'param.features' = ['WARP', 0]", "'WARP' is not a number or one of the names none"),
        ("[parameters]\n'param.features' = [1.5, 0]", "1.5 is not a whole number"),
        (
            "[parameters]\n'param.position_min' = [5.0, 1.0]\n'param.position_max' = [4.0, 1.0]",
            "no motion would be possible",
        ),
        ("[parameters]\n'param.position_min' = [5000.0, 1.0]", "no motion would be possible"),
        ("catalogue_hash = 1\n[parameters]\n'param.features' = [1, 0]", "another version of the board"),
        ("[parameters]\n'param.speed_limit' = true", "is not a number, a name"),
        ("[parameters]\n'param.speed_limit' = [1.0]", "1 values in the file, 2 on the board"),
        ("[parameters]\n'param.unknown' = 1", "no parameter param.unknown"),
        ("[parameters]\n'param.speed_limit' = [1.0, 1e9]", "outside"),
        ("[parameters]\n'param.i_q_limit' = [1.0, 1.0]\n'axis1.speed' = 1.0", "can only be read"),
    ],
)
def test_invalid_files_are_refused_without_a_write(
    fake_port: FakePort,
    run: Run,
    fake_board: FakeServo,
    tmp_path: Path,
    text: str,
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "x.toml"
    file.write_text(text)
    assert run("load", str(file)) == 2
    assert message in capsys.readouterr().err
    assert fake_board.written == []


@pytest.mark.parametrize("name", ["board.toml", "board.json"])
def test_features_are_saved_by_name(
    fake_port: FakePort, run: Run, fake_board: FakeServo, tmp_path: Path, name: str
) -> None:
    fake_board.put("param.features", 0b11, 0)
    file = tmp_path / name
    assert run("save", str(file)) == 0
    assert '"ANTI_WINDUP+ENHANCED_MT"' in file.read_text()
    fake_board.put("param.features", 0, 5)
    assert run("load", str(file)) == 0
    assert fake_board.get("param.features") == [0b11, 0]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["tune", "none.toml"], "none.toml: No such file"),
        (["tune"], "write a FILE.toml"),
        (["tune", "bad.toml", "--dry-run"], "bad.toml: "),
        (["identify", "--voltage", "24", "--current", "4", "--config", "none.toml"], "no such file: none.toml"),
        (["identify", "--voltage", "24", "--current", "4", "--config", "bad.toml"], "bad.toml: "),
        (["identify", "--voltage", "24", "--current", "4", "--config", "a.toml"], "a.toml: board.nominal_voltage is"),
        (["identify", "--voltage", "24", "--current", "4", "--plant", "none.toml"], "none.toml: No such file"),
        (["identify", "--voltage", "24", "--current", "4", "--plant", "bad.toml"], "bad.toml: "),
        (["save"], "write a FILE for the parameters"),
        (["save", "bad.toml/x.toml"], "bad.toml"),
        (["load", "none.toml"], "none.toml: No such file"),
        (["diff", "bad.toml"], "bad.toml: "),
        (["record", "u_dc", "-o", "a.csv", "-o", "b.csv"], "only one output file"),
        (["record", "u_dc", "-o", "a.csv", "--level"], "--level needs a trigger"),
        (["record", "u_dc", "-o", "a.csv", "--before", "9"], "--before needs a trigger"),
        (["record", "u_dc", "-o", "a.csv", "--points", "9", "--duration", "1"], "--duration is not for bursts"),
        (["scope", "u_dc", "--level"], "--level needs a trigger"),
    ],
)
def test_files_and_arguments_are_checked_before_the_port_is_opened(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text("[")
    Path("a.toml").write_text("[axis1]\n")
    assert tool.main([*arguments, "--port", "/none"]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("command", ["save", "load", "diff"])
def test_a_file_of_another_kind_is_refused(
    fake_port: FakePort, run: Run, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command, str(tmp_path / "x.txt")) == 2
    assert "end with .toml or .json" in capsys.readouterr().err
    assert not (tmp_path / "x.txt").exists()


def test_flags_are_shown_as_they_are_written(
    fake_port: FakePort, run: Run, fake_board: FakeServo, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_board.put("param.features", 0, 9)
    assert run("get", "param.features") == 0
    assert "0, 9 (none, ANTI_WINDUP+DEAD_TIME)" in capsys.readouterr().out
    assert run("vars", "param.features") == 0
    assert "none, ANTI_WINDUP, ENHANCED_MT" in capsys.readouterr().out


def test_a_missing_file_is_reported(
    fake_port: FakePort, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("load", str(tmp_path / "no.toml")) == 2
    assert "no.toml: No such file" in capsys.readouterr().err


# ---- other boards -------------------------------------------------------------------------------------------------
def test_an_unknown_board_is_read_and_written_by_its_own_types(
    foreign_target: FakeTarget, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("set", "gain", "1.5") == 0
    assert run("set", "mode", "turbo") == 0
    assert run("set", "table[1]", "-7") == 0
    capsys.readouterr()
    assert run("get", "gain", "mode", "temperature", "table", "memory") == 0
    out, err = capsys.readouterr()
    assert [line.split("=")[1].strip() for line in out.splitlines()] == [
        "1.5", "1 (TURBO)", "0", "0, -7, 0", "00 " * 19 + "00",
    ]  # fmt: skip
    assert "values are not scaled" in err
    assert run("set", "gain", "100") == 2
    assert run("info") == 0
    assert "has no variable catalogue_hash" in capsys.readouterr().out
    assert run("vars") == 0
    assert "q3.12" in capsys.readouterr().out


def test_members_of_structures_are_variables(
    foreign_target: FakeTarget, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("set", "drive.loops[1].limits", "-5,5") == 0
    assert foreign_target.peek(0x1048, 4) == b"\xfb\xff\x05\x00"
    assert run("set", "drive.loops[1].limits[0]", "-6") == 0
    capsys.readouterr()
    assert run("get", "--json", "drive", "drive.loops[1]") == 0
    assert json.loads(capsys.readouterr().out) == {
        "drive.loops[0].gain": 0.0,
        "drive.loops[0].limits": [0, 0],
        "drive.loops[1].gain": 0.0,
        "drive.loops[1].limits": [-6, 5],
    }
    assert run("watch", "drive.loops[0]", "--count", "1") == 0
    assert "drive.loops[0].gain=0" in capsys.readouterr().out
    assert run("set", "drive.loops[0]", "1") == 2
    assert "write its members, such as drive.loops[0].gain" in capsys.readouterr().err


# ---- boards of version 3, and boards with passwords ---------------------------------------------------------------
@pytest.mark.parametrize("big_endian", [False, True])
def test_a_board_of_version_3_is_read_and_written(
    tmp_path: Path, run: Run, big_endian: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [
        FakeEntry("loop_t", None, 0, 6, 0),
        FakeEntry("gain", b"\xf4:3.12", 0, 2, 2),
        FakeEntry("limits", b"\xf1", 2, 4, 2),
        FakeEntry("loop", b"loop_t", 0x1000, 6, RW),
        FakeEntry("curve", b"\xf2", 0x1100, 120, RW),
        FakeEntry("count", b"\xe3", 0x1200, 8, RO),
        FakeEntry("ratio", b"\xfb", 0x1208, 8, RO),
    ]
    target = FakeTargetV3(tables=[rows], big_endian=big_endian)
    target.build()
    target.set_int(0x1200, 2**63 + 1, 8)
    file = str(tmp_path / "x.json")
    with FakePort(tmp_path / "ttyFAKE", target):
        assert run("info") == 0
        out = capsys.readouterr().out
        assert "FreeMASTER v3 2.0" in out
        assert "oracle v3 board" in out
        assert run("set", "loop.limits", "-3,4") == 0
        assert run("set", "curve", ",".join(str(k) for k in range(30))) == 0
        assert run("save", file, "--match", "*") == 0
        target.poke(0x1000, bytes(6))
        target.poke(0x1100, bytes(120))
        assert run("load", file) == 0
        capsys.readouterr()
        assert run("get", "--json", "loop", "curve", "count", "ratio") == 0
        assert json.loads(capsys.readouterr().out) == {
            "loop.gain": 0.0, "loop.limits": [-3, 4], "curve": list(range(30)), "count": 2**63 + 1, "ratio": 0.0,
        }  # fmt: skip
        assert run("watch", "loop", "count", "--count", "2") == 0
        assert "count=9223372036854775809" in capsys.readouterr().out


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[FakeTarget]:
    rows = [FakeEntry("x", b"\xf1", 0x1000, 2, RW)]
    target = FakeTarget(tables=[rows], passwords={1: "look", 2: "move"})
    target.build()
    with FakePort(tmp_path / "ttyFAKE", target):
        yield target


def test_a_password_gives_its_access_level(locked: FakeTarget, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--password", "look", "get", "x") == 0
    locked.reset()
    assert run("set", "x", "7", "--password", "look") == 1
    assert (
        "password needed; set the environment variable SERVO_PASSWORD to a password of this level"
        in capsys.readouterr().err
    )
    assert run("set", "x", "7", "--password", "move") == 0
    assert locked.peek(0x1000, 2) == b"\x07\x00"
    assert run("info", "--password", "look") == 0
    assert "to view" in capsys.readouterr().out
    locked.reset()
    assert run("get", "x", "--password", "wrong") == 1
    assert "wrong password; check the password" in capsys.readouterr().err


def test_a_password_is_taken_from_the_environment(
    locked: FakeTarget, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SERVO_PASSWORD", "move")
    assert run("set", "x", "9") == 0
    locked.reset()
    assert run("set", "x", "9", "--password", "look") == 1, "the command line has precedence"


def test_log_prints_the_text_of_the_board(
    foreign_target: FakeTarget, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign_target.pipe += b"0 reset\n8 axis1 INIT\n"
    assert run("log") == 0
    assert capsys.readouterr().out == "0 reset\n8 axis1 INIT\n"
    assert run("log") == 0
    assert capsys.readouterr().out == "", "printed lines are removed from the pipe"
    assert run("log", "--pipe", "2") == 1
    assert "pipe 2: pipe error; the board reports 0 pipes" in capsys.readouterr().err
    assert run("log", "--pipe", "200") == 1
    assert "pipe 200 is not 1 .. 127" in capsys.readouterr().err


def test_a_password_is_requested_at_a_terminal(
    locked: FakeTarget, run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("get", "x") == 1
    assert "password needed" in capsys.readouterr().err
    answers = ["move"]
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("getpass.getpass", lambda prompt: answers.pop())
    assert run("set", "x", "9") == 0
    assert answers == []


def test_values_beyond_the_capacity_of_the_scope_are_read_separately(
    foreign_target: FakeTarget, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.csv"
    assert run("record", "gain", "table", "-o", str(file), "--duration", "0.1", "--rate", "100") == 0
    assert "each was read separately" in capsys.readouterr().out
    assert file.read_text().splitlines()[0] == "time [s],gain,table[0],table[1],table[2]"


def test_a_servo_board_of_another_version_is_not_written(
    fake_port: FakePort, run: Run, fake_board: FakeServo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(tmp_path / "x.toml")
    assert run("save", file) == 0
    fake_board.put("catalogue_hash", 1)
    assert run("set", "cmd.enable", "1,1") == 1
    assert "flash the firmware" in capsys.readouterr().err
    assert run("load", file) == 1
    assert fake_board.written == []
    assert run("get", "axis1.position") == 0
    assert run("set", "--raw", "param.host_timeout", "777") == 0
    assert fake_board.get("param.host_timeout") == [777]


# ---- failures -----------------------------------------------------------------------------------------------------
def test_a_missing_port_is_reported_in_one_line(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", "--port", "/dev/ttyNOPE") == 1
    err = capsys.readouterr().err
    assert "the port /dev/ttyNOPE does not exist" in err
    assert err.count("\n") == 1


def test_a_device_of_another_protocol_is_reported(tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    with FakePort(tmp_path / "ttyFAKE", NoiseDevice()):
        assert run("info") == 1
    assert "not FreeMASTER" in capsys.readouterr().err


def test_a_board_without_answers_is_reported(fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    fake_port.silent = True
    assert run("info", "--baud", "57600") == 1
    assert "no response at 57600 baud" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "COMMAND"),
        (["jump"], "'jump'"),
        (["get"], "NAME"),
        (["info", "--baud", "abc"], "'abc' is not a finite number"),
        (["info", "--baud", "9600.5"], "'9600.5' is not a whole number"),
        (["info", "--port", ""], "empty; write a device"),
        (["watch", "x", "--rate", "-1"], "'-1' is too small; write a number above 0"),
        (["watch", "x", "--count", "-1"], "'-1' is too small; write a whole number from 1"),
    ],
)
def test_wrong_command_lines_are_usage_errors(
    run: Run, arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 2
    err = capsys.readouterr().err
    assert "usage: servo-tool" in err
    assert text in err


def test_baud_rate_is_taken_from_the_environment(
    fake_port: FakePort, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SERVO_BAUD", "fast")
    assert run("info") == 2
    monkeypatch.setenv("SERVO_BAUD", "9600")
    assert run("info") == 0


# ---- as a process -------------------------------------------------------------------------------------------------
@contextlib.contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The tool as a process, which is ended with the test."""
    tool_process = subprocess.Popen(
        with_parent_death_signal([sys.executable, "-m", "servo_bridge.tool", *arguments]),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    with tool_process:
        try:
            yield tool_process
        finally:
            tool_process.kill()  # else the end of `with` would block


def test_ctrl_c_ends_a_recording_with_a_complete_file(fake_port: FakePort, tmp_path: Path) -> None:
    file = tmp_path / "x.csv"
    with process("--port", fake_port.path, "record", "u_dc", "-o", str(file)) as tool_process:
        limit = time.monotonic() + 20.0
        while not (file.exists() and file.stat().st_size > 8000):
            assert time.monotonic() < limit
            time.sleep(0.01)
        tool_process.send_signal(signal.SIGINT)
        out, err = tool_process.communicate(timeout=20)
    assert (tool_process.returncode, err) == (0, "")
    rows = int(out.split(" rows")[0])
    assert len(file.read_text().splitlines()) == rows + 1


def test_closed_output_pipe_ends_the_tool(fake_port: FakePort) -> None:
    with process("--port", fake_port.path, "watch", "tick", "--rate", "500") as tool_process:
        assert tool_process.stdout is not None
        assert "tick=" in tool_process.stdout.readline()
        tool_process.stdout.close()
        assert tool_process.wait(20) == 141
        assert tool_process.stderr is not None
        assert tool_process.stderr.read() == ""
