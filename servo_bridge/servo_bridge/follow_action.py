"""The action ``follow_joint_trajectory`` (control_msgs/FollowJointTrajectory)."""

from __future__ import annotations

import contextlib
import importlib
import math
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse
from servo_msgs_py.convert import to_stamp
from trajectory_msgs.msg import JointTrajectoryPoint

from servo_bridge.command_context import CommandContext
from servo_bridge.set_points import Rejected
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.follower import Follower, Plan
from servo_bridge.trajectory.goal import CANCELED, PREEMPTED, Goal, GoalDefaults, Step
from servo_bridge.trajectory.merge import merged
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.timed_points import PERIOD
from servo_bridge.trajectory.tolerances import Phase, goal_time_from, tolerances_from
from servo_bridge.trajectory_topics import TrajectoryTopics
from servo_msgs_py import topics

_SOURCE: Final = topics.FOLLOW_JOINT_TRAJECTORY
_FEEDBACK_PERIODS: Final = 800  # 50 ms


def action_interfaces() -> ModuleType | None:
    """The module ``control_msgs.action``; None if it is not installed."""
    try:
        return importlib.import_module("control_msgs.action")
    except ImportError:
        return None


class _Server(ActionServer):
    """Action server whose owner ends the goals.

    With rclpy alone, a function that returns the result blocks the executor, and the events executor polls a waiting
    coroutine without pause, which occupies a core.
    """

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Do nothing: the goal is executing from now on."""

    def finish(self, goal_handle: Any, execute_callback: Callable[[Any], Any]) -> None:
        """End a goal and send the result that the callback returns, in the executor."""
        super().notify_execute(goal_handle, execute_callback)


@dataclass
class _Active:
    """A goal whose result has not been sent."""

    handle: Any
    goal: Goal
    plan: Plan | None = None  # for `Follower.withdraw` before the path has begun
    paths: Mapping[str, Path] = field(default_factory=dict)  # by joint, from the follower
    path: Path | None = None  # merged path of all joints
    next_feedback: int = 0  # tick


class FollowAction:
    """Action server of the bridge.

    Parameters
    ----------
    context : CommandContext
        Node and joints.
    interfaces : module
        ``control_msgs.action``.
    trajectories : TrajectoryTopics
        Checks trajectories and starts them.
    follower : Follower
        Has the paths of the joints.
    defaults : GoalDefaults
        Default tolerances.
    """

    def __init__(
        self,
        context: CommandContext,
        interfaces: ModuleType,
        trajectories: TrajectoryTopics,
        follower: Follower,
        defaults: GoalDefaults,
    ) -> None:
        self._node = context.node
        self._type: Any = interfaces.FollowJointTrajectory
        self._joints = list(context.joints)
        self._gears = {joint.name: joint for joint in context.arbiter.joints}
        self._trajectories = trajectories
        self._follower = follower
        self._defaults = defaults
        self._active: list[_Active] = []
        self._server = _Server(
            context.node,
            self._type,
            _SOURCE,
            lambda _handle: None,  # every goal is ended by `finish`
            handle_accepted_callback=self._accept,
            cancel_callback=self._cancel,
        )

    # ---- goals
    def _cancel(self, handle: Any) -> CancelResponse:
        """Accept, unless the result is being sent."""
        known = any(active.handle == handle for active in self._active)
        return CancelResponse.ACCEPT if known else CancelResponse.REJECT

    def _end(self, handle: Any, goal: Goal) -> None:
        def end(handle: Any) -> Any:
            if goal.canceled:
                handle.canceled()
            elif goal.outcome.phase is Phase.SUCCEEDED:
                handle.succeed()
            else:
                handle.abort()
            return self._type.Result(error_code=int(goal.outcome.code), error_string=goal.outcome.text)

        self._server.finish(handle, end)

    def _accept(self, handle: Any) -> None:
        handle.execute()
        request = handle.request
        names = list(request.trajectory.joint_names)
        joints = [joint for joint in self._joints if joint in names or not names]
        goal = Goal(joints, {}, {}, 0.0)
        try:
            active = self._begin(handle, joints)
        except Rejected as error:
            goal.refused(error)
        except Exception as error:  # an exception would end the executor
            self._node.get_logger().error(f"{_SOURCE}: {traceback.format_exc()}")
            goal.failed(f"{_SOURCE}: internal error: {error!r}")
        else:
            self._active.append(active)
            return
        self._end(handle, goal)

    def _begin(self, handle: Any, joints: Sequence[str]) -> _Active:
        """Start to follow a goal.

        Raises
        ------
        Rejected
            If the goal is refused.
        """
        request = handle.request
        goal = self._goal(request, joints)
        if not len(request.trajectory.points):
            goal.stopping(self._trajectories.stop(_SOURCE, request.trajectory.joint_names, PREEMPTED))
            return _Active(handle, goal)

        def begun(end: float) -> None:
            goal.begun(end)
            paths = self._follower.paths()
            active.paths = {joint: paths[joint] for joint in goal.joints}
            active.path = merged(list(active.paths.values()))

        def postponed() -> bool:
            if goal.ended:
                return False
            goal.postponed()
            active.paths, active.path = {}, None
            return True

        active = _Active(handle, goal)
        active.plan = self._trajectories.follow(
            _SOURCE,
            request.trajectory,
            begun=begun,
            refused=goal.refused,
            abandoned=goal.abandoned,
            postponed=postponed,
            takes_over=PREEMPTED,
        )
        return active

    def _goal(self, request: Any, joints: Sequence[str]) -> Goal:
        if len(request.multi_dof_trajectory.points) or len(request.multi_dof_trajectory.joint_names):
            raise TrajectoryError(f"{_SOURCE}: multi_dof_trajectory is not supported; leave it empty")
        if len(request.component_path_tolerance) or len(request.component_goal_tolerance):
            raise TrajectoryError(f"{_SOURCE}: tolerances of components are not supported; leave them empty")
        tolerance = request.goal_time_tolerance
        goal_time = goal_time_from(tolerance.sec + tolerance.nanosec * 1e-9, self._defaults.goal_time)
        path = tolerances_from(request.path_tolerance, joints, self._defaults.path)
        goal = tolerances_from(request.goal_tolerance, joints, self._defaults.goal)
        return Goal(joints, path, goal, goal_time)

    # ---- samples
    def on_sample(self, tick: int, stamp_ns: int, position: Sequence[float], velocity: Sequence[float]) -> None:
        """Check the goals with a sample of the board.

        Parameters
        ----------
        tick : int
            Extended tick.
        stamp_ns : int
            ROS time of the tick [ns].
        position, velocity : sequence of float
            Of all joints [rad], [rad/s].
        """
        for active in list(self._active):
            axes = [self._joints.index(joint) for joint in active.goal.joints]
            actual = _measured([position[axis] for axis in axes], [velocity[axis] for axis in axes])
            desired = None if active.path is None else active.path.state(tick * PERIOD)
            if active.handle.is_cancel_requested:
                active.goal.cancel()
            moving = active.goal.moving
            step = active.goal.sample(tick * PERIOD, desired, actual)
            if step is Step.STOP:
                self._stop(active.goal)
            elif step is Step.WITHDRAW and active.plan is not None:
                self._follower.withdraw(active.plan)
            if active.goal.ended:
                self._active.remove(active)
                self._end(active.handle, active.goal)
                if active.goal.outcome.phase is Phase.ABORTED:
                    self._stop_remaining(active)
            elif moving and desired is not None and tick >= active.next_feedback:
                active.next_feedback = tick + _FEEDBACK_PERIODS
                active.handle.publish_feedback(self._feedback(active, stamp_ns, desired, actual))

    def link_lost(self, reason: str) -> None:
        """End all goals, because there are no more samples."""
        active, self._active = self._active, []
        for each in active:
            each.goal.failed(reason)
            self._end(each.handle, each.goal)

    def _stop(self, goal: Goal) -> None:
        """Stop the joints of a cancelled goal."""
        try:
            end = self._trajectories.stop(_SOURCE, goal.joints, CANCELED)
        except Rejected as error:
            goal.failed(str(error))
        else:
            goal.stopping(end)

    def _stop_remaining(self, active: _Active) -> None:
        """Stop the joints that still follow the path of an aborted goal."""
        paths = self._follower.paths()
        joints = [joint for joint, path in active.paths.items() if paths.get(joint) is path]
        if joints:
            with contextlib.suppress(Rejected):  # the board has stopped them already
                self._trajectories.stop(_SOURCE, joints, active.goal.outcome.text)

    def _feedback(self, active: _Active, stamp_ns: int, desired: State, actual: State) -> Any:
        feedback = self._type.Feedback(joint_names=active.goal.joints)
        feedback.header.stamp = to_stamp(stamp_ns)
        feedback.desired, feedback.actual = (
            _point(replace(state, position=self._reported(active.goal.joints, state.position)))
            for state in (desired, actual)
        )
        error = State(
            desired.position - actual.position,
            desired.velocity - actual.velocity,
            desired.acceleration - actual.acceleration,
            desired.effort,
        )
        feedback.error = _point(error)
        return feedback

    def _reported(self, joints: Sequence[str], positions: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([self._gears[joint].reported(x) for joint, x in zip(joints, positions, strict=True)])


def _measured(position: Sequence[float], velocity: Sequence[float]) -> State:
    unknown = np.full(len(position), math.nan)
    return State(np.array(position), np.array(velocity), unknown, unknown)


def _point(state: State) -> JointTrajectoryPoint:
    """State as a message; unknown quantities are omitted."""
    values = {"positions": state.position, "velocities": state.velocity, "accelerations": state.acceleration}
    known = {name: column.tolist() for name, column in values.items() if not np.isnan(column).any()}
    return JointTrajectoryPoint(**known)
