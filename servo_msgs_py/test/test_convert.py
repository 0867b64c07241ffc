"""Conversions to ROS messages and back, with real serialisation where bytes matter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.joints import DEFAULT_JOINTS, joint_names
from servo_msgs_py.timed_points import POINT_WORDS
from servo_msgs_py.topics import COMMAND_VARIABLES
from servo_msgs_py.trace import Trace
from std_msgs.msg import Float64MultiArray, Int64MultiArray, MultiArrayDimension

from servo_msgs_py import convert

CATALOGUE = Catalogue.load()
JOINTS = joint_names(DEFAULT_JOINTS)
VALUES = {
    "axis1.position": 1.5, "axis1.speed": -2.0, "axis1.i_q": 0.5,
    "axis2.position": -3, "axis2.speed": 4.0, "axis2.i_q": -1.0,
}  # fmt: skip


@given(st.integers(0, 2**62))
def test_a_stamp_converts_back_to_the_same_nanoseconds(nanoseconds: int) -> None:
    if nanoseconds // 10**9 < 2**31:
        assert convert.from_stamp(convert.to_stamp(nanoseconds)) == nanoseconds


def test_joint_state_has_stamp_and_si_values_of_a_sample() -> None:
    message = convert.joint_state_from_values(DEFAULT_JOINTS, 3_000_000_007, VALUES, [0.04, 0.05])
    message = deserialize_message(serialize_message(message), JointState)
    assert list(message.name) == JOINTS
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
    assert list(message.position) == [1.5, -3.0]
    assert list(message.velocity) == [-2.0, 4.0]
    assert list(message.effort) == pytest.approx([0.02, -0.05])


def test_effort_stays_empty_without_torque_constants() -> None:
    assert list(convert.joint_state_from_values(DEFAULT_JOINTS, 0, VALUES).effort) == []


@pytest.mark.parametrize(
    ("position", "velocity", "message"),
    [([1.0], [], "1 values for 2 joints"), ([1.0, 2.0], [1.0], "velocity"), ([1.0, math.nan], [], "not finite")],
)
def test_invalid_joint_states_are_refused(position: list[float], velocity: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        convert.joint_state(JOINTS, 0, position, velocity)


def test_a_list_is_refused_as_a_single_number() -> None:
    with pytest.raises(ValueError, match="not a single number"):
        convert.joint_state_from_values(DEFAULT_JOINTS[:1], 0, VALUES | {"axis1.position": [1.0, 2.0]})


# ---- telemetry tables
def test_columns_and_row_agree_and_arrays_are_expanded() -> None:
    variables = [CATALOGUE[name] for name in ("tick", "cmd.position", "u_dc")]
    assert convert.columns(variables) == ["tick", "cmd.position[0]", "cmd.position[1]", "u_dc"]
    assert convert.row(variables, {"u_dc": 24.0, "tick": 7, "cmd.position": [1.0, 2.0]}) == [7, 1.0, 2.0, 24.0]


@given(
    st.integers(1, 5).flatmap(
        lambda width: st.lists(
            st.lists(st.floats(allow_nan=False), min_size=width, max_size=width), min_size=1, max_size=6
        )
    )
)
def test_tables_are_restored_after_serialisation(rows: list[list[float]]) -> None:
    names = [f"c{k}" for k in range(len(rows[0]))]
    message = convert.snapshot_message(names, rows)
    message = deserialize_message(serialize_message(message), Float64MultiArray)
    assert [d.size for d in message.layout.dim] == [len(rows), len(names)]
    assert message.layout.dim[0].stride == message.layout.dim[0].size * message.layout.dim[1].stride
    found, table = convert.snapshot_table(message)
    assert found == names
    np.testing.assert_array_equal(table, np.array(rows))


def test_a_trace_and_its_label_are_transferred_in_a_message() -> None:
    sent = Trace(500e-6, {"tick": np.array([8, 16]), "u_dc": np.array([24.0, np.nan])}, units={"u_dc": "V"})
    message = convert.trace_message(sent, "a burst")
    found = convert.trace_from_message(message)
    assert message.layout.dim[0].label == "a burst"
    assert list(found.columns) == ["tick", "u_dc"]
    np.testing.assert_array_equal(found.table(), sent.table())


def test_a_short_row_is_refused() -> None:
    with pytest.raises(ValueError, match="1 values for 2 columns"):
        convert.snapshot_message(["a", "b"], [[1.0]])


@pytest.mark.parametrize("damage", ["no layout", "label", "data"])
def test_damaged_tables_are_refused(damage: str) -> None:
    message = convert.snapshot_message(["a", "b"], [[1.0, 2.0]])
    if damage == "no layout":
        message.layout.dim = []
    elif damage == "label":
        message.layout.dim[1].label = "a"
    else:
        message.data = [1.0]
    with pytest.raises(ValueError, match="table"):
        convert.snapshot_table(message)


# ---- applied commands
@given(
    st.sampled_from([*COMMAND_VARIABLES, "param.features", "param.host_timeout"]),
    st.integers(0, 2**63 - 1),
    st.lists(st.integers(-(2**31), 2**32 - 1), min_size=32, max_size=32).map(lambda numbers: numbers * 16),
    st.integers(1, 8),
    st.integers(1, 3),
)
def test_applied_commands_are_exact(variable: str, tick: int, raw: list[int], points: int, mask: int) -> None:
    members = bin(mask).count("1") * len(AxisConfigTable.load())
    count = {"cmd.points": POINT_WORDS * points, "config.take": members}.get(variable, 2)
    applied = AppliedCommand(variable, tick, tuple(raw[:count]), mask)
    message = deserialize_message(serialize_message(convert.applied_message(applied)), Int64MultiArray)
    assert convert.applied_from_message(message) == applied


@pytest.mark.parametrize(
    ("name", "data"), [("cmd.position", []), ("cmd.position", [1, 1, 0]), ("cmd.position", [1, 4, 0, 0]),
                       ("cmd.position", [1, 1, 0, 0, 0]), ("cmd.other", [1, 1, 0, 0]), ("", [1, 1, 0, 0]),
                       ("cmd.points", [1, 1, 0, 0]), ("config.take", [1, 1, 0, 0])]
)  # fmt: skip
def test_damaged_applied_commands_are_refused(name: str, data: list[int]) -> None:
    message = Int64MultiArray(data=data)
    message.layout.dim = [MultiArrayDimension(label=name)]
    with pytest.raises(ValueError, match="commands_applied"):
        convert.applied_from_message(message)


# ---- words
def test_a_state_label_has_the_sub_state_in_run_only() -> None:
    assert convert.state_label(CATALOGUE, 3, 2) == "RUN/ALIGN"
    assert convert.state_label(CATALOGUE, 2, 3) == "STOP"
    assert convert.state_label(CATALOGUE, 7, 0) == "7"


def test_faults_come_with_cause_and_remedy() -> None:
    texts = convert.flag_texts(CATALOGUE, "faults", 0b10)
    assert len(texts) == 1
    assert texts[0].startswith("UNDER_VOLTAGE: ")
    assert "check the supply and board.under_voltage" in texts[0]
    assert convert.flag_texts(CATALOGUE, "faults", 0) == []


def test_diagnostics_are_restored_after_serialisation() -> None:
    status = convert.diagnostic_status("servo_bridge: link", DiagnosticStatus.ERROR, "gone", "/dev/x", {"rate": 1.5})
    array = convert.diagnostic_array(5, [status])
    found = deserialize_message(serialize_message(array), type(array)).status[0]
    assert (found.level, found.message, found.values[0].key, found.values[0].value) == (b"\x02", "gone", "rate", "1.5")
