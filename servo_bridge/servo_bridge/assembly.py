"""Construction of the parts of a bridge, and what connects them.

Path of a set-point: `set_point_topics` -> `set_points` (form) -> `arbiter` (limits, states) -> `set_point_queue` ->
`dispatcher` (one write at a time) -> `link` (serial port, own thread) -> firmware. Path of a sample: `link` -> `inbox`
(to the thread of the executor) -> `telemetry` -> parts, the last of which are the `publications`.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, TypeVar

from rclpy.node import Node
from servo_msgs_py.board_parameters import RawParameters, applied
from servo_msgs_py.catalogue import AXES, Catalogue, Value, numbers
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.fault_record import FaultRecord
from servo_msgs_py.robot_description import describe
from servo_msgs_py.timed_points import periods_ahead
from servo_msgs_py.units import PERIOD
from std_srvs.srv import SetBool, Trigger

from servo_bridge.answers import Answers
from servo_bridge.arbiter import Arbiter, stop_delay
from servo_bridge.board_context import BoardContext
from servo_bridge.board_link import BoardLink
from servo_bridge.board_requests import BoardRequests
from servo_bridge.bursts.record_service import RecordService
from servo_bridge.bursts.recording import piece_size
from servo_bridge.callback_watch import CallbackWatch
from servo_bridge.command_context import CommandContext
from servo_bridge.deferred_service import DeferredService
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.fault_records import FaultRecords
from servo_bridge.follow_action import FollowAction, action_interfaces
from servo_bridge.goals import Goals
from servo_bridge.homing import Homing, with_home_states
from servo_bridge.joint_commands import JointCommands
from servo_bridge.motion_services import MotionServices
from servo_bridge.outcome import error_of
from servo_bridge.parameter_sync import ParameterSync
from servo_bridge.parameters import Settings, values_of
from servo_bridge.part import Part
from servo_bridge.publications import Publications
from servo_bridge.runs.message_tap import MessageTap
from servo_bridge.runs.run_info_topic import RunInfoTopic
from servo_bridge.runs.run_service import RunService
from servo_bridge.sample_clocks import SampleClocks
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.set_point_topics import SetPointTopics
from servo_bridge.slow_values import SlowValues
from servo_bridge.snapshot_events import SnapshotEvents
from servo_bridge.storage_service import StorageService
from servo_bridge.telemetry import Telemetry
from servo_bridge.trajectory.check import Limits, require
from servo_bridge.trajectory.follower import Follower
from servo_bridge.trajectory.line_capacity import SAMPLE_BYTES, PointLine, point_line
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.streamer import Streamer, stream_lead
from servo_bridge.trajectory_limits import path_limits
from servo_bridge.trajectory_topic import TrajectoryTopic
from servo_bridge.tuning.service import TuningService
from servo_bridge.variable_topics import VariableTopics
from servo_bridge.wire.keep_alive import keep_alive_period
from servo_msgs_py import topics

T = TypeVar("T")

_URGENT: Final = ("cmd.enable", "cmd.quick_stop", "cmd.clear_faults")


class Assembly:
    """The parts of a bridge with their topics and services; in the thread of the executor.

    Parameters
    ----------
    node : Node
        Owner of topics, services and timers.
    catalogue : Catalogue
        Table of variables.
    settings : Settings
        Parameters of the node.
    link : BoardLink
        Link to the board.
    post : callable
        Runs a function in the thread of the executor; from any thread.
    watch : CallbackWatch
        Of the callbacks of the node.
    tap : MessageTap
        Of the messages of the node.
    """

    def __init__(
        self,
        node: Node,
        catalogue: Catalogue,
        settings: Settings,
        link: BoardLink,
        post: Callable[[Callable[[], None]], None],
        watch: CallbackWatch,
        tap: MessageTap,
    ) -> None:
        self.settings = settings
        self._node, self._catalogue, self._link = node, catalogue, link
        self._log = node.get_logger()
        self._planner = ThreadPoolExecutor(1, "servo planner")
        joints, sample_size = settings.names, link.layout.size
        self._joints = joints
        self._context = context = BoardContext(catalogue, link.read, link.call, post, self._info, self._warn)
        self.telemetry = Telemetry(catalogue, link.layout.variables)
        self.clocks = SampleClocks(node.get_clock(), sample_size * 10 * 1_000_000_000 // settings.baud)

        # Values of the board
        self.slow = SlowValues(
            context, self._on_motors, lambda found: self.publications.windings([each.temperature for each in found])
        )
        self.parameters = ParameterSync(context, lambda *write: self.dispatcher.parameter(*write), self._on_parameters)
        self.parameters.request(settings.board_parameters)
        self.events = SnapshotEvents(
            catalogue,
            joints,
            self._error,
            self._warn,
            lambda: link.statistics().silence,
            lambda: self.parameters.values,
        )
        self.fault_records = FaultRecords(context, self._on_fault_record)
        self.variables = VariableTopics(
            context,
            node,
            joints,
            [catalogue[name] for name in settings.variables],
            self.telemetry.columns,
            settings.variable_rate,
        )

        # Commands
        self.arbiter = Arbiter(
            catalogue,
            settings.joints,
            limits=self.path_limits,
            delay=stop_delay(settings.baud),
            warn=self._warn,
        )
        self.arbiter.sources.preferred = settings.preferred_source
        self.dispatcher = Dispatcher(self._send, self.arbiter.queue, self._warn, self._on_applied)
        self.commands = CommandContext(
            node, joints, self.arbiter, self.path_limits, self.dispatcher.pump, self._info, self._warn
        )
        self.follower = Follower(
            catalogue, settings.joints, self._check_path, work=self._plan_aside, line=self._point_line
        )
        self.arbiter.queue.follow(self.follower)
        self.streamer = Streamer(
            settings.joints,
            self.follower,
            stream_lead(settings.baud),
            settings.stream_delay_max or None,
            lambda: point_line(settings.baud, sample_size, 0.0),  # a delay of the computer passes
        )
        answers = Answers(node)
        self.goals = Goals(self.commands, self.follower, origin_ns=lambda: self.clocks.origin_ns, info=self._info)
        self.joint_commands = JointCommands(
            self.commands, self.streamer, answers, interfaces=settings.command_interfaces, clocks=self.clocks
        )
        self.motion = MotionServices(context, joints, self.arbiter, self.dispatcher)
        self.homing = Homing(
            context,
            settings.joints,
            settings.home_positions,
            settings.restore_positions,
            self.arbiter,
            self.dispatcher,
            self._features,
            self._position_moved,
        )
        self.records = RecordService(
            context, node, settings.recording, piece_size(sample_size, settings.baud), self.clocks.times
        )
        self.requests = BoardRequests(context)
        self.tuning = TuningService(
            context,
            node,
            settings.tuning,
            take=self.dispatcher.urgent,
            taken=self._nominal_values_changed,
            requests=self.requests,
        )
        self.storage = StorageService(context, node, self.requests)
        self.run_info = RunInfoTopic(
            node,
            catalogue,
            settings.port,
            values_of(node),
            lambda: link.board,
            lambda: self.parameters.values,
            lambda: self.tuning.blocks,
        )
        self.run = RunService(context, node, tap, settings.run, self.run_info.refresh)
        self._entities = [
            SetPointTopics(self.commands),
            TrajectoryTopic(self.commands, self.goals, answers, settings.goal_defaults, self._warn),
            self._follow_action(watch, tap),
            DeferredService(node, SetBool, topics.ENABLE, lambda request: self.motion.enable(request.data)),
            DeferredService(node, Trigger, topics.QUICK_STOP, lambda _: self.motion.quick_stop()),
            DeferredService(node, Trigger, topics.CLEAR_FAULTS, lambda _: self.motion.clear_faults()),
            *(self._home_service(axis, method) for axis in range(AXES) for method in topics.HOME_METHODS),
        ]
        self.publications = Publications(
            node,
            settings.joints,
            with_home_states(self.telemetry.columns),
            self.homing,
            lambda: self.slow.torque_constants,
            joint_states_rate=settings.joint_states_rate,
            snapshot_period=settings.snapshot_period,
        )
        self.order: tuple[Part, ...] = (
            self.slow,
            self.parameters,
            self.events,
            self.fault_records,
            self.arbiter,  # states and limits of the axes, for all commands; advances the follower
            self.joint_commands,  # extends the paths of streams, which goals check
            self.goals,
            self.dispatcher,  # sends what the parts before it command; an effect is published before its sample
            self.motion,
            self.homing,
            self.variables,
            self.records,
            self.storage,
            self.tuning,
            self.requests,
            self.publications,
            self.run,
        )
        """Order in which the parts learn of connections, samples and their loss."""
        self.pace_keep_alive()
        self.publish_description()
        if settings.run.path:
            self.run.begin()

    def close(self) -> None:
        """End the threads of the parts."""
        for part in self.order:
            part.close()
        self._planner.shutdown(wait=False, cancel_futures=True)

    def apply(self, settings: Settings) -> None:
        """Apply new settings."""
        before, self.settings = self.settings, settings
        if settings.board_parameters != before.board_parameters:
            self.parameters.request(settings.board_parameters)
        self.arbiter.joints = list(settings.joints)
        self.homing.joints, self.homing.positions = list(settings.joints), list(settings.home_positions)
        self.homing.restores = settings.restore_positions
        self.records.request = settings.recording
        self.run.settings = settings.run
        self.run_info.settings = values_of(self._node)
        self.tuning.path = settings.tuning
        self.arbiter.sources.preferred = settings.preferred_source
        self.publish_description()
        self.pace_keep_alive()

    def publish_description(self) -> None:
        """Publish the robot description if it has changed."""
        resolve = self._node.resolve_topic_name
        text = describe(
            self.settings.joints,
            self._catalogue,
            commands_topic=resolve(topics.JOINT_COMMANDS),
            states_topic=resolve(topics.JOINT_STATES),
            interfaces=self.settings.command_interfaces,
            motors=self.slow.motors,
        )
        self.publications.description(text)

    def pace_keep_alive(self) -> None:
        """Set the period of the keep-alive from the time-out of the board."""
        # Requested parameters may be effective on the board before they are read back.
        known = applied(self.parameters.wanted, {}), self.parameters.values or {}
        self._link.set_keep_alive_period(keep_alive_period(self._catalogue, *known))

    def path_limits(self) -> list[Limits] | None:
        """Present limits of every joint; None if the board has not reported them yet."""
        values = self.parameters.values
        if values is None or not self.slow.motors:
            return None
        return path_limits(self._catalogue, values, self.settings.joints, self.slow.motors)

    # ---- entities
    def _home_service(self, axis: int, method: str) -> DeferredService:
        name = topics.home_service(self._joints[axis], method)
        return DeferredService(self._node, Trigger, name, lambda _: self.homing.home(axis, method))

    def _follow_action(self, watch: CallbackWatch, tap: MessageTap) -> FollowAction | None:
        interfaces = action_interfaces()
        if interfaces is None:
            self._info(
                f"the action {topics.FOLLOW_JOINT_TRAJECTORY} is not offered: control_msgs is not installed (it comes "
                "with ros-jazzy-control-msgs)"
            )
            return None
        return FollowAction(self.commands, interfaces, self.goals, self.settings.goal_defaults, watch, tap)

    # ---- connections between parts
    def _send(self, write: CommandWrite) -> None:
        """Start a write; its result returns through the inbox, in order with the samples."""

        def done(future: Future[None]) -> None:
            discarded = self.dispatcher.acknowledged(write, error_of(future))
            if discarded and write.variable == "cmd.points":
                self._log_refusal()

        # A stop must not wait for parameters on a slow line; parameters must not wait for a stream of set-points.
        urgent = write.variable in _URGENT
        written = self._link.write_raw(write.variable, write.raw, first=write.first, urgent=urgent)
        self._context.when_done(written, done)

    def _log_refusal(self) -> None:
        """Log the reason of the board for the refusal of timed points."""

        def log(future: Future[Value]) -> None:
            if error_of(future) is None:
                reason = self._catalogue.label("point_refusal_t", int(numbers(future.result())[0]))
                self._warn(f"the board has refused points of a trajectory: {reason}")

        self._context.when_done(self._context.read("point_refusal"), log)

    def _on_applied(self, command: AppliedCommand) -> None:
        self.publications.applied(command)
        if command.variable == "cmd.points":
            self.streamer.arrived(periods_ahead(command.raw, command.tick) * PERIOD)

    def _position_moved(self, axis: int) -> None:
        """The position of an axis has another reference: earlier set-points of a stream have another meaning."""
        self.telemetry.restart_position(axis)
        self.arbiter.release_axis(axis, f"the position of {self._joints[axis]} was set")

    def _features(self) -> list[int] | None:
        values = self.parameters.values
        return None if values is None else list(values["param.features"])

    def _check_path(self, path: Path) -> None:
        limits = self.path_limits()
        if limits is not None:
            require(path, [limits[self._joints.index(joint)] for joint in path.joints])

    def _plan_aside(self, work: Callable[[], T], done: Callable[[Future[T]], None]) -> None:
        """Plan in the thread of the planner."""
        self._context.when_done(self._planner.submit(work), done)

    def _point_line(self) -> PointLine:
        """The line to the board, with the measured delay of its exchanges."""
        baud, size = self.settings.baud, self._link.layout.size
        delay = max(self._link.statistics().round_trip_p50 - (size + SAMPLE_BYTES) * 10 / baud, 0.0)
        return point_line(baud, size, delay)

    def _nominal_values_changed(self) -> None:
        """Read again what depends on the configuration: motor data, and parameters with a new default."""
        self.slow.read_motors()
        self.parameters.refresh()

    def _on_motors(self) -> None:
        self.arbiter.set_torque_constants(self.slow.torque_constants)
        self.follower.torque_constants = self.slow.torque_constants
        self.publish_description()

    def _on_parameters(self, values: RawParameters) -> None:
        self.publications.parameters(values, self._catalogue)
        self.pace_keep_alive()

    def _on_fault_record(self, record: FaultRecord) -> None:
        self._error(f"{self._joints[record.axis]}: first fault {record.summary()}")
        self.publications.fault_record(record)

    def _info(self, text: str) -> None:
        self._log.info(text)

    def _warn(self, text: str) -> None:
        self._log.warning(text)

    def _error(self, text: str) -> None:
        self._log.error(text)
