"""Connects a board on a serial port to topics and services of a node, from configure to cleanup.

Path of a set-point: `set_point_topics` -> `set_points` (form) -> `arbiter` (limits, states) -> `set_point_queue` ->
`dispatcher` (one write at a time) -> `link` (serial port, own thread) -> firmware. Path of a sample: `link` -> `inbox`
(to the thread of the executor) -> `telemetry` -> `publications`. This module does not access the port; all its code
runs in the thread of the executor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Final, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from servo_msgs_py.board_parameters import RawParameters, applied
from servo_msgs_py.catalogue import AXES, Catalogue, Value, axis_name, numbers
from servo_msgs_py.convert import diagnostic_array
from servo_msgs_py.fault_record import FaultRecord
from servo_msgs_py.robot_description import describe
from servo_msgs_py.runtime.node_shell import full_name
from servo_msgs_py.runtime.notify import notify
from servo_msgs_py.timed_points import periods_ahead
from servo_msgs_py.units import PERIOD_NS, unwrap_u32
from std_srvs.srv import SetBool, Trigger

from servo_bridge.answers import Answers
from servo_bridge.arbiter import Arbiter
from servo_bridge.board_context import BoardContext
from servo_bridge.board_link import BoardLink, LinkFactory
from servo_bridge.bursts.record_service import RecordService
from servo_bridge.bursts.recording import piece_size
from servo_bridge.callback_watch import HANG, CallbackWatch
from servo_bridge.command_context import CommandContext
from servo_bridge.deferred_service import DeferredService
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.fault_records import FaultRecords
from servo_bridge.follow_action import FollowAction, action_interfaces
from servo_bridge.freemaster.client import password_of_environment
from servo_bridge.goals import Goals
from servo_bridge.health import Health, Winding
from servo_bridge.homing import Homing, with_home_states
from servo_bridge.inbox import Inbox
from servo_bridge.joint_commands import JointCommands
from servo_bridge.motion_services import MotionServices
from servo_bridge.outcome import Outcome, error_of
from servo_bridge.parameter_sync import ParameterSync
from servo_bridge.parameters import ParameterError, Settings
from servo_bridge.path_commands import PathCommands
from servo_bridge.publications import Publications
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.set_point_topics import SetPointTopics
from servo_bridge.set_points import Rejected
from servo_bridge.slow_values import SlowValues
from servo_bridge.snapshot_events import SnapshotEvents
from servo_bridge.storage_service import StorageService
from servo_bridge.telemetry import Snapshot, Telemetry
from servo_bridge.trajectory.check import Limits, require
from servo_bridge.trajectory.follower import AxisReport, Follower
from servo_bridge.trajectory.line_capacity import SAMPLE_BYTES, PointLine, point_line
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.streamer import Streamer, stream_lead
from servo_bridge.trajectory.timed_points import PERIOD
from servo_bridge.trajectory_limits import path_limits
from servo_bridge.tuning.service import TuningService
from servo_bridge.variable_topics import VariableTopics
from servo_bridge.wire.board_clock import BoardClock, WallClock
from servo_bridge.wire.keep_alive import keep_alive_period
from servo_bridge.wire.link import FinalWrite, LinkConfig, LinkState, LinkStatus, Sample
from servo_msgs_py import topics

T = TypeVar("T")

_STOP_AT_CONNECTION: Final = CommandWrite(
    "cmd.quick_stop", 0, (1,) * AXES
)  # first write of the link, see wire.stop_at_connection
_URGENT: Final = ("cmd.enable", "cmd.quick_stop", "cmd.clear_faults")
_SIGN_OF_LIFE: Final = 0.1  # period of the timer that shows that the executor runs [s]
_SWITCH_OFF: Final[Sequence[FinalWrite]] = (("cmd.enable", [0.0] * AXES),)


class Supervisor:
    """One board with its topics and services; in the thread of the executor. Initially inactive.

    Parameters
    ----------
    node : Node
        Owner of topics, services and timers.
    catalogue : Catalogue
        Table of variables.
    settings : Settings
        Parameters of the node.
    call_soon : callable
        Schedules a function in the executor; may be called from any thread.
    link_factory : LinkFactory
        Creates the link to the board.
    watch : CallbackWatch
        Of the callbacks of the node.

    Raises
    ------
    ParameterError
        If the link refuses a parameter.
    """

    def __init__(
        self,
        node: Node,
        catalogue: Catalogue,
        settings: Settings,
        call_soon: Callable[[Callable[[], None]], object],
        link_factory: LinkFactory,
        watch: CallbackWatch,
    ) -> None:
        self._node = node
        self._watch = watch
        self._log = node.get_logger()
        self._catalogue = catalogue
        self._settings = settings
        self._inbox = Inbox(call_soon, watch.call)
        self._link = self._make_link(link_factory)
        self._context = BoardContext(
            catalogue, self._link.read, self._link.call, self._inbox.post, self._info, self._warn
        )
        self._joints = settings.names
        self._telemetry = Telemetry(self._catalogue, self._link.layout.variables)
        self._board_clock = BoardClock(minimum_delay_ns=self._link.layout.size * 10 * 1_000_000_000 // settings.baud)
        self._wall = WallClock(lambda: node.get_clock().now().nanoseconds)
        self._arbiter = Arbiter(self._catalogue, settings.joints, limits=self._path_limits)
        self._arbiter.sources.preferred = settings.preferred_source
        self._inactive = f"the bridge is inactive; activate it first (ros2 lifecycle set /{full_name(node)} activate)"
        self._arbiter.inactive = self._inactive
        self._dispatcher = Dispatcher(self._send, self._arbiter.queue, self._warn)
        self._publications = Publications(
            node,
            settings.joints,
            with_home_states(self._telemetry.columns),
            joint_states_rate=settings.joint_states_rate,
            snapshot_period=settings.snapshot_period,
        )
        self._variables = VariableTopics(
            self._context,
            node,
            self._joints,
            [self._catalogue[name] for name in settings.variables],
            self._telemetry.columns,
        )
        self._diagnostics = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, 10)
        self._health = Health(self._catalogue, full_name(node), settings.port, self._joints)
        self._commands = CommandContext(
            node, self._joints, self._arbiter, self._path_limits, self._dispatcher.pump, self._info, self._warn
        )
        self._set_points = SetPointTopics(self._commands)
        self._planner = ThreadPoolExecutor(1, "servo planner")
        self._follower = Follower(
            self._catalogue, settings.joints, self._check_path, work=self._plan_aside, line=self._point_line
        )
        self._arbiter.queue.follow(self._follower)
        self._answers = Answers(node)
        self._goals = Goals(self._commands, self._follower, origin_ns=self._origin_ns, info=self._info)
        self._path_commands = PathCommands(
            self._commands, self._goals, self._answers, settings.goal_defaults, self._warn
        )
        self._action = self._offer_action()
        self._streamer = Streamer(
            settings.joints,
            self._follower,
            stream_lead(settings.baud),
            settings.stream_delay_max or None,
            lambda: point_line(settings.baud, self._link.layout.size, 0.0),  # a delay of the computer passes
        )
        self._joint_commands = JointCommands(
            self._commands,
            self._streamer,
            self._answers,
            interfaces=settings.command_interfaces,
            offset_ns=lambda: self._board_clock.offset_ns,
            wall_ns=self._wall.wall_ns,
        )
        self._status = LinkStatus(LinkState.DISCONNECTED, "starting")
        self._snapshot: Snapshot | None = None
        self._epoch = 0
        self._ended = False
        self._slow = SlowValues(self._context, self._on_motors, self._on_windings)
        self._events = SnapshotEvents(catalogue, self._joints)
        self._parameter_sync = ParameterSync(self._context, self._link.write_raw, self._on_parameters)
        self._parameter_sync.request(settings.board_parameters)
        self._fault_records = FaultRecords(self._context, self._on_fault_record)
        self._motion = MotionServices(self._context, self._joints, self._arbiter, self._dispatcher)
        self._homing = Homing(
            self._context,
            settings.joints,
            settings.home_positions,
            settings.restore_positions,
            self._arbiter,
            self._dispatcher,
            moved=self._position_moved,
        )
        self._records = RecordService(
            self._context,
            node,
            settings.recording,
            piece_size(self._link.layout.size, settings.baud),
            self._times,
        )
        self._tuning = TuningService(
            self._context, node, settings.tuning, take=self._dispatcher.urgent, taken=self._read_nominal_values
        )
        self._storage = StorageService(self._context, node)
        self._offer_services()
        self._start_timers()
        self._publish_description()
        self._publish_state()
        self._link.start()

    # ---- construction
    def _make_link(self, factory: LinkFactory) -> BoardLink:
        settings = self._settings
        config = LinkConfig(
            url=settings.port,
            baud=settings.baud,
            telemetry=settings.telemetry,
            rate=settings.telemetry_rate,
            password=password_of_environment(),
        )
        try:
            return factory(
                config,
                self._catalogue,
                on_sample=lambda sample: self._inbox.post(partial(self._on_sample, sample)),
                on_state=lambda status: self._inbox.post(partial(self._on_link, status)),
                hang=self._watch.hang,
            )
        except ValueError as error:
            raise ParameterError(f"parameter telemetry: {error}") from None

    def _offer_services(self) -> None:
        node, motion = self._node, self._motion
        self._services_offered = [
            DeferredService(node, SetBool, topics.ENABLE, lambda request: motion.enable(request.data)),
            DeferredService(node, Trigger, topics.QUICK_STOP, lambda _: motion.quick_stop()),
            DeferredService(node, Trigger, topics.CLEAR_FAULTS, lambda _: motion.clear_faults()),
            *(self._offer_home(axis, method) for axis in range(AXES) for method in topics.HOME_METHODS),
        ]

    def _offer_home(self, axis: int, method: str) -> DeferredService:
        name = topics.home_service(self._joints[axis], method)
        return DeferredService(self._node, Trigger, name, lambda _: self._homing.home(axis, method))

    def _offer_action(self) -> FollowAction | None:
        interfaces = action_interfaces()
        if interfaces is None:
            self._log.info(
                f"the action {topics.FOLLOW_JOINT_TRAJECTORY} is not offered: control_msgs is not installed (it comes "
                "with ros-jazzy-control-msgs)"
            )
            return None
        return FollowAction(self._commands, interfaces, self._goals, self._settings.goal_defaults, self._watch)

    def _start_timers(self) -> None:
        node, steady = self._node, Clock(clock_type=ClockType.STEADY_TIME)
        self._watch.begin()
        node.create_timer(_SIGN_OF_LIFE, self._watch.sign_of_life, clock=steady)
        self._pace_keep_alive()
        node.create_timer(1.0, self._every_second, clock=steady)
        if self._settings.variables:
            node.create_timer(1.0 / self._settings.variable_rate, self._publish_variables, clock=steady)

    # ---- lifecycle and parameters
    def activate(self) -> None:
        """Permit ``enable`` to release set-points; the axes stay disabled."""
        self._arbiter.inactive = ""

    def deactivate(self) -> None:
        """Block set-points and stop the axes; telemetry continues."""
        self._arbiter.inactive = self._inactive

        def stopped(stop: Future[Outcome]) -> None:
            success, message = stop.result()
            if not success and not self._ended:  # close() switches off
                self._warn(f"quick stop failed: {message}")

        self._motion.quick_stop("stopped because the bridge was deactivated").add_done_callback(stopped)
        self._publish_state()

    def refuse_settings(self, settings: Settings) -> str:
        """Return a reason to refuse new settings; empty if they can be applied."""
        problem = self._parameter_sync.check(settings.board_parameters)
        return f"parameter board_parameters: {problem}" if problem else ""

    def settings_changed(self, settings: Settings) -> None:
        """Apply new settings."""
        if settings.board_parameters != self._settings.board_parameters:
            self._parameter_sync.request(settings.board_parameters)
        self._settings = settings
        self._arbiter.joints = list(settings.joints)
        self._homing.joints, self._homing.positions = list(settings.joints), list(settings.home_positions)
        self._homing.restores = settings.restore_positions
        self._records.request = settings.recording
        self._tuning.path = settings.tuning
        self._arbiter.sources.preferred = settings.preferred_source
        self._publish_description()
        self._pace_keep_alive()

    # ---- commands
    def reject(self, topic: str, reason: str) -> None:
        """Count and log a message that cannot be taken."""
        self._commands.reject(topic, Rejected(f"{topic}: {reason}"))

    def _send(self, write: CommandWrite) -> None:
        """Start a write; its result returns through the inbox, in order with the samples."""

        def done(future: Future[None]) -> None:
            discarded = self._dispatcher.acknowledged(write, error_of(future))
            if discarded and write.variable == "cmd.points":
                self._log_refusal()

        # A stop must not wait for parameters on a slow line; parameters must not wait for a stream of set-points.
        urgent = write.variable in _URGENT
        written = self._link.write_raw(write.variable, write.raw, first=write.first, urgent=urgent)
        self._context.when_done(written, done)

    def _position_moved(self, axis: int) -> None:
        """The position of an axis has another reference: earlier set-points of a stream have another meaning."""
        self._telemetry.restart_position(axis)
        self._arbiter.release_axis(axis, f"the position of {self._joints[axis]} was set")

    def _log_refusal(self) -> None:
        """Log the reason of the board for the refusal of timed points."""

        def log(future: Future[Value]) -> None:
            if error_of(future) is None:
                reason = self._catalogue.label("point_refusal_t", int(numbers(future.result())[0]))
                self._warn(f"the board has refused points of a trajectory: {reason}")

        self._context.when_done(self._context.read("point_refusal"), log)

    def _path_limits(self) -> list[Limits] | None:
        values = self._parameter_sync.values
        if values is None or not self._slow.motors:
            return None
        return path_limits(self._catalogue, values, self._settings.joints, self._slow.motors)

    def _check_path(self, path: Path) -> None:
        limits = self._path_limits()
        if limits is not None:
            require(path, [limits[self._joints.index(joint)] for joint in path.joints])

    def _plan_aside(self, work: Callable[[], T], done: Callable[[Future[T]], None]) -> None:
        """Plan in the thread of the planner."""
        self._context.when_done(self._planner.submit(work), done)

    def _point_line(self) -> PointLine:
        """The line to the board, with the measured delay of its exchanges."""
        baud, size = self._settings.baud, self._link.layout.size
        delay = max(self._link.statistics().round_trip_p50 - (size + SAMPLE_BYTES) * 10 / baud, 0.0)
        return point_line(baud, size, delay)

    def _origin_ns(self) -> int | None:
        offset = self._board_clock.offset_ns
        return None if offset is None else self._wall.wall_ns(round(offset))

    def _times(self, ticks: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Extended ticks of uint32 ticks close to the newest sample, and their ROS times [ns]."""
        snapshot, origin_ns = self._snapshot, self._origin_ns()
        assert snapshot is not None
        assert origin_ns is not None
        extended = np.array([unwrap_u32(tick, snapshot.tick) for tick in ticks.tolist()])
        return extended, origin_ns + extended * PERIOD_NS

    def _pace_keep_alive(self) -> None:
        # Requested parameters may be effective on the board before they are read back.
        known = applied(self._settings.board_parameters, {}), self._parameter_sync.values or {}
        self._link.set_keep_alive_period(keep_alive_period(self._catalogue, *known))

    # ---- callbacks of the link
    def _on_link(self, status: LinkStatus) -> None:
        self._status = status
        if status.state is LinkState.CONNECTED:
            self._log.info(str(status))
            notify(status.reason, ready=True)
            self._dispatcher.open(_STOP_AT_CONNECTION)
            self._read_nominal_values()
            self._tuning.connected()
            self._storage.connected()
        else:
            if status.state is LinkState.CONNECTING:
                self._log.info(str(status))
            else:
                self._log.error(str(status))
            self._publications.flush()
            self._snapshot = None
            self._slow.link_lost()
            self._parameter_sync.link_lost()
            self._variables.link_lost()
            self._arbiter.link_lost(status.reason)
            self._goals.link_lost(f"the link to the board was lost: {status.reason}")
            self._dispatcher.close(status.reason)
            self._motion.link_lost(status.reason)
            self._homing.link_lost(status.reason)
            self._publications.positions_known(self._homing.known)
            self._fault_records.link_lost()
            self._records.link_lost()
            self._storage.link_lost()
        self._publish_state()

    def _on_sample(self, sample: Sample) -> None:
        if self._status.state is not LinkState.CONNECTED:
            return  # sent before the loss of the link
        snapshot = self._homing.completed(self._telemetry.snapshot(sample))
        if snapshot.epoch != self._epoch:
            self._epoch = snapshot.epoch
            self._board_clock.reset()
            self._slow.counters_restarted()
        if self._node.get_clock().ros_time_is_active:
            self._wall.refresh()  # the rate of simulated time may vary
        stamp = self._wall.stamp(self._board_clock.update(snapshot.tick, snapshot.response_ns))
        for text in self._events.faults(self._snapshot, snapshot):
            self._log.error(text)
        if any(snapshot.faults) and (
            text := self._events.host_silent(self._snapshot, snapshot, self._link.statistics().silence)
        ):
            self._log.error(text)
        for text in self._events.expired(self._snapshot, snapshot, self._parameter_sync.values):
            self._warn(text)
        self._fault_records.on_snapshot(snapshot.tick, snapshot.faults)
        self._snapshot = snapshot
        self._arbiter.update_axes(snapshot.axes)
        for text in self._arbiter.stop_at_limits():
            self._warn(text)
        self._follower.on_sample(snapshot.tick, self._axis_reports(snapshot))
        self._joint_commands.advance()
        axes = [(joint, axis_name(axis)) for axis, joint in enumerate(self._settings.joints)]
        self._goals.on_sample(
            snapshot.tick,
            stamp,
            [joint.position(snapshot.values[f"{axis}.position"]) for joint, axis in axes],
            [joint.velocity(snapshot.values[f"{axis}.speed"]) for joint, axis in axes],
        )
        applied = self._dispatcher.on_sample(snapshot.tick, snapshot.applied_tick, snapshot.applied_count)
        self._motion.on_snapshot(snapshot)
        parameters = self._parameter_sync.values
        self._homing.on_snapshot(snapshot, None if parameters is None else parameters["param.features"])
        self._publications.positions_known(self._homing.known)
        if applied is not None:
            # Published before the sample with its effect, so that a twin receives it in time.
            self._publications.applied(applied)
            if applied.variable == "cmd.points":
                self._streamer.arrived(periods_ahead(applied.raw, applied.tick) * PERIOD)
        self._publications.sample(
            snapshot,
            stamp,
            [motor.torque_constant for motor in self._slow.motors] or None,
            joint_states=not self._homing.restoring,
        )
        self._publish_state()

    def _axis_reports(self, snapshot: Snapshot) -> list[AxisReport]:
        lsb = self._catalogue["axis1.position"].lsb
        return [
            AxisReport(
                (status.position if status.position_ref is None else status.position_ref) * lsb,
                follows=status.position_ref is not None and self._arbiter.queue.follows_points(axis),
            )
            for axis, status in enumerate(snapshot.axes)
        ]

    def _on_parameters(self, values: RawParameters) -> None:
        self._publications.parameters(values, self._catalogue)
        self._pace_keep_alive()

    def _on_fault_record(self, record: FaultRecord) -> None:
        self._log.error(f"{self._joints[record.axis]}: {record.summary()}")
        self._publications.fault_record(record)

    def _read_nominal_values(self) -> None:
        """Read values that depend on the configuration: motor data, and parameters with a new default."""
        if self._status.state is not LinkState.CONNECTED:
            return  # read after the reconnection
        self._slow.read_motors()
        self._parameter_sync.connected()

    def _on_motors(self) -> None:
        constants = [motor.torque_constant for motor in self._slow.motors]
        self._arbiter.set_torque_constants(constants)
        self._follower.torque_constants = constants
        self._publish_description()

    def _on_windings(self, windings: Sequence[Winding]) -> None:
        self._publications.windings([winding.temperature for winding in windings])

    def _current_limits(self) -> list[float | None]:
        """Current limits of the axes [A]; None until they have been read."""
        values, name = self._parameter_sync.values, "param.i_q_limit"
        if values is None:
            return [None] * AXES
        return [raw * self._catalogue[name].lsb for raw in values[name]]

    # ---- publications
    def _publish_description(self) -> None:
        resolve = self._node.resolve_topic_name
        text = describe(
            self._settings.joints,
            self._catalogue,
            commands_topic=resolve(topics.JOINT_COMMANDS),
            states_topic=resolve(topics.JOINT_STATES),
            interfaces=self._settings.command_interfaces,
            motors=self._slow.motors,
        )
        self._publications.description(text)

    def _publish_state(self) -> None:
        snapshot = self._snapshot
        if self._status.state is not LinkState.CONNECTED:
            self._publications.lost(str(self._status))
        elif snapshot is not None:  # else the first sample follows immediately
            text = " ".join(f"{joint}={axis.label}" for joint, axis in zip(self._joints, snapshot.axes, strict=True))
            self._publications.state(text, armed=self._arbiter.armed)

    def _publish_variables(self) -> None:
        if self._snapshot is not None:
            self._variables.publish(self._snapshot.values)

    def _every_second(self) -> None:
        if self._ended:
            return  # the timer was already due at the end
        callbacks = self._watch.report()
        if callbacks.pause_last > HANG:
            self._warn(f"the executor gave no sign of life for {callbacks.pause_last:.1f} s; longest: {callbacks.last}")
        self._wall.refresh()
        self._commands.report_repetitions()
        health, snapshot = self._health, self._snapshot
        statuses = [
            health.link(self._status, self._link.statistics(), self._settings.baud, self._link.low_latency.text),
            health.board(self._link.board, snapshot, self._slow.counters),
            *(
                health.axis(axis, snapshot, self._fault_records.records[axis], self._slow.windings[axis], limit)
                for axis, limit in enumerate(self._current_limits())
            ),
            health.commands(
                self._commands.figures,
                armed=self._arbiter.armed,
                conflict=self._commands.conflict(),
                inactive=self._arbiter.inactive,
            ),
            health.stream(self._streamer.report),
            health.parameters(self._parameter_sync.values, self._parameter_sync.trouble),
            health.storage(self._storage.storage),
            health.executor(callbacks),
        ]
        self._diagnostics.publish(diagnostic_array(self._node.get_clock().now().nanoseconds, statuses))
        if self._status.state is LinkState.CONNECTED:
            self._slow.read_counters()

    def _info(self, text: str) -> None:
        self._log.info(text)

    def _warn(self, text: str) -> None:
        self._log.warning(text)

    # ---- end
    def close(self, reason: str) -> None:
        """Switch both axes off, close the port and publish the state; takes a few seconds at most.

        Topics, services and timers are destroyed by the owner of the node.
        """
        self._ended = True
        connected = self._status.state is LinkState.CONNECTED
        self._inbox.close()
        self._tuning.close()
        self._planner.shutdown(wait=False, cancel_futures=True)
        switched_off = self._link.close(_SWITCH_OFF)
        if connected and not switched_off:
            self._warn("the board did not confirm the disable command; after param.host_timeout it stops the axes")
        self._snapshot = None
        self._arbiter.link_lost(reason)
        self._goals.link_lost(reason)
        self._dispatcher.close(reason)
        self._motion.link_lost(reason)
        self._homing.link_lost(reason)
        self._publications.flush()
        self._publications.lost(reason)
