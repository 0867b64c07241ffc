"""States of a goal of FollowJointTrajectory, in simulated time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from servo_bridge.set_points import NotReady
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.goal import PREEMPTED, Goal, Step
from servo_bridge.trajectory.path import State
from servo_bridge.trajectory.tolerances import Phase, Tolerance

TARGET = State.at_rest([1.0])


def goal(goal_time: float = 1.0) -> Goal:
    return Goal(["axis1"], {"axis1": Tolerance(0.5)}, {"axis1": Tolerance(0.1)}, goal_time)


def at(position: float) -> State:
    unknown = np.array([math.nan])
    return State(np.array([position]), np.array([0.0]), unknown, unknown)


def test_goal_succeeds_at_the_end_of_its_path_within_its_tolerance() -> None:
    subject = goal()
    assert subject.sample(0.0, None, at(9.0)) is Step.NOTHING
    subject.begun(2.0)
    assert subject.moving
    assert subject.sample(1.0, TARGET, at(0.6)) is Step.NOTHING
    assert subject.sample(2.5, TARGET, at(0.8)) is Step.NOTHING, "it may still reach its tolerance"
    assert subject.sample(2.6, TARGET, at(0.95)) is Step.END
    assert subject.outcome.phase is Phase.SUCCEEDED


@pytest.mark.parametrize(
    ("time", "position", "code"),
    [(1.0, 0.4, ErrorCode.PATH_TOLERANCE_VIOLATED), (3.1, 0.8, ErrorCode.GOAL_TOLERANCE_VIOLATED)],
)
def test_a_joint_that_leaves_its_tolerance_ends_the_goal(time: float, position: float, code: ErrorCode) -> None:
    subject = goal()
    subject.begun(2.0)
    assert subject.sample(time, TARGET, at(position)) is Step.END
    assert (subject.outcome.phase, subject.outcome.code) == (Phase.ABORTED, code)
    assert "axis1" in subject.outcome.text


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (TrajectoryError("no", ErrorCode.INVALID_JOINTS), ErrorCode.INVALID_JOINTS),
        (NotReady("not enabled"), ErrorCode.INVALID_GOAL),
    ],
)
def test_refusal_is_the_result_of_the_goal(error: TrajectoryError, code: ErrorCode) -> None:
    subject = goal()
    subject.refused(error)
    assert subject.sample(0.0, None, at(0.0)) is Step.END
    assert (subject.outcome.code, subject.outcome.text) == (code, str(error))


def test_a_cancelled_goal_ends_when_the_joints_have_stopped() -> None:
    subject = goal()
    subject.begun(2.0)
    subject.cancel()
    assert subject.sample(0.5, TARGET, at(0.9)) is Step.STOP
    assert not subject.moving
    subject.abandoned("another trajectory took over")  # its own stop
    assert subject.sample(0.6, TARGET, at(0.9)) is Step.NOTHING
    subject.stopping(0.8)
    assert subject.sample(0.7, TARGET, at(0.9)) is Step.NOTHING
    assert subject.sample(0.8, TARGET, at(0.9)) is Step.END
    assert subject.canceled


def test_cancelling_a_goal_before_its_start_stops_no_joint() -> None:
    subject = goal()
    subject.cancel()
    assert subject.sample(0.5, None, at(0.0)) is Step.WITHDRAW
    assert subject.canceled
    assert subject.ended


def test_postponed_goal_waits_without_tolerances_until_it_begins_again() -> None:
    subject = goal()
    subject.begun(2.0)
    subject.postponed()
    assert not subject.moving
    assert subject.sample(3.5, None, at(9.0)) is Step.NOTHING
    subject.begun(6.0)
    assert subject.sample(5.0, TARGET, at(0.6)) is Step.NOTHING
    assert subject.sample(6.1, TARGET, at(0.95)) is Step.END
    assert subject.outcome.phase is Phase.SUCCEEDED


def test_cancelling_a_postponed_goal_discards_its_path() -> None:
    subject = goal()
    subject.begun(2.0)
    subject.postponed()
    subject.cancel()
    assert subject.sample(2.1, None, at(0.0)) is Step.WITHDRAW


def test_a_cancelled_goal_whose_stop_is_refused_is_aborted() -> None:
    subject = goal()
    subject.begun(2.0)
    subject.cancel()
    subject.sample(0.5, TARGET, at(0.9))
    subject.failed("axis1 is in FAULT")
    assert subject.sample(0.6, TARGET, at(0.9)) is Step.END
    assert not subject.canceled
    assert subject.outcome.text == "axis1 is in FAULT"


def test_first_reason_is_kept() -> None:
    subject = goal()
    subject.begun(2.0)
    subject.abandoned(PREEMPTED)
    subject.abandoned("later")
    assert subject.outcome.text == PREEMPTED
