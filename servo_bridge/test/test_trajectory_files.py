"""Waypoints from files: valid forms, and messages for errors."""

from __future__ import annotations

import contextlib
import json
import tempfile
from pathlib import Path as File

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.files import read_waypoints
from servo_bridge.trajectory.waypoints import Waypoints


def read(folder: File, name: str, text: str) -> Waypoints:
    file = folder / name
    file.write_text(text)
    return read_waypoints(file)


def test_a_csv_file_gives_waypoints(tmp_path: File) -> None:
    text = "# a comment\ntime, axis2, axis1, axis1_velocity, axis2_velocity\n\n0, 1, 2, 3, 4\n0.5, 5, 6, 0, 0\n"
    waypoints = read(tmp_path, "path.csv", text)
    assert waypoints.joints == ("axis2", "axis1")
    np.testing.assert_array_equal(waypoints.times, [0.0, 0.5])
    np.testing.assert_array_equal(waypoints.positions, [[1, 2], [5, 6]])
    np.testing.assert_array_equal(waypoints.velocities, [[4, 3], [0, 0]])
    assert np.isnan(read(tmp_path, "path.csv", "time,axis1\n1,2\n").velocities).all()


def test_a_json_file_gives_waypoints(tmp_path: File) -> None:
    text = """{"joint_names": ["axis1"], "points": [
        {"time_from_start": 1, "positions": [2], "velocities": [3.5], "accelerations": [4], "effort": [0.5]},
        {"time_from_start": {"sec": 2, "nanosec": 500000000}, "positions": [3], "velocities": []}]}"""
    waypoints = read(tmp_path, "path.json", text)
    np.testing.assert_array_equal(waypoints.times, [1.0, 2.5])
    np.testing.assert_array_equal(waypoints.velocities, [[3.5], [np.nan]])
    np.testing.assert_array_equal(waypoints.efforts, [[0.5], [0.0]])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "line 1: the file is empty; begin with a header"),
        ("time,,axis1\n", "line 1: a column has no name; begin with time and names of joints"),
        ("time,axis1,axis1\n", "line 1: column axis1 occurs twice; remove one"),
        ("axis1,axis2\n", "line 1: no column time, or no joint; begin with time and names"),
        ("time,axis1,axis2,axis2_velocity\n", "line 1: axis1 has only one of position and velocity"),
        ("time,axis1\n", "line 1: no line after the header"),
        ("time,axis1\n0,1\n\n1,2,3\n", "line 4: 3 values for 2 columns"),
        ("time,axis1\n0,1\n1,fast\n", "line 3: axis1 is 'fast'; write a finite number"),
        ("time,axis1\n0,1\n1,nan\n", "line 3: axis1 is 'nan'; write a finite number"),
        ("time,axis1\n" + "?\n" * 100_001, "there are 100001 waypoints, more than 100000; send the path in parts"),
        ("time,axis1\n0,1\n0,2\n", "line 3: time 0 s is not after 0 s; order the lines by time"),
    ],
)
def test_a_wrong_csv_file_is_refused(tmp_path: File, text: str, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=f"path.csv: {sentence}"):
        read(tmp_path, "path.csv", text)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('{"joint_names": ["axis1"],\n "points": [}', "line 2: .* at column 13; correct the JSON"),
        ("[]", "joint_names or points is missing"),
        ("1" * 5000, "an integer has more digits than Python converts"),
        ('{"joint_names": [1], "points": []}', "1 in joint_names is no name; write the name of a joint"),
        ('{"joint_names": ["axis1"], "points": []}', "there are no waypoints"),
        ('{"joint_names": ["axis1"], "points": [{"time_from_start": 0}]}', "point #0 lacks time_from_start or pos"),
        (
            '{"joint_names": ["axis1"], "points": [{"time_from_start": 0, "positions": [0], "velocity": [0]}]}',
            "point #0 lacks .* or has a field besides",
        ),
        (
            '{"joint_names": ["axis1"], "points": [{"time_from_start": 0, "positions": ["a"]}]}',
            r'positions of point #0 is \["a"\]; write a list of numbers',
        ),
        (
            '{"joint_names": ["axis1"], "points": [{"time_from_start": 1, "positions": [0, 1]}]}',
            r"mismatch between joint_names size \(1\) and positions \(2\) at point #0",
        ),
    ],
)
def test_a_wrong_json_file_is_refused(tmp_path: File, text: str, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=f"path.json: {sentence}"):
        read(tmp_path, "path.json", text)


@pytest.mark.parametrize(
    "time",
    [
        *("1 s", None, True, [1], {}, {"secs": 1}, {"sec": 1}, {"nanosec": 1}, {"sec": 1, "nanosec": 2, "stamp": 3}),
        *(
            {"sec": 1.5, "nanosec": 0},
            {"sec": 1, "nanosec": 10**9},
            {"sec": 1, "nanosec": -1},
            {"sec": True, "nanosec": 0},
        ),
        *({"sec": None, "nanosec": 0}, {"sec": 10**400, "nanosec": 0}, 10**400),
    ],
)
def test_malformed_times_are_refused(tmp_path: File, time: object) -> None:
    text = json.dumps({"joint_names": ["axis1"], "points": [{"time_from_start": time, "positions": [0]}]})
    with pytest.raises(
        TrajectoryError, match=r"path\.json: time_from_start of point #0 is .{2,90}; write seconds as a n"
    ):
        read(tmp_path, "path.json", text)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.just(10**400) | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner) | st.dictionaries(st.sampled_from(["sec", "nanosec", "positions"]) | st.text(), inner)
    ),
)


@given(st.sampled_from(["joint_names", "points", "time_from_start", "positions", "velocities", "effort"]), VALUES)
def test_any_value_is_accepted_or_refused_by_name(field: str, value: object) -> None:
    point: dict[str, object] = {"time_from_start": 1, "positions": [0]}
    content: dict[str, object] = {"joint_names": ["axis1"], "points": [point]}
    (content if field in content else point)[field] = value
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(TrajectoryError):
        assert len(read(File(folder), "path.json", json.dumps(content)).times)


def test_unreadable_files_are_reported(tmp_path: File) -> None:
    with pytest.raises(TrajectoryError, match=r"path\.txt: unknown format; use a file"):
        read(tmp_path, "path.txt", "")
    with pytest.raises(TrajectoryError, match=r"none\.csv: cannot be read \(No such file or directory\)"):
        read_waypoints(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"time,axis1\n\xff\n")
    with pytest.raises(TrajectoryError, match=r"bytes\.csv: line 2: the byte 0xff is not UTF-8"):
        read_waypoints(tmp_path / "bytes.csv")
