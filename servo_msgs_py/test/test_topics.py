"""Names and qualities of service that other programs rely on."""

from __future__ import annotations

import re

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.timed_points import POINT_WORDS, POINTS_PER_WRITE

from servo_msgs_py import topics

_TOPIC = re.compile(r"[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*")


def test_names_are_relative_except_diagnostics() -> None:
    names = {name: value for name, value in vars(topics).items() if name.isupper() and isinstance(value, str)}
    assert names.pop("DIAGNOSTICS") == "/diagnostics"
    assert all(_TOPIC.fullmatch(value) for value in names.values())
    assert len(set(names.values())) == len(names)


def test_every_variable_has_a_valid_topic_of_its_own() -> None:
    names = list(Catalogue.load().variables)
    built = {topics.variable_topic(name) for name in names} | {topics.residual_topic(name) for name in names}
    assert len(built) == 2 * len(names)
    assert all(_TOPIC.fullmatch(topic) for topic in built)
    assert topics.variable_topic("axis1.i_q") == "var/axis1/i_q"
    assert topics.joint_position_topic("axis2") == "axis2/position"


def test_command_variables_exist_can_be_written_and_hold_one_element_per_axis() -> None:
    catalogue = Catalogue.load()
    for name in topics.COMMAND_VARIABLES:
        variable = catalogue[name]
        count = {"cmd.points": POINT_WORDS * POINTS_PER_WRITE, "config.take": 1}.get(name, 2)
        assert (variable.writable, variable.count) == (True, count), name
    # The bridge has no commands for test signals, which are for measurements without the bridge.
    commands = {name for name in catalogue.variables if name.startswith("cmd.") and not name.startswith("cmd.test_")}
    assert commands | {"config.take"} == set(topics.COMMAND_VARIABLES)


def test_telemetry_is_deep_and_reliable() -> None:
    qos = telemetry_qos()
    assert qos.depth >= 50
    assert qos.reliability == ReliabilityPolicy.RELIABLE


def test_latched_topics_serve_late_subscribers() -> None:
    qos = latched_qos()
    assert (qos.depth, qos.durability) == (1, DurabilityPolicy.TRANSIENT_LOCAL)


def test_topics_of_single_variables_carry_the_names_of_the_joints() -> None:
    joints = ["hand", "axis1"]
    assert topics.variable_topic("axis1.i_q", joints) == "var/hand/i_q"
    assert topics.variable_topic("axis2.i_q", joints) == "var/axis1/i_q"
    assert topics.variable_topic("cmd.position.axis2", joints) == "var/cmd/position/axis1"
    assert topics.residual_topic("axis2.speed", joints) == "residual/axis1/speed"
    assert topics.variable_topic("u_dc", joints) == "var/u_dc"
