"""Trajectories over real topics: points at the link, and messages of refusals."""

from __future__ import annotations

from collections.abc import Iterator
from unittest import mock

import pytest
from bridge_rig import FAULT, SPIN, Rig
from builtin_interfaces.msg import Duration
from rclpy import duration
from sensor_msgs.msg import JointState
from servo_bridge.trajectory.goal import Goal
from servo_bridge.trajectory.message import converted
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.qos import command_qos
from servo_msgs_py.timed_points import TimedPoint, decode_points
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CATALOGUE = Catalogue.load()
TRAJECTORY = CATALOGUE.enums["control_mode_t"]["TRAJECTORY"]


def trajectory(*rows: tuple[float, list[float]], joints: tuple[str, ...] = ("axis1", "axis2")) -> JointTrajectory:
    """Positions at times [s]."""
    points = [
        JointTrajectoryPoint(positions=positions, time_from_start=Duration(nanosec=round(time * 1e9)))
        for time, positions in rows
    ]
    return JointTrajectory(joint_names=list(joints), points=points)


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        for name, value in (("speed", 300.0), ("acceleration", 4000.0), ("i_q", 2.0)):
            variable = CATALOGUE[f"param.{name}_limit"]
            rig.link.parameters[variable.name] = [variable.to_raw(value)] * 2
        rig.enable_axes()
        rig.until(lambda: rig.messages[topics.PARAMETERS])
        yield rig


def publish(rig: Rig, message: JointTrajectory) -> None:
    publisher = rig.user.create_publisher(JointTrajectory, topics.JOINT_TRAJECTORY, command_qos())
    rig.until(publisher.get_subscription_count)
    publisher.publish(message)


def sampled(rig: Rig) -> list[TimedPoint]:
    """Deliver a sample; return the points that the link received."""
    rig.link.sample()
    rig.executor.spin_once(timeout_sec=0.005)
    return [
        point for name, _, raw in rig.link.written if name == "cmd.points" for point in decode_points(CATALOGUE, raw)
    ]


def test_points_of_both_axes_follow_the_mode(rig: Rig) -> None:
    publish(rig, trajectory((0.5, [1.0, -1.0]), (0.8, [0.5, 0.0])))
    rig.until(lambda: len(sampled(rig)) >= 6)
    names = [name for name, *_ in rig.link.written]
    assert names[0] == "cmd.mode"
    assert rig.link.written[0] == ("cmd.mode", 0, (TRAJECTORY, TRAJECTORY))
    assert set(names[1:]) == {"cmd.points"}
    points = sampled(rig)
    assert {point.axis for point in points} == {0, 1}
    assert points[0].replaces
    assert next(p for p in points if p.axis == 0).position == 0.0


def test_invalid_trajectory_is_refused_at_once(rig: Rig) -> None:
    """All kinds of errors: test_trajectory_message.py."""
    publish(rig, trajectory((0.5, [1.0]), joints=("elbow",)))
    rig.until(rig.rejections)
    assert "elbow" in rig.rejections()[-1]
    assert rig.link.written == []


def test_a_limit_exceeded_between_two_points_is_reported(rig: Rig) -> None:
    publish(rig, trajectory((0.01, [3.0, 0.0])))

    def reported() -> bool:
        sampled(rig)
        return bool(rig.rejections())

    rig.until(reported)
    assert "axis1" in rig.rejections()[-1]
    assert "limit" in rig.rejections()[-1]
    assert sampled(rig) == []


def test_axis_that_is_not_ready_is_reported(rig: Rig) -> None:
    rig.link.set_states(SPIN, FAULT)
    rig.link.sample()
    rig.until(lambda: "FAULT" in rig.state())
    publish(rig, trajectory((0.5, [1.0, -1.0])))
    rig.until(rig.rejections)
    assert "axis2 is in FAULT" in rig.rejections()[-1]


def test_a_set_point_replaces_the_path(rig: Rig) -> None:
    publish(rig, trajectory((5.0, [1.0, -1.0])))
    rig.until(lambda: len(sampled(rig)) >= 2)
    rig.joint_commands.publish(JointState(name=["axis1", "axis2"], position=[0.0, 0.0]))

    def taken() -> bool:
        sampled(rig)
        return any(name == "cmd.position" for name, *_ in rig.link.written)

    rig.until(taken)
    known = len(sampled(rig))
    for _ in range(20):
        sampled(rig)
    assert len(sampled(rig)) == known


def test_cancelling_a_goal_does_not_refuse_a_pending_one(rig: Rig) -> None:
    supervisor = rig.bridge.supervisor
    assert supervisor is not None
    owners = mock.MagicMock(), mock.MagicMock()
    first, second = (Goal(["axis1", "axis2"], {}, {}, 0.0) for _ in owners)
    for owner in owners:
        owner.cancelling.return_value = False
    supervisor.parts.goals.begin("test", converted(trajectory((5.0, [1.0, -1.0]))), first, owners[0])
    rig.until(lambda: len(sampled(rig)) >= 2)
    later = trajectory((0.5, [0.5, 0.5]))
    later.header.stamp = (rig.user.get_clock().now() + duration.Duration(seconds=30.0)).to_msg()
    supervisor.parts.goals.begin("test", converted(later), second, owners[1])
    owners[0].cancelling.return_value = True

    def ended() -> bool:
        sampled(rig)
        return first.ended

    rig.until(ended)
    assert first.canceled
    assert not second.ended
    assert supervisor.parts.follower.claimed == {0, 1}


def test_a_stop_takes_as_long_as_the_shaft_needs_if_no_path_moves_it(rig: Rig) -> None:
    """As with a velocity set-point; joints of a path have its velocity."""
    rig.link.values["axis1.speed"] = CATALOGUE["axis1.speed"].to_raw(-200.0)
    rig.link.sample()
    supervisor = rig.bridge.supervisor
    assert supervisor is not None
    rig.until(lambda: rig.messages[topics.JOINT_STATES] and rig.messages[topics.JOINT_STATES][-1].velocity[0] < -199.0)
    end = supervisor.parts.goals.stop("test", ["axis1"])
    assert end - supervisor.parts.follower.now == pytest.approx(0.1 + 200.0 / 4000.0, abs=1e-3)
