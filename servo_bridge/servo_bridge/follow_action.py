"""The action ``follow_joint_trajectory`` (control_msgs/FollowJointTrajectory)."""

from __future__ import annotations

import importlib
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import Any, Final

import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.serialization import serialize_message
from servo_msgs_py.convert import to_stamp
from servo_msgs_py.joints import Joint
from servo_msgs_py.run_file.topic import Topic, type_of
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from servo_bridge.callback_watch import CallbackWatch
from servo_bridge.command_context import CommandContext
from servo_bridge.goals import Goals
from servo_bridge.raw_goal import with_raw_trajectories
from servo_bridge.runs.message_tap import MessageTap
from servo_bridge.set_points import Rejected
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.goal import PREEMPTED, Goal, GoalDefaults
from servo_bridge.trajectory.message import converted, read
from servo_bridge.trajectory.path import State
from servo_bridge.trajectory.tolerances import Phase, goal_time_from, tolerances_from
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

    Parameters
    ----------
    watch : CallbackWatch
        Measures the conversion of requests, which the executor calls.
    arguments
        Of `ActionServer`.
    """

    def __init__(self, watch: CallbackWatch, *arguments: Any, **options: Any) -> None:
        self._watch = watch
        super().__init__(*arguments, **options)

    def take_data(self) -> Any:
        """Take the requests that have arrived."""
        return self._watch.call(f"action {_SOURCE}: conversion", super().take_data)

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Do nothing: the goal is executing from now on."""

    def finish(self, goal_handle: Any, execute_callback: Callable[[Any], Any]) -> None:
        """End a goal and send the result that the callback returns, in the executor."""
        super().notify_execute(goal_handle, execute_callback)


class _Sender:
    """Sender of one goal: the handle of the action server."""

    def __init__(
        self,
        interface: Any,
        handle: Any,
        finish: Callable[[Any, Goal], None],
        joints: Sequence[str],
        gears: Mapping[str, Joint],
    ) -> None:
        self._type = interface
        self._handle = handle
        self._finish = finish
        self._joints, self._gears = list(joints), gears
        self._next_feedback = 0  # tick

    def cancelling(self) -> bool:
        return bool(self._handle.is_cancel_requested)

    def begun(self) -> None:
        pass

    def postponed(self) -> None:
        pass

    def moving(self, tick: int, stamp_ns: int, desired: State, actual: State) -> None:
        """Publish feedback if it is due."""
        if tick < self._next_feedback:
            return
        self._next_feedback = tick + _FEEDBACK_PERIODS
        feedback = self._type.Feedback(joint_names=self._joints)
        feedback.header.stamp = to_stamp(stamp_ns)
        feedback.desired, feedback.actual = (self._reported(state) for state in (desired, actual))
        error = State(
            desired.position - actual.position,
            desired.velocity - actual.velocity,
            desired.acceleration - actual.acceleration,
            desired.effort,
        )
        feedback.error = _point(error)
        self._handle.publish_feedback(feedback)

    def ended(self, goal: Goal) -> None:
        self._finish(self._handle, goal)

    def _reported(self, state: State) -> JointTrajectoryPoint:
        """State as in joint_states."""
        pairs = zip(self._joints, state.position, strict=True)
        positions = np.array([self._gears[joint].reported(position) for joint, position in pairs])
        return _point(replace(state, position=positions))


