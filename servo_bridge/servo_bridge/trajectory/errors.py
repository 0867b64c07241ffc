"""Refusals of trajectories, with the error codes of control_msgs/action/FollowJointTrajectory."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from servo_bridge.set_points import Rejected

POINTS_REFUSED: Final = "the board refused points of the trajectory"
"""Reason for the end of a path that has begun."""


class ErrorCode(IntEnum):
    """``error_code`` of a result of control_msgs/action/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class TrajectoryError(Rejected):
    """A trajectory was refused; the text has the error, its location and a remedy."""

    def __init__(self, text: str, code: ErrorCode = ErrorCode.INVALID_GOAL, kind: str = "") -> None:
        super().__init__(text)
        self.kind = kind
        self.code = code  # for the result of an action
