"""Success and failure criteria of a goal of control_msgs/FollowJointTrajectory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any

import numpy as np

from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import State

_UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}


class Phase(Enum):
    """Phase of a goal."""

    RUNNING = "running"
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"


@dataclass(frozen=True)
class Outcome:
    """Result of a goal."""

    phase: Phase  # running, succeeded or aborted
    code: ErrorCode = ErrorCode.SUCCESSFUL  # ``error_code`` of the result
    text: str = ""  # ``error_string`` of the result


@dataclass(frozen=True)
class Tolerance:
    """Largest permitted deviations of a joint from its path; infinite: no limit."""

    position: float = math.inf  # [rad]
    velocity: float = math.inf  # [rad/s]
    acceleration: float = math.inf  # [rad/s^2]


def tolerances_from(
    requested: Iterable[Any], joints: Sequence[str], defaults: Mapping[str, Tolerance]
) -> dict[str, Tolerance]:
    """Return the tolerances of all joints of a goal.

    Parameters
    ----------
    requested : iterable of control_msgs/JointTolerance
        0: default; -1: no tolerance; above 0: the tolerance.
    joints : sequence of str
        Joints of the goal.
    defaults : mapping of str to Tolerance
        By joint; missing joints have no tolerance.

    Raises
    ------
    TrajectoryError
        If a joint is not in the goal, or a number is NaN or negative except -1.
    """
    result = {joint: defaults.get(joint, Tolerance()) for joint in joints}
    for tolerance in requested:
        name = tolerance.name
        if name not in result:
            raise TrajectoryError(
                f"tolerance of {name!r}, which is not in the trajectory; use one of {', '.join(joints)}",
                ErrorCode.INVALID_JOINTS,
            )
        values = {}
        for field in fields(Tolerance):
            value = float(getattr(tolerance, field.name))
            if math.isnan(value) or (value < 0.0 and value != -1.0):
                raise TrajectoryError(
                    f"tolerance of {field.name} of {name} is {value:g}; send 0 for the default, -1 for none, or more "
                    "than 0"
                )
            values[field.name] = math.inf if value == -1.0 else value or getattr(result[name], field.name)
        result[name] = Tolerance(**values)
    return result


def goal_time_from(requested: float, default: float) -> float:
    """Time limit for the goal tolerance after the end of the path [s]; 0: default.

    Raises
    ------
    TrajectoryError
        If the value is NaN or negative.
    """
    if math.isnan(requested) or requested < 0.0:
        raise TrajectoryError(f"goal_time_tolerance is {requested:g} s; send 0 for the default, or more")
    return requested or default


class ToleranceCheck:
    """Compares a motion with its path until the goal has succeeded or failed.

    Parameters
    ----------
    path, goal : mapping of str to Tolerance
        By joint, in the order of the joints of the states: during the motion, and at the end.
    end_time : float
        End of the path [s].
    goal_time : float
        Time limit for the goal tolerance after that [s]; 0: evaluation at the end, without waiting.
    """

    def __init__(
        self, path: Mapping[str, Tolerance], goal: Mapping[str, Tolerance], end_time: float, goal_time: float
    ) -> None:
        self._path, self._goal = path, goal
        self._end_time, self._goal_time = end_time, goal_time
        self.outcome = Outcome(Phase.RUNNING)

    def update(self, time: float, desired: State, actual: State) -> Outcome:
        """Compare one sample; a final outcome does not change.

        Parameters
        ----------
        time : float
            Path time [s].
        desired, actual : State
            States of shape (joints,); NaN in `actual`: unknown, not compared.
        """
        if self.outcome.phase is not Phase.RUNNING:
            return self.outcome
        if time < self._end_time:
            excess = _first_excess(self._path, desired, actual)
            if excess:
                text = f"Aborted due to path tolerance violation: {excess}"
                self.outcome = Outcome(Phase.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED, text)
            return self.outcome
        excess = _first_excess(self._goal, desired, actual)
        late = time - self._end_time - self._goal_time
        if not excess:
            self.outcome = Outcome(Phase.SUCCEEDED, ErrorCode.SUCCESSFUL, "Goal successfully reached!")
        elif late >= 0.0:
            text = f"Aborted due to goal_time_tolerance exceeding by {late:.6f} seconds: {excess}"
            self.outcome = Outcome(Phase.ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED, text)
        return self.outcome


def _first_excess(tolerances: Mapping[str, Tolerance], desired: State, actual: State) -> str:
    for axis, (joint, tolerance) in enumerate(tolerances.items()):
        for field in fields(tolerance):
            limit = getattr(tolerance, field.name)
            error = float(np.abs(getattr(desired, field.name)[axis] - getattr(actual, field.name)[axis]))
            if error > limit:
                unit = _UNITS[field.name]
                return f"{field.name} of {joint} deviates by {error:g} {unit}, tolerance {limit:g} {unit}"
    return ""
