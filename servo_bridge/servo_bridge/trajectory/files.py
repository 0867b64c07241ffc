"""Waypoints from files: CSV, or JSON in the form of trajectory_msgs/JointTrajectory. SI units."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any, Final

from servo_msgs_py.text_file import TextFileError, parse_json, read_text

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.waypoints import Waypoints, check_count

_BYTES_MAX: Final = 32_000_000
"""Largest file: that of `WAYPOINTS_MAX` points of two joints with all fields in JSON [bytes]."""

_SHOWN_MAX: Final = 80
"""Characters of a wrong value in a message."""

_VELOCITY = "_velocity"
_POINT = ("time_from_start", "positions", "velocities", "accelerations", "effort")


def read_waypoints(file: str | File) -> Waypoints:
    """Read waypoints; the format is given by the suffix.

    ``.csv``: a header with ``time``, joint names, and ``<joint>_velocity`` for all of them or none, in any order; one
    line per waypoint. Empty lines and lines that begin with ``#`` are ignored.

    ``.json``: an object with ``joint_names`` and ``points``, each with ``time_from_start`` (a number, or ``sec`` and
    ``nanosec``), ``positions``, and optionally ``velocities``, ``accelerations`` and ``effort``.

    Parameters
    ----------
    file : str or pathlib.Path
        File; whether its joints exist is not checked.

    Raises
    ------
    TrajectoryError
        If the file cannot be read or is invalid: file, line or point, and remedy.
    """
    path = File(file)
    readers = {".csv": _from_csv, ".json": _from_json}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise TrajectoryError(f"{path}: unknown format; use a file whose name ends with .csv or .json")
    try:
        return reader(read_text(path, _BYTES_MAX))
    except OSError as error:
        raise TrajectoryError(f"{path}: cannot be read ({error.strerror}); check name and permissions") from None
    except TextFileError as error:
        raise TrajectoryError(f"{path}: {error}") from None
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}", error.code) from None


def _from_csv(text: str) -> Waypoints:
    reader = csv.reader(text.splitlines(), skipinitialspace=True)
    lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row and any(map(str.strip, row))]
    lines = [(number, row) for number, row in lines if not row[0].startswith("#")]
    if not lines:
        raise TrajectoryError("line 1: the file is empty; begin with a header such as time,axis1,axis2")
    number, header = lines[0]
    joints = _joints_of(number, header)
    check_count(len(lines) - 1)
    times: list[float] = []
    rows: list[dict[str, float]] = []
    for number, row in lines[1:]:
        if len(row) != len(header):
            raise TrajectoryError(f"line {number}: {len(row)} values for {len(header)} columns; write one per column")
        values = {name: _number(number, name, cell) for name, cell in zip(header, row, strict=True)}
        if times and values["time"] <= times[-1]:
            raise TrajectoryError(
                f"line {number}: time {values['time']:g} s is not after {times[-1]:g} s; order the lines by time"
            )
        times.append(values["time"])
        rows.append(values)
    if not rows:
        raise TrajectoryError(f"line {number}: no line after the header; add one line per waypoint")
    positions = [[row[joint] for joint in joints] for row in rows]
    moving = joints[0] + _VELOCITY in header
    velocities = [[row[joint + _VELOCITY] for joint in joints] for row in rows] if moving else None
    return Waypoints.of(joints, times, positions, velocities)


def _joints_of(number: int, header: Sequence[str]) -> list[str]:
    """Joints of the header: its columns but the time and the velocities of others."""
    for name in header:
        if not name:
            raise TrajectoryError(f"line {number}: a column has no name; begin with time and names of joints")
        if header.count(name) > 1:
            raise TrajectoryError(f"line {number}: column {name} occurs twice; remove one")
    velocities = {joint + _VELOCITY for joint in header}
    joints = [name for name in header if name != "time" and name not in velocities]
    if "time" not in header or not joints:
        raise TrajectoryError(f"line {number}: no column time, or no joint; begin with time and names of joints")
    moving = {joint for joint in joints if joint + _VELOCITY in header}
    if moving and moving != set(joints):
        odd = sorted(moving ^ set(joints))[0]
        raise TrajectoryError(
            f"line {number}: {odd} has only one of position and velocity; write velocities of all joints or of none"
        )
    return joints


def _number(line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TrajectoryError(f"line {line}: {name} is {cell!r}; write a finite number")
    return value


def _from_json(text: str) -> Waypoints:
    content = parse_json(text)
    if not isinstance(content, dict) or not all(
        isinstance(content.get(key), list) for key in ("joint_names", "points")
    ):
        raise TrajectoryError("joint_names or points is missing or not a list; write an object with both")
    joints = content["joint_names"]
    for joint in joints:
        if not isinstance(joint, str):
            raise TrajectoryError(f"{_shown(joint)} in joint_names is no name; write the name of a joint")
    points: list[Any] = content["points"]
    check_count(len(points))
    for k, point in enumerate(points):
        if not isinstance(point, dict) or not {"time_from_start", "positions"} <= point.keys() <= set(_POINT):
            raise TrajectoryError(
                f"point #{k} lacks time_from_start or positions, or has a field besides {', '.join(_POINT)}; correct it"
            )
    times = [_seconds(k, point["time_from_start"]) for k, point in enumerate(points)]
    return Waypoints.of(joints, times, *([_row(k, p, f) for k, p in enumerate(points)] for f in _POINT[1:]))


def _row(k: int, point: dict[str, Any], field: str) -> list[float] | None:
    row: Any = point.get(field, [])
    if isinstance(row, list) and all(_is_number(x) for x in row):
        return row or None
    raise TrajectoryError(f"{field} of point #{k} is {_shown(row)}; write a list of numbers")


def _seconds(k: int, time: Any) -> float:
    if _is_number(time):
        return float(time)
    if isinstance(time, dict) and time.keys() == {"sec", "nanosec"}:
        sec, nanosec = time["sec"], time["nanosec"]
        if _is_whole(sec) and _is_whole(nanosec) and 0 <= nanosec < 1_000_000_000:
            return float(sec + 1.0e-9 * nanosec)
    raise TrajectoryError(
        f"time_from_start of point #{k} is {_shown(time)}; write seconds as a number, or as an object with the whole "
        "numbers sec and nanosec (0 to 999999999)"
    )


def _is_number(value: object) -> bool:
    """Whether it is a number that a float can have; infinities and NaN are refused with the waypoints."""
    return isinstance(value, float) or _is_whole(value)


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 2**63


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHOWN_MAX else f"{text[:_SHOWN_MAX]} ..."
