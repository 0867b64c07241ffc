"""One goal of control_msgs/FollowJointTrajectory, from its acceptance to its result. Pure.

Times are board time [s]; states are those of the joints of the goal, in their order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from servo_bridge.setpoints import Rejected
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import State
from servo_bridge.trajectory.tolerances import GoalMonitor, Outcome, Phase, Tolerance

PREEMPTED = "Current goal preempted by new incoming action."
"""What joint_trajectory_controller says of a goal that another one replaces."""

CANCELED = "cancelled; the joints have stopped and hold"

STOPPED = "the joints have stopped and hold"

WITHDRAWN = "cancelled before it began"


@dataclass(frozen=True)
class GoalDefaults:
    """What holds where a goal gives no tolerance."""

    path: Mapping[str, Tolerance]  # by joint, during the motion
    goal: Mapping[str, Tolerance]  # by joint, at the end
    goal_time: float  # longest wait for the goal after the end of the path [s]


class Step(Enum):
    """What its owner has to do for a goal."""

    NOTHING = "nothing"
    STOP = "stop"
    """Have the joints of the goal stop and hold."""
    WITHDRAW = "withdraw"
    """Its path has not begun: discard it, and send the result."""
    END = "end"
    """Send the result, `Goal.outcome`; joints that still follow the path of an aborted goal have to stop."""


class Goal:
    """State of one goal.

    Parameters
    ----------
    joints : sequence of str
        Joints that it moves.
    path, goal : mapping of str to Tolerance
        By joint, in the order of `joints`: on the way, and at the end.
    goal_time : float
        How long to wait for the goal after the end of the path [s].
    """

    def __init__(
        self, joints: Sequence[str], path: Mapping[str, Tolerance], goal: Mapping[str, Tolerance], goal_time: float
    ) -> None:
        self.joints = list(joints)
        self.outcome = Outcome(Phase.RUNNING)  # result, once `ended`
        self.canceled = False  # whether it ended because its client has cancelled it
        self._tolerances = path, goal, goal_time
        self._monitor: GoalMonitor | None = None
        self._canceling = self._stopping = False
        self._stopped_at = math.inf

    @property
    def ended(self) -> bool:
        """Whether the result is known."""
        return self.outcome.phase is not Phase.RUNNING

    @property
    def moving(self) -> bool:
        """Whether its path is followed."""
        return self._monitor is not None and not self.ended and not self._stopping

    # ---- what becomes of its path
    def begun(self, end: float) -> None:
        """Its path is followed from now on, until a time [s]."""
        self._monitor = GoalMonitor(*self._tolerances[:2], end, self._tolerances[2])

    def refused(self, error: Rejected) -> None:
        """Its path is not followed."""
        code = error.code if isinstance(error, TrajectoryError) else ErrorCode.INVALID_GOAL
        self._abort(code, str(error))

    def abandoned(self, reason: str) -> None:
        """Something else moves a joint, or holds it up."""
        if not self._stopping:  # by the stop of the goal itself
            self._abort(ErrorCode.INVALID_GOAL, reason)

    def cancel(self) -> None:
        """Cancel requested."""
        self._canceling = True

    # ---- a stop: after a cancellation, or because the trajectory is empty
    def stopping(self, end: float) -> None:
        """The joints stop, and rest from a time on [s]."""
        self._stopping = True
        self._stopped_at = end

    def failed(self, reason: str) -> None:
        """The axes obey nothing any more."""
        self._abort(ErrorCode.INVALID_GOAL, reason)

    # ---- time
    def sample(self, time: float, desired: State | None, actual: State) -> Step:
        """Compare the joints with the path at one instant.

        Parameters
        ----------
        time : float
            Of the sample [s].
        desired, actual : State
            States of shape (joints,); `desired` is None as long as the path has not begun.
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
        if self._canceling and self._monitor is None:
            self.canceled = True
            self.outcome = Outcome(Phase.ABORTED, ErrorCode.SUCCESSFUL, WITHDRAWN)
            return Step.WITHDRAW
        if self._canceling:
            self._stopping = True
            return Step.STOP
        if self._monitor is None or desired is None:
            return Step.NOTHING
        self.outcome = self._monitor.update(time, desired, actual)
        return Step.NOTHING if self.outcome.phase is Phase.RUNNING else Step.END

    def _abort(self, code: ErrorCode, text: str) -> None:
        if not self.ended:
            self.outcome = Outcome(Phase.ABORTED, code, text)
