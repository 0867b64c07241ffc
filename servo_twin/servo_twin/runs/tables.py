"""Messages of a recording as rows of tables: one table per topic, and per command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand, applied_from_message, columns, snapshot_table
from servo_msgs_py.run_file.definitions import decoded
from servo_msgs_py.run_file.reader import Record
from servo_msgs_py.timed_points import decode_points
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import topics
from servo_twin.lockstep.axis_alignment import POINTS
from servo_twin.runs.curves import LOG_TIME, ROS_TIME, TICK, TIME
from servo_twin.view.scene import RESIDUALS

_Columns = dict[str, NDArray[Any]]

_TIME_UNITS: Final[Mapping[str, str]] = {LOG_TIME: "ns", ROS_TIME: "ns", TIME: "s"}
_NS: Final = 1_000_000_000


class Rows(NamedTuple):
    """Rows of one table."""

    stream: str  # topic, and the variable of a command
    columns: _Columns  # by name, each (rows,); SI, times since the epoch as integers
    units: Mapping[str, str]  # of the columns that have one


def rows_of(record: Record, catalogue: Catalogue) -> Rows | None:
    """Rows of a message, with the time of the recording, that of the sample, and tick and board time, if it has them.

    Returns
    -------
    Rows or None
        None if the type has no numbers for a table: texts, states, configuration blocks.

    Raises
    ------
    ValueError
        If it is damaged, or of another version.
    """
    name = record.topic.rpartition("/")[2]
    stream = record.topic
    units: Mapping[str, str] = {}
    if name == topics.COMMANDS_APPLIED:
        variable, found, units = _command(decoded(record.data, record.type), catalogue)
        stream = f"{stream}/{variable}"
    elif record.type == "std_msgs/msg/Float64MultiArray":
        found = _table(name, decoded(record.data, record.type))
    elif record.type == "sensor_msgs/msg/JointState":
        found, units = _joints(decoded(record.data, record.type))
    elif record.type == "std_msgs/msg/Float64":
        found = {"data": np.array([decoded(record.data, record.type).data])}
        units = {"data": _unit_of_topic(record.topic, catalogue)}
    else:
        return None
    if TICK in found and TIME not in found:
        found = {TIME: found[TICK] * (PERIOD_NS * 1e-9), **found}
    found = {LOG_TIME: np.full(len(next(iter(found.values()), ())), record.time_ns), **found}
    variables = catalogue.variables
    known = {column: variables[base].unit for column in found if (base := column.partition("[")[0]) in variables}
    return Rows(stream, found, {**known, **_TIME_UNITS, **units})


def _table(name: str, message: Any) -> _Columns:
    """Columns of an array: those of a table of telemetry, else one per element."""
    if len(message.layout.dim) == 2:
        names, table = snapshot_table(message)
        found = dict(zip(names, table.T, strict=True))
        if all(column in found for column in topics.STAMP_COLUMNS):
            seconds, nanoseconds = (found.pop(column).astype(np.int64) for column in topics.STAMP_COLUMNS)
            found = {ROS_TIME: seconds * _NS + nanoseconds, **found}
        return found
    if name == topics.WINDING_TEMPERATURES:
        return {f"{axis_name(k)}.winding_temperature": np.array([value]) for k, value in enumerate(message.data)}
    return {f"data[{k}]": np.array([value]) for k, value in enumerate(message.data)}


def _joints(message: Any) -> tuple[_Columns, Mapping[str, str]]:
    """Columns of joint states, and their units."""
    stamp = message.header.stamp
    found: _Columns = {ROS_TIME: np.array([stamp.sec * _NS + stamp.nanosec])}
    units: dict[str, str] = {}
    for field, unit in RESIDUALS.items():
        for joint, value in zip(message.name, getattr(message, field), strict=False):  # an array may be empty
            found[f"{joint}.{field}"] = np.array([value])
            units[f"{joint}.{field}"] = unit
    return found, units


def _command(message: Any, catalogue: Catalogue) -> tuple[str, _Columns, Mapping[str, str]]:
    """Variable, columns and units of an applied command; NaN for an axis that was not written."""
    command = applied_from_message(message)
    if command.variable == POINTS:
        return _points(command, catalogue)
    variable = catalogue.variables.get(command.variable)
    found: _Columns = {TICK: np.array([float(command.tick)]), "mask": np.array([float(command.mask)])}
    if variable is not None and variable.count == len(command.raw):
        for k, (column, raw) in enumerate(zip(columns([variable]), command.raw, strict=True)):
            found[column] = np.array([variable.scale(raw) if command.mask >> k & 1 else np.nan], np.float64)
    return command.variable, found, {}


def _points(command: AppliedCommand, catalogue: Catalogue) -> tuple[str, _Columns, Mapping[str, str]]:
    """Variable, columns and units of timed points, one per row."""
    points = decode_points(catalogue, command.raw)
    columns: Mapping[str, tuple[Sequence[float], str]] = {
        TICK: ([command.tick] * len(points), ""),
        "axis": ([point.axis + 1 for point in points], ""),
        "point.tick": ([point.tick for point in points], catalogue[TICK].unit),
        "point.position": ([point.position for point in points], "rad"),
        "point.velocity": ([point.velocity for point in points], "rad/s"),
        "point.current": ([point.current for point in points], "A"),
        "point.replaces": ([point.replaces for point in points], ""),
    }
    found = {name: np.array(values, np.float64) for name, (values, _) in columns.items()}
    return command.variable, found, {name: unit for name, (_, unit) in columns.items() if unit}


def _unit_of_topic(topic: str, catalogue: Catalogue) -> str:
    """Unit of a topic with one variable; the joints have the variables of the axes under their own names."""
    for place in ("/var/", "/residual/"):
        _, found, path = topic.partition(place)
        if found:
            parts = path.split("/")
            for name in (".".join(parts), ".".join([axis_name(0), *parts[1:]])):
                if name in catalogue.variables:
                    return catalogue.variables[name].unit
    return ""


def joined(parts: Sequence[Rows]) -> Rows:
    """Rows of one table one after the other; all have the same columns."""
    names = parts[0].columns
    return parts[0]._replace(columns={name: np.concatenate([part.columns[name] for part in parts]) for name in names})
