"""Conversion between variables of the firmware and ROS messages.

Needs the message classes, but no node and no rclpy. All values are SI except the raw integers of
`AppliedCommand`, which are exact for bit-exact replay in a twin.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Int64MultiArray, MultiArrayDimension

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.board_parameters import RawParameters, parameter_names, parameters, si
from servo_msgs_py.catalogue import AXES, Catalogue, Value, Variable, axis_name
from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.timed_points import POINT_WORDS
from servo_msgs_py.topics import COMMAND_VARIABLES, COMMANDS_APPLIED, PARAMETERS
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import to_raw

_NS: Final = 1_000_000_000
_APPLIED_HEAD: Final = 2  # numbers before the values of an applied command: tick, mask


# ---- time
def to_stamp(nanoseconds: int) -> Time:
    """ROS time stamp of a time since the epoch [ns]."""
    return Time(sec=nanoseconds // _NS, nanosec=nanoseconds % _NS)


def from_stamp(stamp: Time) -> int:
    """Time since the epoch [ns] of a ROS time stamp."""
    return int(stamp.sec) * _NS + int(stamp.nanosec)


# ---- joint states
def joint_state(
    joints: Sequence[str],
    stamp_ns: int,
    position: Sequence[float],
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> JointState:
    """Joint states; each array is empty or as long as `joints`.

    Parameters
    ----------
    joints : sequence of str
        Joint names.
    stamp_ns : int
        Time of the sample since the epoch [ns].
    position, velocity, effort : sequence of float
        [rad], [rad/s], [N m].

    Raises
    ------
    ValueError
        If a length is wrong or a number is not finite.
    """
    message = JointState(name=list(joints))
    message.header.stamp = to_stamp(stamp_ns)
    for field, values in (("position", position), ("velocity", velocity), ("effort", effort)):
        if len(values) not in (0, len(joints)):
            raise ValueError(f"{field}: {len(values)} values for {len(joints)} joints")
        if not all(map(math.isfinite, values)):
            raise ValueError(f"{field}: {list(values)} contains a number that is not finite")
        setattr(message, field, array("d", values))
    return message


def joint_state_from_values(
    joints: Sequence[Joint], stamp_ns: int, values: Mapping[str, Value], torque_constants: Sequence[float] | None = None
) -> JointState:
    """Joint states of one sample, in joint units: position [rad], velocity [rad/s], effort [N m].

    Parameters
    ----------
    joints : sequence of Joint
        In the order of the axes.
    stamp_ns : int
        Time of the sample since the epoch [ns].
    values : mapping
        Variable name to SI value; must contain ``axisN.position``, ``axisN.speed`` and ``axisN.i_q``.
    torque_constants : sequence of float, optional
        Of the motors, by axis [N m/A]; if omitted, `effort` is empty.
    """
    axes = [(joint, axis_name(axis)) for axis, joint in enumerate(joints)]
    effort: list[float] = []
    if torque_constants is not None:
        effort = [
            joint.effort(k * _number(values[f"{axis}.i_q"]))
            for k, (joint, axis) in zip(torque_constants, axes, strict=True)
        ]
    return joint_state(
        joint_names(joints),
        stamp_ns,
        [joint.reported(joint.position(_number(values[f"{axis}.position"]))) for joint, axis in axes],
        [joint.velocity(_number(values[f"{axis}.speed"])) for joint, axis in axes],
        effort,
    )


def _number(value: Value) -> float:
    if isinstance(value, (int, float)):
        return float(value)
    raise ValueError(f"{value!r} is not a single number")


# ---- tables of telemetry
def columns(variables: Iterable[Variable]) -> list[str]:
    """Column names of a telemetry table; an array has one column per element: ``cmd.position[0]``."""
    return [
        variable.name if variable.count == 1 else f"{variable.name}[{k}]"
        for variable in variables
        for k in range(variable.count)
    ]


def row(variables: Iterable[Variable], values: Mapping[str, Value]) -> list[float]:
    """One row of a telemetry table, SI, in the order of `columns`."""
    numbers: list[float] = []
    for variable in variables:
        value = values[variable.name]
        if isinstance(value, list):
            numbers.extend(value)
        else:
            numbers.append(_number(value))
    return numbers


def snapshot_message(names: Sequence[str], rows: Sequence[Sequence[float]]) -> Float64MultiArray:
    """Message with a table of telemetry, row-major, one row per sample.

    Parameters
    ----------
    names : sequence of str
        Column names, transferred in ``layout.dim[1].label``, separated by commas.
    rows : sequence of sequence of float
        SI values.
    """
    width = len(names)
    flat = array("d")
    for values in rows:
        if len(values) != width:
            raise ValueError(f"a row has {len(values)} values for {width} columns")
        flat.extend(values)
    message = Float64MultiArray(data=flat)
    message.layout.dim = [
        MultiArrayDimension(label="sample", size=len(rows), stride=len(flat)),
        MultiArrayDimension(label=",".join(names), size=width, stride=width),
    ]
    return message


def snapshot_table(message: Float64MultiArray) -> tuple[list[str], NDArray[np.float64]]:
    """Column names and the table (samples by columns) of a message made by `snapshot_message`.

    Raises
    ------
    ValueError
        If layout and data do not match.
    """
    dimensions = message.layout.dim
    names = dimensions[1].label.split(",") if len(dimensions) == 2 else []
    if len(dimensions) != 2 or len(names) != dimensions[1].size:
        raise ValueError(
            "not a telemetry table: two dimensions expected, the second with all column names as its label"
        )
    if len(set(names)) < len(names):
        raise ValueError("not a telemetry table: a column has the name of another")
    shape = dimensions[0].size, dimensions[1].size
    data = np.asarray(message.data, dtype=np.float64)
    if data.size != shape[0] * shape[1]:
        raise ValueError(f"a table of {shape[0]} by {shape[1]} with {data.size} numbers")
    return names, data.reshape(shape)


def trace_message(trace: Trace, label: str) -> Float64MultiArray:
    """Message with all columns of a trace as a table; `label` describes it, in ``layout.dim[0].label``."""
    message = snapshot_message(list(trace.columns), trace.table().tolist())
    message.layout.dim[0].label = label
    return message


def trace_from_message(message: Float64MultiArray) -> Trace:
    """Trace of a message made by `trace_message`; its times are in its columns.

    Raises
    ------
    ValueError
        If layout and data do not match.
    """
    names, table = snapshot_table(message)
    return Trace(0.0, dict(zip(names, table.T, strict=True)))


# ---- parameters
def parameters_message(values: RawParameters, catalogue: Catalogue) -> Float64MultiArray:
    """Message of `topics.PARAMETERS` from the raw integers of all parameters."""
    variables = [catalogue[name] for name in values]
    return snapshot_message(columns(variables), [row(variables, si(values, catalogue))])


def parameters_from_message(message: Float64MultiArray, catalogue: Catalogue) -> dict[str, list[int]]:
    """Raw integers of all parameters.

    Raises
    ------
    ValueError
        If it does not have exactly one row with all parameters of the catalogue.
    """
    variables = parameters(catalogue)
    names, table = snapshot_table(message)
    if names != columns(variables) or len(table) != 1:
        raise ValueError(f"{PARAMETERS}: the names belong to another version; use the same version everywhere")
    numbers = iter(table[0].tolist())
    result: dict[str, list[int]] = {}
    for variable in variables:
        low, high = variable.format.low, variable.format.high
        result[variable.name] = [to_raw(next(numbers), variable.lsb, low, high) for _ in range(variable.count)]
    return result


# ---- commands that took effect
@dataclass(frozen=True)
class AppliedCommand:
    """A write to a command variable or a parameter that was applied in the firmware."""

    variable: str  # one of `COMMAND_VARIABLES`, or a parameter
    tick: int  # PWM periods since reset at which it was applied, extended past 32 bits like the tick of the telemetry
    raw: tuple[int, ...]
    """Firmware integers by axis, 0 for an axis that was not written, and after that of a scalar; for ``cmd.points`` the
    written words, for ``config.take`` the members of the blocks of the axes in `mask`."""
    mask: int  # bit per written axis; bit 0 is axis 1


def applied_message(applied: AppliedCommand) -> Int64MultiArray:
    """Message of `COMMANDS_APPLIED`."""
    message = Int64MultiArray(data=array("q", [applied.tick, applied.mask, *applied.raw]))
    count = len(applied.raw)
    message.layout.data_offset = _APPLIED_HEAD
    message.layout.dim = [MultiArrayDimension(label=applied.variable, size=count, stride=count)]
    return message


def applied_from_message(message: Int64MultiArray) -> AppliedCommand:
    """Read a message of `COMMANDS_APPLIED`.

    Raises
    ------
    ValueError
        If the format is wrong.
    """
    name = ",".join(dim.label for dim in message.layout.dim)
    if name not in COMMAND_VARIABLES and name not in parameter_names():
        raise ValueError(f"{COMMANDS_APPLIED}: {name!r} is not a command; use the same version everywhere")
    tick, mask, *raw = message.data.tolist() if len(message.data) >= _APPLIED_HEAD else (0, 0)
    if not (0 < mask < 1 << AXES and _valid_length(name, len(raw), mask)):
        raise ValueError(f"{COMMANDS_APPLIED}: {name} has {len(raw)} values for the axes of mask {mask}")
    return AppliedCommand(name, tick, tuple(raw), mask)


def _valid_length(name: str, count: int, mask: int) -> bool:
    """Whether a variable can have `count` raw numbers."""
    if name == "cmd.points":
        return count % POINT_WORDS == 0
    return count == (bin(mask).count("1") * len(AxisConfigTable.load()) if name == "config.take" else AXES)


# ---- states and diagnostics in words
def state_label(catalogue: Catalogue, state: int, substate: int) -> str:
    """State of an axis as text: ``STOP``, ``FAULT`` or, with enabled outputs, ``RUN/SPIN``."""
    name = catalogue.label("state_t", state)
    return f"{name}/{catalogue.label('substate_t', substate)}" if name == "RUN" else name


def flag_texts(catalogue: Catalogue, flags: str, raw: int) -> list[str]:
    """Names, causes and remedies, if any, of the set flags of a flag word."""
    return [
        f"{flag.name}: {flag.cause}" + (f" ({flag.remedy})" if flag.remedy else "")
        for flag in catalogue.active(flags, raw)
    ]


FAULTS: Final = "faults"
"""Key of the faults in the diagnostic status of a joint."""

NO_FAULT: Final = "none"
"""Its value without a fault."""


def diagnostic_status(
    name: str, level: bytes, message: str, hardware_id: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    """Status of one subsystem (REP 107); `name` is ``node: subsystem``."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, hardware_id=hardware_id, values=pairs)


def diagnostic_array(stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Message of ``/diagnostics``."""
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = to_stamp(stamp_ns)
    return message
