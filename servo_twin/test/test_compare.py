"""Comparison of runs from all their files, and their alignment."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from servo_msgs_py.run_file.reader import RunReader
from servo_msgs_py.trace import Trace
from servo_twin.board import Board
from servo_twin.diagnosis.board_pair import Motion
from servo_twin.runs.alignment import shift_of
from servo_twin.runs.command import main
from servo_twin.runs.compare import compare
from servo_twin.runs.curves import TIME, curves_of
from servo_twin.validation.simulated_run import SimulatedRun
from servo_twin.view.recording import Recording

SEED = 5


def record(path: Path, *, friction: float = 1.0, wait: float = 0.0) -> Path:
    """Record a run that begins with a wait, and whose friction changes after a second of motion."""
    with SimulatedRun(path, Board(seed=SEED, level="ideal"), seed=SEED) as run:
        run.wait(wait)
        run.enable()
        motion = Motion(run, SEED)
        list(motion.run(1.0))
        run.board.set_plant("axis2.friction", friction * run.board.plant.axes[1].friction)
        list(motion.run(2.0))
    return path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("runs")
    return record(folder / "first.mcap"), record(folder / "second.mcap", friction=2.0)


def compared(capsys: pytest.CaptureFixture[str], *arguments: str, status: int) -> Any:
    assert main(["compare", "--json", *arguments]) == status
    return json.loads(capsys.readouterr().out)


def test_a_run_equals_itself(runs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    first = str(runs[0])
    (result,) = compared(capsys, first, first, status=0).values()
    assert result["shift"] == 0.0
    assert not any(one["size"] for one in result["differences"])


def test_the_largest_differences_are_named_with_their_noise(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = [tmp_path / "picture.svg", tmp_path / "runs.rrd"]
    options = [option for path in outputs for option in ("-o", str(path))]
    result = compared(capsys, *map(str, runs), *options, status=1)["second.mcap"]
    largest = {one["variable"]: one for one in result["differences"][:10]}
    assert result["shift"] == 0.0
    assert largest["axis2.i_q"]["beyond"] > 1.4
    assert abs(largest["axis2.i_q"]["size"]) > largest["axis2.i_q"]["noise"]
    assert all(path.stat().st_size > 10_000 for path in outputs)


@pytest.mark.parametrize("suffix", [".rrd", ".png"])
def test_full_disk_is_one_line_with_the_name_of_the_file(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    full = tmp_path / f"runs{suffix}"
    full.symlink_to("/dev/full")
    assert main(["compare", *map(str, runs), "-o", str(full)]) == 1
    assert capsys.readouterr().err == f"servo-twin: {full}: No space left on device\n"


@pytest.mark.parametrize("way", ["fit", "applied_count"])
def test_a_later_run_is_shifted_to_the_first(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], way: str
) -> None:
    later = record(tmp_path / "later.mcap", wait=1.0)
    result = compared(capsys, str(runs[0]), str(later), "--at", way, status=1)["later.mcap"]
    assert result["shift"] == pytest.approx(-0.9, abs=0.03)


def test_csv_and_rerun_files_are_compared_with_a_recording(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = list(curves_of(runs[0]).blocks())
    names = ["axis1.speed", "axis2.speed", "axis1.position", "axis1.i_q"]
    rows = np.concatenate([block.table(["tick", *names]) for block in blocks])
    table = tmp_path / "record.csv"
    head = ",".join(["time [s]", "tick", *(f"{name} [x]" for name in names)])
    start = float(rows[0, 0]) * 62.5e-6
    lines = [",".join(map(repr, [row[0] * 62.5e-6 - start, *row])) for row in rows.tolist()]
    table.write_text("\n".join([head, *lines]))
    assert not any(
        one["size"] for one in compared(capsys, str(runs[0]), str(table), status=0)["record.csv"]["differences"]
    )

    recording = Recording(tmp_path / "viewer.rrd")
    time = rows[:, 0] * 62.5e-6 - start
    for column, (axis, quantity) in enumerate([(1, "speed"), (2, "speed"), (1, "position"), (1, "i_q")], 1):
        recording.scalars(f"/plot/axis{axis}/{quantity}/board", time, rows[:, column])
    recording.close()
    result = compared(capsys, str(runs[0]), str(tmp_path / "viewer.rrd"), status=0)["viewer.rrd"]
    assert result["shift"] == pytest.approx(start, abs=1e-4)


def test_a_bag_of_rosbag2_is_compared(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/servo/snapshot", "std_msgs/msg/Float64MultiArray", typestore=store)
        for record in RunReader(runs[0]).records({"/servo/snapshot"}):
            writer.write(connection, record.time_ns, record.data)
    result = compared(capsys, str(runs[0]), str(tmp_path / "bag"), status=0)["bag"]
    assert not any(one["size"] for one in result["differences"])
    assert main(["replay", str(tmp_path / "bag")]) == 0
    text = capsys.readouterr().out
    assert "no /servo/commands_applied: commands cannot be repeated" in text


def test_what_cannot_be_compared_is_refused(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, other = map(str, runs)
    assert main(["compare", first]) == 2
    assert main(["compare", first, other, "--at", "axis1.nothing"]) == 2
    assert main(["compare", first, other, "-o", "picture.jpg"]) == 2
    (tmp_path / "text.csv").write_text("a,b\n1,2\n")
    (tmp_path / "columns.csv").write_text("time,axis1.speed\n1,2,3\n")
    assert main(["compare", first, str(tmp_path / "columns.csv")]) == 2
    assert "has 3 values for 2 columns; give a file" in capsys.readouterr().err
    assert main(["compare", first, str(tmp_path / "text.csv")]) == 2
    assert "has no column time in its first line" in capsys.readouterr().err
    assert main(["compare", first, str(tmp_path / "run.txt")]) == 2
    error = capsys.readouterr().err
    assert all(kind in error for kind in (".mcap or .db3 file", "folder of a bag", ".rrd file", ".csv file"))
    table = tmp_path / "endless.csv"
    table.write_text("time,axis1.speed\n0,1\n")
    os.truncate(table, 10**12)  # a line without end
    assert main(["compare", first, str(table)]) == 2
    assert "give a file of servo-tool record" in capsys.readouterr().err


@dataclass
class Made:
    """Curves made of numbers."""

    trace: Trace
    size: int
    path: Path = Path("made")

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Trace]:
        for begin in range(0, len(self.trace), self.size):
            yield self.trace.samples(begin, begin + self.size)


@given(st.integers(1, 50), st.integers(1, 50), st.integers(0, 200), st.floats(-0.3, 0.3))
def test_blocks_of_any_size_give_the_same_comparison(first: int, second: int, at: int, shift: float) -> None:
    time = 0.01 * np.arange(201)
    speeds = {f"axis{axis}.speed": np.sin(axis * 3.0 * time) for axis in (1, 2)}
    bumped = speeds["axis1.speed"].copy()
    bumped[at] += 0.01
    reference = Made(Trace(0.0, {TIME: time, **speeds}), first)
    other = Made(Trace(0.0, {TIME: time - shift, **speeds, "axis1.speed": bumped}), second)
    assert shift_of(reference, other, "fit") == pytest.approx(shift, abs=1e-3)
    result = compare(reference, other, shift, {})
    assert (result.samples, result.differences[0].variable) == (201, "axis1.speed")
    assert result.differences[0].size == pytest.approx(-0.01, abs=1e-6)
    assert result.differences[0].time == pytest.approx(time[at])
