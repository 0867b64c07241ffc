"""Trajectories from messages: accepted forms, start, and a message for each refusal."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.from_message import from_message
from servo_bridge.trajectory.message import converted, read
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.waypoints import WAYPOINTS_MAX, Waypoints
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = ("axis1", "axis2")
ORIGIN = 1_700_000_000_000_000_000
NOW = 10.0
HOLD = Path.hold(JOINTS, [1.0, 2.0])
MOVING = path_through(Waypoints.of(JOINTS, [5.0, 15.0, 25.0], [[0, 0], [5, -5], [0, 0]]))


def duration(seconds: float) -> SimpleNamespace:
    sec = int(seconds // 1)
    return SimpleNamespace(sec=sec, nanosec=round((seconds - sec) * 1e9))


def point(time: float, *positions: float, **fields: list[float]) -> SimpleNamespace:
    empty: dict[str, Any] = {"velocities": [], "accelerations": [], "effort": []}
    return SimpleNamespace(**(empty | fields), positions=list(positions), time_from_start=duration(time))


def message(*points: SimpleNamespace, names: tuple[str, ...] = JOINTS, at: float | None = None) -> SimpleNamespace:
    stamp = SimpleNamespace(sec=0, nanosec=0) if at is None else SimpleNamespace(sec=ORIGIN // 10**9, nanosec=0)
    if at is not None:
        stamp.sec += duration(at).sec
        stamp.nanosec = duration(at).nanosec
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=""), joint_names=list(names), points=list(points)
    )


def taken(trajectory: Any, running: Path = HOLD, **options: Any) -> Path:
    return from_message(converted(trajectory), running, NOW, ORIGIN, **options)


def same(actual: State, expected: State) -> None:
    np.testing.assert_allclose(actual.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(actual.velocity, expected.velocity, atol=1e-9)
    np.testing.assert_allclose(actual.acceleration, expected.acceleration, atol=1e-7)


@pytest.mark.parametrize("running", [HOLD, MOVING])
def test_zero_stamp_means_now(running: Path) -> None:
    path = taken(message(point(1.0, 2.0, 3.0), point(3.0, 0.0, 0.0)), running)
    assert list(path.times) == [10.0, 11.0, 13.0]
    same(path.state(NOW), running.state(NOW))
    np.testing.assert_array_equal(path.state([11.0, 13.0]).position, [[2.0, 3.0], [0.0, 0.0]])


@pytest.mark.parametrize("running", [HOLD, MOVING])
def test_path_begins_at_its_future_stamp(running: Path) -> None:
    path = taken(message(point(1.0, 2.0, 3.0), at=12.5), running)
    assert list(path.times) == pytest.approx([12.5, 13.5])
    same(path.state(path.start_time), running.state(12.5))


def test_trajectory_with_a_past_start_is_joined() -> None:
    points = [point(t, t, -t, velocities=[1.0, -1.0]) for t in (0.0, 1.0, 2.0, 3.0)]
    path = taken(message(*points, at=8.5), MOVING, may_end_moving=True)
    same(path.state(NOW), MOVING.state(NOW))
    assert list(path.times) == pytest.approx([10.0, 10.5, 11.5])
    np.testing.assert_allclose(path.state([10.5, 11.0]).position, [[2.0, -2.0], [2.5, -2.5]], atol=1e-6)


def test_a_past_trajectory_with_future_points_begins_at_the_present_positions() -> None:
    path = taken(message(point(3.0, 2.0, 3.0), at=8.0), MOVING)
    same(path.state(NOW), MOVING.state(NOW))
    assert path.end_time == pytest.approx(11.0)


def test_joints_may_have_any_order_and_be_incomplete() -> None:
    path = taken(message(point(1.0, 3.0, 2.0), names=("axis2", "axis1")))
    assert path.joints == JOINTS
    np.testing.assert_array_equal(path.end, [2.0, 3.0])
    path = taken(message(point(1.0, 3.0), names=("axis2",)))
    assert path.joints == ("axis2",)
    assert path.state(NOW).position[0] == 2.0


def test_fields_of_points_are_used_in_the_path() -> None:
    both: dict[str, Any] = {"velocities": [1.0, 2.0], "accelerations": [3.0, 4.0], "effort": [0.1, 0.2]}
    path = taken(message(point(1.0, 2.0, 3.0, **both), point(2.0, 2.0, 3.0), point(3.0, 2.0, 3.0)))
    state = path.state(11.0)
    np.testing.assert_allclose(state.velocity, [1.0, 2.0])
    np.testing.assert_allclose(path.continued(np.nextafter(11.0, 0.0)).acceleration, [3.0, 4.0], atol=1e-9)
    np.testing.assert_allclose(state.effort, [0.1, 0.2])
    assert not path.state(12.0).effort.any()


def test_a_first_point_at_the_start_is_replaced_by_the_present_state() -> None:
    path = taken(message(point(0.0, 1.005, 2.0), point(1.0, 2.0, 3.0)))
    same(path.state(NOW), HOLD.state(NOW))
    assert len(path.times) == 2


STEP = point(1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("trajectory", "code", "sentence"),
    [
        (message(STEP, names=("axis1", "elbow")), -2, "joint 'elbow' does not exist; the joints are axis1, axis2"),
        (message(STEP, names=("axis1", "axis1")), -2, "joint axis1 occurs twice"),
        (message(STEP, names=()), -2, "there are no joint names"),
        (message(point(1.0, 0.0)), -1, r"joint_names size \(2\) and positions \(1\) at point #0"),
        (message(point(1.0)), -1, "point #0 has no positions"),
        (message(STEP, point(2.0, 0.0, 0.0, velocities=[0.0])), -1, r"velocities \(1\) at point #1"),
        (message(STEP, STEP), -1, "time between points 0 and 1 is not strictly increasing"),
        (message(point(-1.0, 0.0, 0.0), STEP), -1, "time_from_start of point #0 is negative"),
        (message(point(1.0, 0.0, float("nan"))), -1, "positions of axis2 at point #0 is nan"),
        (message(point(1.0, 0, 0, velocities=[0.0, 0.5])), -1, "velocity of axis2 at the last point, #0, is 0.5 rad/s"),
        (message(point(1.0, 0, 0, accelerations=[0.0, 0.5])), -1, "point #0 has accelerations but no velocities"),
        (message(STEP, at=8.0), -3, r"the trajectory ended 1 s ago; send it earlier, or with stamp 0"),
        (message(point(0.0, 0.0, 2.0), STEP), -1, "axis1 is at 1 rad, but point #0 at the start time is at 0 rad"),
    ],
)
def test_a_bad_trajectory_is_refused_with_its_reason(trajectory: Any, code: int, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=f"^joint_trajectory: .*{sentence}") as caught:
        taken(trajectory)
    assert caught.value.code == ErrorCode(code)


@pytest.mark.parametrize("begin", [None, 5.0])
def test_a_trajectory_of_a_joint_that_wraps_is_moved_by_turns_to_the_joint(begin: float | None) -> None:
    """With the same motion: from 20 rad, 0.1 rad is 18.95 rad; with a begin in the past the joint is met on its way."""
    running = Path.hold(JOINTS, [20.0, 20.0])
    trajectory = message(point(4.0, 0.1, 0.1), point(6.0, 0.3, 0.3), point(7.0, 5.0, 5.0), at=begin)
    path = taken(trajectory, running, wrapping=("axis1",))
    same(path.state(NOW), running.state(NOW))
    np.testing.assert_allclose(path.end, [5.0 + 3.0 * 2.0 * np.pi, 5.0])


def test_messages_of_ros_become_a_path() -> None:
    messages = pytest.importorskip("trajectory_msgs.msg")
    interfaces = pytest.importorskip("builtin_interfaces.msg")
    trajectory = messages.JointTrajectory(joint_names=["axis2"])
    trajectory.points = [
        messages.JointTrajectoryPoint(positions=[3.0], time_from_start=interfaces.Duration(sec=1, nanosec=500_000_000))
    ]
    path = taken(trajectory)
    assert (path.joints, path.end_time, path.end[0]) == (("axis2",), 11.5, 3.0)


ROWS = st.lists(st.floats(allow_nan=True), max_size=3)
MESSAGES = st.builds(
    lambda frame_id, names, points: JointTrajectory(
        header=Header(stamp=Time(sec=-3, nanosec=5), frame_id=frame_id),
        joint_names=names,
        points=[
            JointTrajectoryPoint(
                positions=p, velocities=v, accelerations=a, effort=e, time_from_start=Duration(sec=sec, nanosec=7)
            )
            for p, v, a, e, sec in points
        ],
    ),
    st.text("a/\u00e9\u4e00", max_size=9),
    st.lists(st.sampled_from(["a", "axis1", "longer"]), max_size=2),
    st.lists(st.tuples(ROWS, ROWS, ROWS, ROWS, st.integers(-9, 9)), max_size=4),
)


@given(MESSAGES)
def test_serialised_message_has_the_values_of_the_converted_one(message: JointTrajectory) -> None:
    ours, theirs = read(serialize_message(message)), converted(message)
    assert (ours.frame_id, ours.stamp_ns, ours.joint_names, ours.size) == (
        theirs.frame_id,
        theirs.stamp_ns,
        theirs.joint_names,
        theirs.size,
    )
    assert ours.points().times_ns == theirs.points().times_ns
    for mine, other in zip(ours.points().rows, theirs.points().rows, strict=True):
        np.testing.assert_array_equal(mine.sizes, other.sizes)
        np.testing.assert_array_equal(mine.values, other.values)


@given(MESSAGES, st.data())
def test_cut_or_changed_message_is_refused_or_read(message: JointTrajectory, data: st.DataObject) -> None:
    content = bytearray(serialize_message(message))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    content = content[: data.draw(st.integers(0, len(content)))]
    with contextlib.suppress(TrajectoryError):
        trajectory = read(bytes(content))
        if trajectory.size <= WAYPOINTS_MAX:
            trajectory.points()
