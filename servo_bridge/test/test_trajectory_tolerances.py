"""Goals of FollowJointTrajectory: tolerances, success and abort."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import State
from servo_bridge.trajectory.tolerances import Phase, Tolerance, ToleranceCheck, goal_time_from, tolerances_from

JOINTS = ("axis1", "axis2")
WIDE = dict.fromkeys(JOINTS, Tolerance())
PATH = {"axis1": Tolerance(position=0.5), "axis2": Tolerance(velocity=2.0)}
GOAL = dict.fromkeys(JOINTS, Tolerance(position=0.1, velocity=0.01))
ZERO = State.at_rest([0.0, 0.0])


def off(position: float = 0.0, velocity: float = 0.0, axis: int = 1) -> State:
    """Actual state with an error of one axis."""
    place = np.eye(2)[axis]
    return State(position * place, velocity * place, 0.0 * place, 0.0 * place)


def requested(name: str, position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)


def test_tolerance_zero_is_the_default_and_minus_one_is_none() -> None:
    defaults = {"axis1": Tolerance(0.5, 2.0)}
    result = tolerances_from([requested("axis1", 0.0, -1.0, 3.0)], JOINTS, defaults)
    assert result == {"axis1": Tolerance(0.5, math.inf, 3.0), "axis2": Tolerance()}
    assert list(result) == list(JOINTS)


@pytest.mark.parametrize(
    ("tolerance", "code", "sentence"),
    [
        (requested("axis1", -0.5), -1, r"tolerance of position of axis1 is -0\.5; send 0 for the default, -1 for none"),
        (requested("axis1", 0.0, math.nan), -1, "tolerance of velocity of axis1 is nan"),
        (requested("elbow"), -2, "tolerance of 'elbow', which is not in the trajectory"),
    ],
)
def test_illegal_tolerances_are_refused(tolerance: SimpleNamespace, code: int, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=sentence) as caught:
        tolerances_from([tolerance], JOINTS, {})
    assert caught.value.code == code


def test_goal_time_is_the_requested_or_the_default_one() -> None:
    assert goal_time_from(0.0, 0.7) == 0.7
    assert goal_time_from(0.2, 0.7) == 0.2
    for wrong in (-1.0, math.nan):
        with pytest.raises(TrajectoryError, match="goal_time_tolerance is"):
            goal_time_from(wrong, 0.7)


def test_a_goal_is_reached_at_the_end_and_not_before() -> None:
    check = ToleranceCheck(PATH, GOAL, 2.0, 0.5)
    assert check.update(1.999, ZERO, ZERO).phase is Phase.RUNNING
    outcome = check.update(2.0, ZERO, off(0.1, 0.01))
    assert (outcome.phase, outcome.code) == (Phase.SUCCEEDED, ErrorCode.SUCCESSFUL)
    assert check.update(3.0, ZERO, off(9.0)) is outcome


def test_goal_is_aborted_after_the_goal_time() -> None:
    check = ToleranceCheck(PATH, GOAL, 2.0, 0.5)
    assert check.update(2.49, ZERO, off(0.2)).phase is Phase.RUNNING
    outcome = check.update(2.51, ZERO, off(0.2))
    assert (outcome.phase, outcome.code) == (Phase.ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED)
    assert outcome.text == (
        "Aborted due to goal_time_tolerance exceeding by 0.010000 seconds: position of axis2 deviates by 0.2 rad, "
        "tolerance 0.1 rad"
    )
    late = ToleranceCheck(PATH, GOAL, 2.0, 0.5)
    assert late.update(2.4, ZERO, off(0.0, 0.02)).phase is Phase.RUNNING
    assert late.update(2.5, ZERO, off(0.05)).phase is Phase.SUCCEEDED


def test_goal_time_of_zero_is_a_finite_time() -> None:
    assert ToleranceCheck(PATH, GOAL, 2.0, 0.0).update(2.0, ZERO, off(0.2)).phase is Phase.ABORTED


@pytest.mark.parametrize(
    ("actual", "violated"),
    [
        (off(0.5, axis=0), ""),
        (off(0.6, axis=0), "position of axis1 deviates by 0.6 rad, tolerance 0.5 rad"),
        (off(9.0, axis=1), ""),
        (off(0.0, -2.1, axis=1), "velocity of axis2 deviates by 2.1 rad/s, tolerance 2 rad/s"),
        (off(math.nan, axis=0), ""),
    ],
)
def test_path_tolerance_is_checked_during_the_motion(actual: State, violated: str) -> None:
    outcome = ToleranceCheck(PATH, WIDE, 2.0, 0.5).update(1.0, ZERO, actual)
    if not violated:
        assert outcome.phase is Phase.RUNNING
        return
    assert (outcome.phase, outcome.code) == (Phase.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED)
    assert outcome.text == f"Aborted due to path tolerance violation: {violated}"
