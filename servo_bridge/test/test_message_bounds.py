"""Messages beyond the bounds of the bridge, on every topic that it subscribes: refused before any work on them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from bridge_rig import Rig
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from servo_bridge.node import MESSAGE_BYTES_MAX
from servo_bridge.trajectory.message import BYTES_MAX
from servo_bridge.trajectory.waypoints import WAYPOINTS_MAX
from servo_msgs_py.runtime.qos import command_qos
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CALLBACK_MAX = 0.02
"""Processor time of a callback that does not delay a keep-alive [s]."""

MANY = 100_000
POINTS = WAYPOINTS_MAX + 1
OVERSIZED = {
    topics.JOINT_COMMANDS: (JointState(name=["axis1"] * MANY, position=[1.0] * MANY), MESSAGE_BYTES_MAX),
    topics.COMMANDS: (Float64MultiArray(data=[1.0] * MANY), MESSAGE_BYTES_MAX),
    topics.LEASES: (String(data="x" * MANY), MESSAGE_BYTES_MAX),
    topics.JOINT_TRAJECTORY: (
        JointTrajectory(joint_names=["axis1"], points=[JointTrajectoryPoint(positions=[1.0])] * POINTS),
        WAYPOINTS_MAX,
    ),
}
OTHERS = {
    "bytes of a trajectory": (
        topics.JOINT_TRAJECTORY,
        JointTrajectory(points=[JointTrajectoryPoint(positions=[1.0] * (BYTES_MAX // 8))]),
        BYTES_MAX,
    ),
    "joints of a trajectory": (topics.JOINT_TRAJECTORY, JointTrajectory(joint_names=["axis1"] * MANY), 2),
}
CASES = {topic: (topic, *case) for topic, case in OVERSIZED.items()} | OTHERS
FIXED = [topics.joint_position_topic(joint) for joint in ("axis1", "axis2")]
"""Topics of messages of a constant size, whose larger ones the middleware drops."""


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        rig.enable_axes()
        yield rig


def test_every_topic_has_a_case(rig: Rig) -> None:
    subscribed = {each.topic_name.removeprefix("/servo/") for each in rig.bridge.subscriptions}
    assert subscribed == {*OVERSIZED, *FIXED}


@pytest.mark.parametrize("case", CASES)
def test_oversized_message_is_refused_in_no_time(rig: Rig, case: str) -> None:
    topic, message, bound = CASES[case]
    publisher = rig.user.create_publisher(type(message), topic, command_qos())
    rig.until(publisher.get_subscription_count)
    data = serialize_message(message)  # in this process it would count as work of the executor
    known = len(rig.rejections())
    rig.bridge.watch.report()
    publisher.publish(data)
    rig.until(lambda: rig.rejections()[known:])
    assert f"more than {bound}; send" in rig.rejections()[-1]
    longest = rig.bridge.watch.report().last
    assert longest.cpu < CALLBACK_MAX, str(longest)
    assert rig.link.written == []
    rig.user.destroy_publisher(publisher)


@pytest.mark.parametrize("topic", [topics.JOINT_COMMANDS, topics.JOINT_TRAJECTORY, topics.LEASES])
def test_message_that_is_cut_off_is_refused(rig: Rig, topic: str) -> None:
    message = CASES[topic][1]
    publisher = rig.user.create_publisher(type(message), topic, command_qos())
    rig.until(publisher.get_subscription_count)
    known = len(rig.rejections())
    publisher.publish(serialize_message(message)[:30])
    rig.until(lambda: rig.rejections()[known:])
    assert "send it again" in rig.rejections()[-1]
    assert rig.link.written == []
    rig.user.destroy_publisher(publisher)
