"""Joints with gears, and the robot description with them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint, JointLimits
from servo_msgs_py.robot_description import Motor, describe, joints_of, motors_of

CATALOGUE = Catalogue.load()
SMALL = st.floats(-1e4, 1e4)
RATIOS = st.floats(0.01, 1000.0)
DIRECTIONS = st.sampled_from([1, -1])
LIMITS = st.builds(
    lambda low, width, speed, effort: JointLimits(low, low + width, speed, effort),
    SMALL,
    st.floats(0.0, 1e4),
    st.floats(0.0, 0.4),  # below the speed of the motor with any gear, so that the limit of the board does not apply
    st.floats(0.0, 1e3) | st.just(math.inf),
)
UNBOUNDED = JointLimits(velocity_max=0.4, effort_max=1.0)
WHEELS = st.builds(Joint, st.just("elbow"), RATIOS, DIRECTIONS, SMALL, st.just(UNBOUNDED), st.just(True))
JOINTS = WHEELS | st.builds(Joint, st.just("elbow"), RATIOS, DIRECTIONS, SMALL, LIMITS | st.just(UNBOUNDED))
LIFT = Joint("lift", 50.0, -1, 0.3, JointLimits(-1.0, 2.0, 5.0, 20.0))


def described(*joints: Joint) -> str:
    return describe(joints, CATALOGUE, commands_topic="/servo/joint_commands", states_topic="/servo/joint_states")


def test_a_geared_reversed_joint_has_less_speed_more_torque_and_the_opposite_sign() -> None:
    assert LIFT.position(100.0) == pytest.approx(0.3 - 2.0)
    assert LIFT.velocity(100.0) == pytest.approx(-2.0)
    assert LIFT.effort(0.1) == pytest.approx(-5.0)
    assert LIFT.motor_position(0.3) == 0.0
    assert LIFT.motor_velocity(1.0) == pytest.approx(-50.0)


@given(JOINTS, SMALL)
def test_every_conversion_has_an_inverse(joint: Joint, value: float) -> None:
    resolution = 1e-12 * joint.gear_ratio * (1.0 + abs(joint.offset))
    assert joint.motor_position(joint.position(value)) == pytest.approx(value, rel=1e-12, abs=resolution)
    assert joint.motor_velocity(joint.velocity(value)) == pytest.approx(value, rel=1e-12)
    assert joint.motor_effort(joint.effort(value)) == pytest.approx(value, rel=1e-12)


@given(JOINTS, st.floats(-400.0, 400.0), st.floats(-1.0, 1.0))
def test_a_gear_keeps_the_power(joint: Joint, speed: float, torque: float) -> None:
    assert joint.velocity(speed) * joint.effort(torque) == pytest.approx(speed * torque, rel=1e-12)


@given(st.floats(-1e9, 1e9))
def test_the_default_joint_is_the_shaft_bit_for_bit(value: float) -> None:
    for joint in DEFAULT_JOINTS:
        assert joint.position(value) == joint.velocity(value) == joint.effort(value) == value
        assert joint.motor_position(value) == joint.motor_velocity(value) == joint.motor_effort(value) == value


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0, 1, 0.0), "gear_ratio of lift"),
        ((1.0, 2, 0.0), "direction of lift"),
        ((1.0, 1, math.nan), "offset of"),
        ((1.0, 1, 0.0, JointLimits(position_max=1.0), True), "wraps of lift"),
    ],
)
def test_invalid_joints_are_refused(values: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Joint("lift", *values)


@given(SMALL, SMALL)
def test_a_joint_that_wraps_reports_angles_and_takes_the_shorter_way(position: float, reference: float) -> None:
    wheel, spindle = Joint("wheel", wraps=True), Joint("spindle")
    angle, target = wheel.reported(position), wheel.nearest(position, reference)
    assert -math.pi <= angle <= math.pi
    assert abs(target - reference) <= math.pi + 1e-9
    for place in (angle, target):
        assert math.remainder(place - position, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert spindle.reported(position) == spindle.nearest(position, reference) == position


@given(JOINTS)
def test_joints_are_restored_from_a_description(joint: Joint) -> None:
    assert joints_of(described(joint, LIFT)) == [joint, LIFT]


def test_known_motors_are_restored_from_a_description() -> None:
    motors = [Motor(0.0462, 8.0e-6), Motor(0.0414, 1.2e-5)]
    joints = [Joint("pan"), LIFT]
    description = describe(joints, CATALOGUE, commands_topic="/a", states_topic="/b", motors=motors)
    assert motors_of(description) == motors
    assert joints_of(description) == joints_of(described(*joints))
    assert motors_of(described(*joints)) == []


def test_a_description_is_a_tree_with_the_limits_that_its_readers_require() -> None:
    robot = ET.fromstring(described(Joint("pan"), LIFT))
    links = {link.get("name") for link in robot.iterfind("link")}
    children = set()
    for joint in robot.iterfind("joint"):
        parent, child, limit = (joint.find(tag) for tag in ("parent", "child", "limit"))
        assert parent is not None
        assert child is not None
        assert limit is not None
        assert {parent.get("link"), child.get("link")} <= links
        children.add(child.get("link"))
        required = {"effort", "velocity"} | ({"lower", "upper"} if joint.get("type") == "revolute" else set())
        assert set(limit.attrib) == required
        assert all(math.isfinite(float(value)) for value in limit.attrib.values())
    assert len(links - children) == 1, "one root"


def test_only_a_joint_that_wraps_is_continuous() -> None:
    """A controller that takes a joint for continuous begins a trajectory up to half a turn from the shaft."""
    turns = 2**31 / 4000
    for joint, kind, upper in (
        (Joint("spindle", 50.0, -1), "revolute", math.tau * turns / 50.0),
        (LIFT, "revolute", 2.0),
        (Joint("wheel", wraps=True), "continuous", None),
    ):
        part = ET.fromstring(described(joint, Joint("other"))).find("joint")
        assert part is not None
        limit = part.find("limit")
        assert limit is not None
        assert part.get("type") == kind
        ends = limit.get("lower"), limit.get("upper")
        assert ends == (None, None) if upper is None else float(ends[1] or "") == pytest.approx(upper, rel=1e-6)


def test_the_hardware_of_ros2_control_has_a_state_for_every_command() -> None:
    control = ET.fromstring(described(Joint("pan"), LIFT)).find("ros2_control")
    assert control is not None
    parameters = {param.get("name"): param.text for param in control.iterfind("hardware/param")}
    assert parameters == {"joint_commands_topic": "/servo/joint_commands", "joint_states_topic": "/servo/joint_states"}
    for joint in control.iterfind("joint"):
        commands, states = (
            {part.get("name") for part in joint.iterfind(f"{kind}_interface")} for kind in ("command", "state")
        )
        assert commands == {"position", "velocity"}
        assert states == {"position", "velocity", "effort"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "is not XML"),
        ("<robot name='arm'/>", "0 transmissions"),
        (
            described(LIFT, Joint("pan")).replace('<joint name="pan" type', '<joint name="tilt" type'),
            "which does not exist",
        ),
        (described(LIFT, Joint("pan")).replace("-50.0", "fifty"), "'fifty' as mechanical_reduction of lift"),
    ],
)
def test_another_description_is_refused_with_a_reason(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        joints_of(text)