class FollowAction:
    """Action server of the bridge.

    Parameters
    ----------
    context : CommandContext
        Node and joints.
    interfaces : module
        ``control_msgs.action``.
    goals : Goals
        Follows and checks the goals.
    defaults : GoalDefaults
        Default tolerances.
    watch : CallbackWatch
        Measures the callbacks.
    tap : MessageTap
        Receives goals and results, for recordings.
    """

    def __init__(
        self,
        context: CommandContext,
        interfaces: ModuleType,
        goals: Goals,
        defaults: GoalDefaults,
        watch: CallbackWatch,
        tap: MessageTap,
    ) -> None:
        self._node = context.node
        name = self._node.resolve_topic_name(_SOURCE)
        self._called = tap.of_service(name, self._node.get_namespace())
        self._trajectory_seen = partial(tap.add, Topic(f"{name}/{topics.GOALS}", type_of(JointTrajectory)))
        self._gears = {joint.name: joint for joint in context.arbiter.joints}
        self._type: Any = interfaces.FollowJointTrajectory
        self._goals = goals
        self._defaults = defaults
        self._running: list[Any] = []  # handles of goals without a result
        self._trajectories: dict[bytes, bytes] = {}  # of goals that have arrived, serialised, by the id of the goal
        self._server = _Server(
            watch,
            self._node,
            with_raw_trajectories(self._type, self._trajectories),
            _SOURCE,
            lambda _handle: None,  # every goal is ended by `finish`
            handle_accepted_callback=watch.timed(f"action {_SOURCE}: goal", self._accept),
            cancel_callback=watch.timed(f"action {_SOURCE}: cancel", self._cancel),
        )

    def _cancel(self, handle: Any) -> CancelResponse:
        """Accept, unless the result is being sent."""
        return CancelResponse.ACCEPT if handle in self._running else CancelResponse.REJECT

    def _end(self, handle: Any, goal: Goal) -> None:
        def end(handle: Any) -> Any:
            if goal.canceled:
                handle.canceled()
            elif goal.outcome.phase is Phase.SUCCEEDED:
                handle.succeed()
            else:
                handle.abort()
            result = self._type.Result(error_code=int(goal.outcome.code), error_string=goal.outcome.text)
            self._called({"goal_id": _name(handle), "result": result}, "response")
            return result

        if handle in self._running:
            self._running.remove(handle)
        self._server.finish(handle, end)

    def _accept(self, handle: Any) -> None:
        handle.execute()
        request = handle.request
        data = self._trajectories.pop(bytes(handle.goal_id.uuid), None)
        joints = self._goals.joints_of(request.trajectory.joint_names)
        goal = Goal(joints, {}, {}, 0.0)
        try:
            self._record(handle, data)
            owner = _Sender(self._type, handle, self._end, joints, self._gears)
            trajectory = converted(request.trajectory) if data is None else read(data)
            self._goals.begin(_SOURCE, trajectory, self._goal(request, joints), owner, PREEMPTED)
        except Rejected as error:
            goal.refused(error)
        except Exception as error:  # an exception would end the executor
            self._node.get_logger().error(f"{_SOURCE}: {traceback.format_exc()}")
            goal.failed(f"{_SOURCE}: internal error: {error!r}")
        else:
            self._running.append(handle)
            return
        self._end(handle, goal)

    def _record(self, handle: Any, data: bytes | None) -> None:
        """Pass the trajectory, and then the rest of the goal, to a recording."""
        request = handle.request
        self._trajectory_seen(lambda: serialize_message(request.trajectory) if data is None else data)
        others = {name: getattr(request, name) for name in request.get_fields_and_field_types() if name != "trajectory"}
        self._called({"goal_id": _name(handle), **others}, "request")

    def _goal(self, request: Any, joints: list[str]) -> Goal:
        if len(request.multi_dof_trajectory.points) or len(request.multi_dof_trajectory.joint_names):
            raise TrajectoryError(f"{_SOURCE}: multi_dof_trajectory is not supported; leave it empty")
        if len(request.component_path_tolerance) or len(request.component_goal_tolerance):
            raise TrajectoryError(f"{_SOURCE}: tolerances of components are not supported; leave them empty")
        tolerance = request.goal_time_tolerance
        goal_time = goal_time_from(tolerance.sec + tolerance.nanosec * 1e-9, self._defaults.goal_time)
        path = tolerances_from(request.path_tolerance, joints, self._defaults.path)
        goal = tolerances_from(request.goal_tolerance, joints, self._defaults.goal)
        return Goal(joints, path, goal, goal_time)


def _name(handle: Any) -> str:
    """Identification of a goal, in hexadecimal digits."""
    return bytes(handle.goal_id.uuid).hex()


def _point(state: State) -> JointTrajectoryPoint:
    """State as a message; unknown quantities are omitted."""
    values = {"positions": state.position, "velocities": state.velocity, "accelerations": state.acceleration}
    known = {name: column.tolist() for name, column in values.items() if not np.isnan(column).any()}
    return JointTrajectoryPoint(**known)
