"""Tables of a recording as files that other programs read."""

from __future__ import annotations

import csv
import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand, applied_message, joint_state, snapshot_message
from servo_msgs_py.run_file.definitions import encoded
from servo_msgs_py.run_file.topic import Topic, type_of
from servo_msgs_py.run_file.writer import RunWriter
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_twin.board import Board
from servo_twin.runs.command import main
from servo_twin.runs.curves import TIME, curves_of
from servo_twin.validation.simulated_run import EPOCH_NS, SimulatedRun
from std_msgs.msg import Float64, Float64MultiArray, String

SEED = 3
SPEED = 50.0  # [rad/s]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    with SimulatedRun(path, Board(seed=SEED, level="ideal"), seed=SEED) as simulated:
        simulated.enable()
        simulated.write("cmd.speed", [SPEED, 0.0], mask=1)
        simulated.wait(0.2)
    return path


def exported(capsys: pytest.CaptureFixture[str], run: Path, folder: Path, *options: str) -> dict[str, Any]:
    assert main(["export", str(run), "-o", str(folder), "--json", *options]) == 0
    document = json.loads(capsys.readouterr().out)
    tables: dict[str, Any] = {Path(table["path"]).stem: table for table in document.pop("tables")}
    return {**tables, **document}


def columns_of(path: Path) -> dict[str, list[float | int]]:
    """Columns of a file by their heads."""
    if path.suffix == ".parquet":
        parquet: Any = importlib.import_module("pyarrow.parquet")
        return dict(parquet.read_table(path).to_pydict())
    with path.open(newline="") as file:
        heads, *rows = csv.reader(file)
    numbers = [[float(word) if "." in word or "n" in word else int(word) for word in row] for row in rows]
    return dict(zip(heads, map(list, zip(*numbers, strict=True)), strict=True))


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_telemetry_and_commands_are_read_back_exactly(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    tables = exported(capsys, run, tmp_path, "--format", suffix)
    telemetry = columns_of(tmp_path / f"servo.snapshot.{suffix}")
    (block,) = curves_of(run).blocks()
    for head, name in (("time [s]", TIME), ("axis1.speed [rad/s]", "axis1.speed"), ("axis2.i_q [A]", "axis2.i_q")):
        np.testing.assert_array_equal(telemetry[head], block[name])
    assert tables["servo.snapshot"]["rows"] == len(block)
    ticks = np.array(telemetry["tick [PWM periods]"], np.int64)
    np.testing.assert_array_equal(telemetry["ros_time [ns]"], EPOCH_NS + ticks * 62_500)
    command = columns_of(tmp_path / f"servo.commands_applied.cmd.speed.{suffix}")
    assert command["cmd.speed[0] [rad/s]"][-1] == pytest.approx(SPEED, rel=1e-3)
    assert np.isnan(command["cmd.speed[1] [rad/s]"][-1])
    assert command["mask"][-1] == 1
    assert tables["left_out"] == {"/servo/run_info": 1, "/servo/tuning": 1}
    assert tables["missing"] == []


def test_an_exported_table_is_compared_with_its_recording(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exported(capsys, run, tmp_path, "--topic", "/servo/snapshot")
    table = tmp_path / "servo.snapshot.csv"
    assert [path.name for path in tmp_path.iterdir()] == [table.name]
    for reference in (run, table):
        assert main(["compare", "--json", "--at", "reset", str(reference), str(table)]) == 0
        differences = json.loads(capsys.readouterr().out)[table.name]["differences"]
        assert {"axis1.speed", "log_time", "ros_time"} & {one["variable"] for one in differences} == {"axis1.speed"}
        assert not any(one["size"] for one in differences)


def test_joints_single_variables_and_foreign_messages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, folder = tmp_path / "run.mcap", tmp_path / "out"
    words = encode_points(Catalogue.load(), [TimedPoint(0, 800, 1.5, -2.0, 0.1), TimedPoint(1, 900, -3.0, 0.0)])
    writer = RunWriter(run)
    for topic, message in (
        ("/twin/joint_states", joint_state(["pan"], 2_000_000_001, [0.5], [1.5])),
        ("/servo/var/pan/i_q", Float64(data=2.5)),
        ("/servo/winding_temperatures", Float64MultiArray(data=[20.0, 30.0])),
        ("/other/../array", Float64MultiArray(data=[1.0])),
        ("/other/../array", Float64MultiArray(data=[1.0, 2.0])),
        ("/servo/state", String(data="READY")),
        ("/servo/commands_applied", applied_message(AppliedCommand("cmd.points", 16, tuple(words), 3))),
    ):
        writer.write(Topic(topic, type_of(type(message))), encoded(message), 7)
    writer.write(Topic("/servo/snapshot", "std_msgs/msg/Float64MultiArray"), b"\0\1\0\0damaged", 7)
    writer.close()
    tables = exported(capsys, run, folder)
    states = columns_of(folder / "twin.joint_states.csv")
    assert states["ros_time [ns]"] == [2_000_000_001]
    assert (states["pan.position [rad]"], states["pan.velocity [rad/s]"]) == ([0.5], [1.5])
    assert columns_of(folder / "servo.var.pan.i_q.csv") == {"log_time [ns]": [7], "data [A]": [2.5]}
    assert columns_of(folder / "servo.winding_temperatures.csv")["axis2.winding_temperature [deg C]"] == [30.0]
    points = columns_of(folder / "servo.commands_applied.cmd.points.csv")
    assert (points["axis"], points["point.tick [PWM periods]"]) == ([1, 2], [800, 900])
    assert points["point.position [rad]"] == pytest.approx([1.5, -3.0], abs=1e-3)
    assert points["point.velocity [rad/s]"] == pytest.approx([-2.0, 0.0], abs=1e-3)
    assert points["point.current [A]"] == pytest.approx([0.1, 0.0], abs=1e-3)
    assert tables["other....array"]["columns"] == 2
    assert tables["other....array.2"]["columns"] == 3
    assert tables["left_out"] == {"/servo/state": 1}
    assert len(tables["missing"]) == 1
    assert tables["missing"][0].startswith("/servo/snapshot: the message is no std_msgs/msg/Float64MultiArray")


def test_a_table_ends_where_the_time_begins_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run.mcap"
    with RunWriter(run) as writer:
        for tick in (8.0, 16.0, 8.0, 24.0):
            message = snapshot_message(["tick", "u_dc"], [[tick, 24.0]])
            writer.write(Topic("/servo/snapshot", type_of(type(message))), encoded(message), 7)
    tables = exported(capsys, run, tmp_path)
    assert [tables[name]["rows"] for name in ("servo.snapshot", "servo.snapshot.2")] == [2, 2]
    assert columns_of(tmp_path / "servo.snapshot.2.csv")["tick [PWM periods]"] == [8.0, 24.0]


def test_curves_of_the_viewer_become_a_table(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    curves = tmp_path / "curves.rrd"
    assert main(["replay", str(run), "-o", str(curves)]) == 0
    capsys.readouterr()
    exported(capsys, curves, tmp_path)
    table = columns_of(tmp_path / "curves.csv")
    (block,) = curves_of(run).blocks()
    assert table["time [s]"] == pytest.approx(block[TIME])
    np.testing.assert_array_equal(table["axis1.speed [rad/s]"], block["axis1.speed"])


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_full_disk_is_said_with_the_name_of_the_file(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    file = tmp_path / f"servo.parameters.{suffix}"
    file.symlink_to("/dev/full")
    assert main(["export", str(run), "-o", str(tmp_path), "--format", suffix]) != 0
    error = capsys.readouterr().err
    assert str(file) in error
    assert "No space left on device" in error


def test_nothing_to_export_is_wrong_input(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(run), "-o", str(tmp_path), "--topic", "/servo/snapshots"]) == 2
    assert "run.mcap has no table of /servo/snapshots" in capsys.readouterr().err
