"""Which set-points of ``joint_commands`` may move a joint: messages of controllers and of people, in other orders."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.admission import GAP, JOIN_DISTANCE, Admission, Place
from servo_bridge.set_point_sources import Source
from servo_bridge.set_points import JointSetPoint

TOPIC = "joint_commands"
RATES = pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])


class Joint:
    """One joint, which is where the test says, and the admission of its messages; executed points are recorded."""

    def __init__(self, position: float = 0.0) -> None:
        self.admission = Admission(TOPIC)
        self.now = 0.0  # [s]
        self.position, self.velocity = position, 0.0  # [rad], [rad/s]
        self.holder: Source | None = None
        self.moved_by = ""
        self.streaming = False
        self.executed: list[JointSetPoint] = []
        self.refused: list[str] = []
        self.kinds: list[str] = []  # of the refusals
        self.stopped = 0

    def wait(self, seconds: float) -> None:
        """Let time pass without messages; isolated positions are executed."""
        for _ in range(max(round(seconds / 0.01), 1)):
            self.now += min(seconds, 0.01)
            for point in self.admission.advance(self.now).values():
                self._execute(point)

    def send(self, point: JointSetPoint, *, command: bool = False) -> None:
        place = Place("arm", self.position, self.velocity, self.holder, self.moved_by, self.streaming)
        admitted = self.admission.decide({0: point}, self.now, {0: place}, command=command)
        self.refused += map(str, admitted.refused)
        self.kinds += [error.kind for error in admitted.refused]
        self.stopped += len(admitted.stop)
        if admitted.stop:
            self.streaming, self.velocity = False, 0.0
        for chosen in admitted.points.values():
            self._execute(chosen)

    def _execute(self, point: JointSetPoint) -> None:
        self.executed.append(point)
        if point.streamed:
            self.holder, self.streaming = Source(TOPIC, "trajectory"), True
            assert point.position is not None
            self.position, self.velocity = point.position, point.velocity or 0.0
        else:
            self.holder = Source(TOPIC, "velocity" if point.position is None else "position")
            self.streaming = False
            self.velocity = point.velocity or 0.0
            if point.position is not None:
                self.position = point.position

    def train(self, points: Iterable[JointSetPoint], rate: float = 100.0) -> None:
        """Send messages at a rate [Hz]."""
        for point in points:
            self.wait(1.0 / rate)
            self.send(point)

    def release(self) -> None:
        """The joint stops and is released, as by a quick stop or a fault; then it is enabled again."""
        self.holder, self.streaming, self.velocity = None, False, 0.0

    def driven_by(self, topic: str, position: float) -> None:
        """Another topic moves the joint to a position."""
        self.holder, self.streaming, self.velocity = Source(topic, "position"), False, 0.0
        self.position, self.moved_by = position, ""


def held(position: float, count: int, velocity: float | None = 0.0) -> list[JointSetPoint]:
    return [JointSetPoint(position, velocity)] * count


def linear(start: float, velocity: float, seconds: float, rate: float) -> list[JointSetPoint]:
    """Path of constant velocity: the first message has it already."""
    return [JointSetPoint(start + velocity * k / rate, velocity) for k in range(round(seconds * rate))]


EVENTS: dict[str, Callable[[Joint], None]] = {
    "stopped and enabled": lambda joint: joint.release(),
    "moved by another topic": lambda joint: joint.driven_by("axis1/position", joint.position + 3.0),
    "paused": lambda joint: joint.wait(2.0),
}


# ---- controllers
@RATES
@pytest.mark.parametrize("velocity", [0.0, None])
def test_a_controller_that_repeats_an_old_position_moves_nothing(rate: float, velocity: float | None) -> None:
    """Hardware is deactivated, the joint moved elsewhere, hardware activated again."""
    joint = Joint()
    joint.train(held(0.0, 50, velocity), rate)
    joint.wait(1.0)
    joint.driven_by("axis1/position", 5.0)
    for pause in (0.0, 1.5, 60.0):
        joint.wait(pause)
        before = len(joint.executed)
        joint.train(held(0.0, 200, velocity), rate)
        joint.wait(1.0)
        assert joint.executed[before:] == []
    assert "5 rad from the set-point 0 rad" in joint.refused[-1]


@RATES
@pytest.mark.parametrize("velocity", [0.0, None])
def test_a_controller_that_sends_zero_first_moves_nothing(rate: float, velocity: float | None) -> None:
    joint = Joint(5.0)
    joint.train(held(0.0, 300, velocity), rate)
    joint.wait(1.0)
    assert joint.executed == []
    # A controller starts and commands the measured position.
    joint.train(held(5.001, 10, velocity), rate)
    assert joint.executed[0].position == 5.001


@RATES
def test_a_refused_path_is_not_continued_beside_a_stream_that_waits_for_messages(rate: float) -> None:
    """The hardware is started again, with its commands at 0, while the joint still holds for the earlier stream."""
    joint = Joint(3.0)
    joint.train(held(3.0, 50), rate)
    joint.wait(2.0 * GAP)
    before = len(joint.executed)
    joint.train(held(0.0, 50), rate)
    assert joint.executed[before:] == []


@RATES
def test_a_path_from_an_old_reference_moves_nothing_and_one_from_the_joint_is_followed(rate: float) -> None:
    joint = Joint()
    joint.train(held(7.0, 100), rate)
    joint.train(linear(7.0, 3.0, 1.0, rate), rate)
    joint.train(held(10.0, 100), rate)
    assert joint.executed == []
    path = linear(0.0, 3.0, 1.0, rate)
    joint.train(path, rate)
    assert joint.executed == path


@RATES
@pytest.mark.parametrize("event", ["stopped and enabled", "moved by another topic"])
def test_a_path_that_passes_the_joint_does_not_take_it_along(rate: float, event: str) -> None:
    joint = Joint()
    joint.train(linear(0.0, 3.0, 1.0, rate), rate)
    EVENTS[event](joint)
    before = len(joint.executed)
    joint.train(linear(joint.position - 4.0, 4.0, 2.0, rate), rate)
    assert joint.executed[before:] == []
    assert any("passes" in text for text in joint.refused)


@RATES
def test_a_held_stream_does_not_take_a_joint_from_a_motion_that_begins(rate: float) -> None:
    joint = Joint()
    joint.train(held(0.0, 50), rate)
    joint.holder, joint.moved_by, joint.streaming = Source("joint_trajectory", "trajectory"), "joint_trajectory", False
    before = len(joint.executed)
    joint.train(held(0.0, 50), rate)
    assert joint.executed[before:] == []
    assert "joint_trajectory moves the joint" in joint.refused[-1]


@RATES
def test_velocity_of_a_controller_under_a_stale_position_is_executed(rate: float) -> None:
    joint = Joint()
    joint.train([*linear(0.0, 1.0, 1.0, rate), *held(1.0, 50)], rate)
    before = len(joint.executed)
    joint.train(held(1.0, 50, 5.0), rate)
    mine = joint.executed[before:]
    assert mine[2:] == [JointSetPoint(velocity=5.0)] * 48
    joint.train(held(1.0, 5, 0.0), rate)
    assert joint.executed[-1] == JointSetPoint(velocity=0.0)
    joint.position = 9.0
    joint.train([*held(9.0, 20), *linear(9.0, 1.0, 0.5, rate)], rate)
    assert joint.executed[-1].streamed


@RATES
@pytest.mark.parametrize("alone", [False, True])
def test_a_trajectory_controller_ends_the_velocity_of_the_one_before_it(rate: float, alone: bool) -> None:
    """It holds where the joint was measured, which is behind the moving joint."""
    joint = Joint()
    joint.train([*held(0.0, 50), *held(0.0, 50, 5.0)] if not alone else [JointSetPoint(velocity=5.0)] * 50, rate)
    joint.position = 9.2
    joint.train(held(9.0, 50), rate)
    assert joint.stopped == 1
    assert joint.velocity == 0.0
    goal = linear(joint.position, 1.0, 0.5, rate)
    joint.train(goal, rate)
    assert joint.executed[-len(goal) :] == goal


@RATES
def test_positions_of_a_controller_beside_the_velocity_of_the_one_before_it_are_executed(rate: float) -> None:
    joint = Joint()
    joint.train([*held(0.0, 50), *held(0.0, 50, 5.0), *held(2.0, 50, 5.0), *held(2.01, 50, 5.0)], rate)
    assert {point.position for point in joint.executed[-100:]} == {2.0, 2.01}
    assert not any(point.velocity for point in joint.executed[-100:])
    joint.train(held(2.01, 50, 4.0), rate)
    assert joint.executed[-1] == JointSetPoint(velocity=4.0), "a velocity controller again"


@RATES
@pytest.mark.parametrize("goal", [True, False])
def test_velocity_of_a_controller_is_executed_after_silence(rate: float, goal: bool) -> None:
    """The hardware interface sends nothing while its commands agree with the states."""
    joint = Joint()
    if goal:
        joint.train(linear(0.0, 1.0, 1.0, rate), rate)
        joint.velocity = 0.0
        joint.wait(1.0)
    before, place = len(joint.executed), joint.position
    joint.train(held(place, 50, 5.0), rate)
    assert joint.executed[before + 3 :] == [JointSetPoint(velocity=5.0)] * 47
    joint.release()
    joint.position = place
    joint.wait(1.0)
    before = len(joint.executed)
    joint.train(held(place, 50, 5.0), rate)
    assert not any(point.velocity for point in joint.executed[before + 3 :]), "the repeated velocity is not fresh"


@RATES
def test_a_controller_that_started_without_states_does_not_bar_its_goal(rate: float) -> None:
    """A trajectory controller that is activated before the first state sends NaN and velocity 0."""
    joint = Joint()
    joint.train([JointSetPoint(velocity=0.0)] * 50, rate)
    path = linear(0.0, 2.0, 1.0, rate)
    joint.train(path, rate)
    assert joint.executed[50:] == path


def test_a_refusal_for_another_reason_is_of_another_kind() -> None:
    """Refusals of one kind that follow each other are logged once."""
    joint = Joint(5.0)
    joint.train([*held(0.0, 20), *held(1.0, 20, 3.0)])
    assert list(dict.fromkeys(joint.kinds)) == ["arm stream", "arm contradiction"]


@RATES
@pytest.mark.parametrize("event", ["stopped and enabled", "paused"])
def test_a_stale_velocity_is_not_executed_again(rate: float, event: str) -> None:
    joint = Joint()
    joint.train([*held(0.0, 50), *held(0.0, 50, 5.0)], rate)
    joint.position = 9.0
    EVENTS[event](joint)
    before = len(joint.executed)
    joint.train(held(0.0, 100, 5.0), rate)
    assert joint.executed[before:] == []
    assert joint.refused


@RATES
def test_a_contradiction_without_a_change_ends_the_stream_and_is_named(rate: float) -> None:
    joint = Joint()
    joint.train(held(0.01, 100, 5.0), rate)
    assert joint.stopped == 1
    assert len(joint.executed) == 3, "not yet in effect: shorter than the delay of a stream"
    assert "constant at 0.01 rad, but the velocity is 5 rad/s" in joint.refused[-1]
    assert joint.refused[-1].endswith("send a velocity of 0 first")
    for velocity in (0.0, -5.0):
        joint.train(held(0.01, 20, velocity), rate)
        assert joint.executed[-1].velocity == velocity


@RATES
def test_position_clamped_at_a_limit_is_no_velocity_command(rate: float) -> None:
    joint = Joint()
    joint.train(linear(0.0, 3.0, 1.0, rate), rate)
    joint.train([JointSetPoint(3.0, 3.0 + 0.01 * k) for k in range(50)], rate)
    assert all(point.streamed for point in joint.executed)
    assert "constant" in joint.refused[-1]


@RATES
def test_steps_of_a_position_controller_are_set_points_not_streamed(rate: float) -> None:
    joint = Joint()
    joint.train([*held(0.0, 50), *held(2.0, 50), *held(-1.0, 50)], rate)
    steps = joint.executed[50:]
    assert not any(point.streamed for point in steps)
    assert [steps[0].position, steps[-1].position] == [2.0, -1.0]
    joint.train(linear(-1.0, 1.0, 0.5, rate), rate)
    assert joint.executed[-1].streamed, "a trajectory controller continues"


@RATES
def test_a_new_command_of_a_position_controller_after_a_stop_is_executed_once(rate: float) -> None:
    for velocity in (None, 0.0):
        joint = Joint(3.0)
        joint.train(held(0.0, 50, velocity), rate)
        assert joint.executed == []
        joint.train(held(4.0, 50, velocity), rate)
        assert {point.position for point in joint.executed} == {4.0}
        joint.train(held(0.0, 50, velocity), rate)
        assert joint.executed[-1].position == 0.0, "its source has the joint"


def test_another_command_beside_a_refused_train_does_not_admit_the_train() -> None:
    joint = Joint(3.0)
    joint.train([*held(0.0, 50, None), JointSetPoint(3.5), *held(0.0, 50, None)])
    assert [point.position for point in joint.executed] == [3.5]


# ---- people and programs
def test_a_single_position_is_a_command_also_again_after_a_stop() -> None:
    joint = Joint()
    for _ in range(2):
        joint.send(JointSetPoint(31.4))
        joint.wait(GAP - 0.05)
        assert joint.executed == []
        joint.wait(0.1)
        assert joint.executed == [JointSetPoint(31.4)]
        joint.executed.clear()
        joint.release()
        joint.position = 10.0


def test_a_position_that_is_known_to_be_a_command_is_executed_at_once_beside_a_train() -> None:
    joint = Joint(3.0)
    joint.train(held(0.0, 50, None))
    joint.send(JointSetPoint(5.0), command=True)
    joint.train(held(0.0, 50, None))
    assert joint.executed == [JointSetPoint(5.0)]
    joint.send(JointSetPoint(9.0, 0.0), command=True)
    assert joint.executed == [JointSetPoint(5.0)], "a stream must join"


def test_a_computer_that_was_busy_does_not_make_a_message_isolated() -> None:
    joint = Joint(5.0)
    for _ in range(20):
        joint.send(JointSetPoint(0.0))
        joint.now += 3.0  # without processing
        joint.wait(0.01)
    assert joint.executed == []


def test_positions_that_begin_at_the_joint_are_followed_at_once() -> None:
    joint = Joint()
    joint.train([JointSetPoint(0.01 * k) for k in range(100)])
    assert len(joint.executed) == 100
    joint.release()
    joint.train([JointSetPoint(0.99)] * 20)
    assert len(joint.executed) == 100, "repeats"
    assert "repeats a set-point from before" in joint.refused[-1]
    joint.train([JointSetPoint(0.99 + 0.01 * k) for k in range(1, 50)])
    assert len(joint.executed) == 149


def test_a_fast_path_of_positions_does_not_continue_through_a_stop() -> None:
    joint = Joint()
    path = [JointSetPoint(0.3 * k) for k in range(100)]
    joint.train([JointSetPoint(0.0), *path[:50]])
    joint.release()
    before = len(joint.executed)
    joint.train(path[50:])
    assert joint.executed[before:] == []


def test_a_velocity_is_a_command_but_does_not_continue_through_a_stop() -> None:
    joint = Joint()
    spin = [JointSetPoint(velocity=50.0)] * 20
    joint.train(spin, 20.0)
    assert joint.executed == spin
    joint.release()
    joint.train(spin, 20.0)
    assert joint.executed == spin
    assert "accepted after one of 0, or after a pause" in joint.refused[-1]
    joint.train([JointSetPoint(velocity=0.0), *spin], 20.0)
    assert len(joint.executed) == 41
    joint.release()
    joint.wait(0.5)
    joint.train(spin, 20.0)
    assert len(joint.executed) == 61


def test_efforts_are_treated_as_velocities() -> None:
    joint = Joint()
    joint.train([JointSetPoint(effort=0.1)] * 3)
    joint.release()
    joint.train([JointSetPoint(effort=0.1)] * 3)
    assert len(joint.executed) == 3


def test_teleoperation_that_begins_in_motion_is_followed() -> None:
    joint = Joint()
    joint.train(linear(0.02, 2.0, 1.0, 20.0), 20.0)
    assert len(joint.executed) == 20


def test_a_stream_that_lost_messages_continues_within_its_own_speed() -> None:
    joint = Joint()
    path = linear(0.0, 2.0, 3.0, 100.0)
    joint.train(path[:100])
    at = joint.position
    joint.streaming, joint.velocity = False, 0.0  # the board has refused points
    joint.now += 0.3
    joint.train(path[130:])
    assert joint.executed[100] == path[130]
    assert joint.executed[100].position == pytest.approx(at + 0.6, abs=0.03)
    joint.streaming, joint.position = False, 0.0
    joint.train(path[-3:])
    assert "rad from the set-point" in joint.refused[-1]


@given(
    st.lists(st.sampled_from(["stop", "other", "pause", "silence"]), min_size=1, max_size=4),
    st.sampled_from([0.0, None]),
    st.sampled_from([20.0, 100.0, 500.0]),
    st.floats(-20.0, 20.0),
)
def test_a_repeated_position_never_moves_a_joint_that_is_elsewhere(
    events: list[str], velocity: float | None, rate: float, elsewhere: float
) -> None:
    joint = Joint()
    joint.train(held(0.0, 10, velocity), rate)
    for event in ["stop", *events]:
        if event == "stop":
            joint.release()
        elif event == "other":
            joint.driven_by("commands", joint.position)
        elif event == "pause":
            joint.wait(1.3)
        joint.position = elsewhere
        before = len(joint.executed)
        joint.train(held(0.0, 20, velocity), rate)
        joint.wait(0.5)
        if math.fabs(elsewhere) > JOIN_DISTANCE:
            assert joint.executed[before:] == []
