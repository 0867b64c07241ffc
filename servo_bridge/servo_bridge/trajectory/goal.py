"""State of one goal of control_msgs/FollowJointTrajectory, from its acceptance to its result.

Times are board time [s]; states contain the joints of the goal in their order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from servo_bridge.set_points import Rejected
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import State
from servo_bridge.trajectory.tolerances import Outcome, Phase, Tolerance, ToleranceCheck

PREEMPTED = "Current goal preempted by new incoming action."
"""Text of joint_trajectory_controller for a replaced goal."""

CANCELED = "cancelled; the joints have stopped and hold"

STOPPED = "the joints have stopped and hold"

WITHDRAWN = "cancelled before it began"


@dataclass(frozen=True)
class GoalDefaults:
    """Tolerances of goals without their own."""

    path: Mapping[str, Tolerance]  # by joint, during the motion
    goal: Mapping[str, Tolerance]  # by joint, at the end
    goal_time: float  # time limit for the goal tolerance after the end of the path [s]


class Step(Enum):
    """Next action of the owner of a goal."""

    NOTHING = "nothing"
    STOP = "stop"
    """Stop the joints of the goal and hold."""
    WITHDRAW = "withdraw"
    """Discard the path, which has not begun, and send the result."""
    END = "end"
    """Send the result, `Goal.outcome`; stop joints that still follow the path of an aborted goal."""


class Goal:
    """State of one goal.

    Parameters
    ----------
    joints : sequence of str
        Joints of the goal.
    path, goal : mapping of str to Tolerance
        By joint, in the order of `joints`: during the motion, and at the end.
    goal_time : float
        Time limit for the goal tolerance after the end of the path [s].
    """

    def __init__(
        self, joints: Sequence[str], path: Mapping[str, Tolerance], goal: Mapping[str, Tolerance], goal_time: float
    ) -> None:
        self.joints = list(joints)
        self.outcome = Outcome(Phase.RUNNING)  # result, once `ended`
        self.canceled = False  # whether it was ended by a cancel request
        self._tolerances = path, goal, goal_time
        self._check: ToleranceCheck | None = None
        self._canceling = self._stopping = False
        self._stopped_at = math.inf

    @property
    def ended(self) -> bool:
        """True if the result is known."""
        return self.outcome.phase is not Phase.RUNNING

    @property
    def moving(self) -> bool:
        """True while the path is followed."""
        return self._check is not None and not self.ended and not self._stopping

    # ---- events of the path
    def begun(self, end: float) -> None:
        """The path has begun; it ends at a time [s]."""
        self._check = ToleranceCheck(*self._tolerances[:2], end, self._tolerances[2])

    def postponed(self) -> None:
        """The first points have reached the board too late; the path will begin later."""
        self._check = None

    def refused(self, error: Rejected) -> None:
        """The path was refused."""
        code = error.code if isinstance(error, TrajectoryError) else ErrorCode.INVALID_GOAL
        self._abort(code, str(error))

    def abandoned(self, reason: str) -> None:
        """The path is not followed to its end, for this reason."""
        if not self._stopping:  # not by the stop of this goal
            self._abort(ErrorCode.INVALID_GOAL, reason)

    def cancel(self) -> None:
        """Cancel was requested."""
        self._canceling = True

    # ---- stop after a cancellation or an empty trajectory
    def stopping(self, end: float) -> None:
        """The joints are stopping; they are at rest at a time [s]."""
        self._stopping = True
        self._stopped_at = end

    def failed(self, reason: str) -> None:
        """The axes do not accept set-points any more."""
        self._abort(ErrorCode.INVALID_GOAL, reason)

    # ---- samples
    def sample(self, time: float, desired: State | None, actual: State) -> Step:
        """Compare the joints with the path.

        Parameters
        ----------
        time : float
            Time of the sample [s].
        desired, actual : State
            States of shape (joints,); `desired` is None before the path has begun.
        """
        if self.ended:
            return Step.END
        if self._stopping:
            if time < self._stopped_at:
                return Step.NOTHING
            self.canceled = self._canceling
            phase, text = (Phase.ABORTED, CANCELED) if self._canceling else (Phase.SUCCEEDED, STOPPED)
            self.outcome = Outcome(phase, ErrorCode.SUCCESSFUL, text)
            return Step.END
        if self._canceling and self._check is None:
            self.canceled = True
            self.outcome = Outcome(Phase.ABORTED, ErrorCode.SUCCESSFUL, WITHDRAWN)
            return Step.WITHDRAW
        if self._canceling:
            self._stopping = True
            return Step.STOP
        if self._check is None or desired is None:
            return Step.NOTHING
        self.outcome = self._check.update(time, desired, actual)
        return Step.NOTHING if self.outcome.phase is Phase.RUNNING else Step.END

    def _abort(self, code: ErrorCode, text: str) -> None:
        if not self.ended:
            self.outcome = Outcome(Phase.ABORTED, code, text)
