"""A board on a serial port as topics and services of a node, from configure to cleanup.

`Assembly` has the parts; this module tells them of connections, samples and their loss. It does not access the port;
all its code runs in the thread of the executor.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.convert import diagnostic_array
from servo_msgs_py.runtime.node_shell import full_name
from servo_msgs_py.runtime.notify import notify

from servo_bridge.assembly import Assembly
from servo_bridge.board_link import BoardLink, LinkFactory
from servo_bridge.callback_watch import HANG, CallbackWatch
from servo_bridge.freemaster.client import password_of_environment
from servo_bridge.health import Health
from servo_bridge.inbox import Inbox
from servo_bridge.outcome import Outcome
from servo_bridge.parameters import ParameterError, Settings
from servo_bridge.runs.message_tap import MessageTap
from servo_bridge.set_points import Rejected
from servo_bridge.telemetry import Snapshot
from servo_bridge.wire.link import FinalWrite, LinkConfig, LinkState, LinkStatus, Sample
from servo_msgs_py import topics

_SECOND: Final = 1.0  # period of /diagnostics and of slow readings [s]
_TIMER_STOPPED: Final = 1.5
"""Time after which the samples replace the timer of this period: when the system clock is set back, the timers of a ROS
built for an old C library stop until the clock reaches its former time again [s]."""
_SIGN_OF_LIFE: Final = 0.1  # period of the timer that shows that the executor runs [s]
_BACKLOG_NS: Final = 100_000_000
"""A sample is part of a backlog if the newest one that waits is later by more [ns]."""

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
    tap : MessageTap
        Of the messages of the node.

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
        tap: MessageTap,
    ) -> None:
        self._node = node
        self._watch = watch
        self._log = node.get_logger()
        self._catalogue = catalogue
        self._joints = settings.names
        self._inbox = Inbox(call_soon, watch.call)
        self._link = self._make_link(settings, link_factory)
        self.parts = Assembly(node, catalogue, settings, self._link, self._inbox.post, watch, tap)
        self._inactive = f"the bridge is inactive; activate it first (ros2 lifecycle set /{full_name(node)} activate)"
        self.parts.arbiter.inactive = self._inactive
        self._diagnostics = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, 10)
        self._health = Health(catalogue, full_name(node), settings.port, settings.joints)
        self._status = LinkStatus(LinkState.DISCONNECTED, "starting")
        self._snapshot: Snapshot | None = None
        self._arrived: Sample | None = None  # the newest one, which may still wait in the inbox
        self._ended = False
        self._second = time.monotonic()  # of the last `_every_second` [s]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        watch.begin()
        node.create_timer(_SIGN_OF_LIFE, watch.sign_of_life, clock=steady)
        node.create_timer(_SECOND, self._every_second, clock=steady)
        self._publish_state()
        self._link.start()

    def _make_link(self, settings: Settings, factory: LinkFactory) -> BoardLink:
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
                on_sample=self._arrives,
                on_state=lambda status: self._inbox.post(partial(self._on_link, status)),
                hang=self._watch.hang,
            )
        except ValueError as error:
            raise ParameterError(f"parameter telemetry: {error}") from None

    # ---- lifecycle and parameters
    def activate(self) -> None:
        """Permit ``enable`` to release set-points; the axes stay disabled."""
        self.parts.arbiter.inactive = ""

    def deactivate(self) -> None:
        """Block set-points and stop the axes; telemetry continues."""
        self.parts.arbiter.inactive = self._inactive

        def stopped(stop: Future[Outcome]) -> None:
            success, message = stop.result()
            if not success and not self._ended:  # close() switches off
                self._log.warning(f"quick stop failed: {message}")

        self.parts.motion.quick_stop("stopped because the bridge was deactivated").add_done_callback(stopped)
        self._publish_state()

    def refuse_settings(self, settings: Settings) -> str:
        """Return a reason to refuse new settings; empty if they can be applied."""
        problem = self.parts.parameters.check(settings.board_parameters)
        return f"parameter board_parameters: {problem}" if problem else ""

    def settings_changed(self, settings: Settings) -> None:
        """Apply new settings."""
        self.parts.apply(settings)

    def reject(self, topic: str, reason: str) -> None:
        """Count and log a message that cannot be taken."""
        self.parts.commands.reject(topic, Rejected(f"{topic}: {reason}"))

    # ---- callbacks of the link
    def _on_link(self, status: LinkStatus) -> None:
        if status.state is LinkState.CONNECTED:
            self._log.info(str(status))
            notify(status.reason, ready=True)
            self._status = status
            for part in self.parts.order:
                part.connected()
            return  # the first sample follows immediately
        if status.state is LinkState.CONNECTING:
            self._log.info(str(status))
        else:
            self._log.error(str(status))
        self._lose(status)

    def _lose(self, status: LinkStatus) -> None:
        """No board is connected from now on."""
        self._status = status
        self._snapshot = None
        for part in self.parts.order:
            part.lost(status.reason)
        self._publish_state()

    def _arrives(self, sample: Sample) -> None:
        """Take a sample in the thread of the link."""
        self._arrived = sample
        self._inbox.post(partial(self._on_sample, sample))

    def _on_sample(self, sample: Sample) -> None:
        if self._status.state is not LinkState.CONNECTED:
            return  # sent before the loss of the link
        parts, newest = self.parts, self._arrived or sample
        backlog = newest.response_ns - sample.response_ns > _BACKLOG_NS
        snapshot = parts.homing.completed(parts.telemetry.snapshot(sample, parts.clocks.stamp(sample), backlog=backlog))
        self._snapshot = snapshot
        for part in parts.order:
            part.on_sample(snapshot)
        self._publish_state()
        if time.monotonic() - self._second > _TIMER_STOPPED:
            self._every_second()

    # ---- publications
    def _publish_state(self) -> None:
        parts, snapshot = self.parts, self._snapshot
        if self._status.state is not LinkState.CONNECTED:
            parts.publications.disconnected(str(self._status))
        elif snapshot is not None:
            text = " ".join(f"{joint}={axis.label}" for joint, axis in zip(self._joints, snapshot.axes, strict=True))
            parts.publications.state(text, armed=parts.arbiter.armed)

    def _every_second(self) -> None:
        if self._ended:
            return  # the timer was already due at the end
        self._second = time.monotonic()
        parts, health, snapshot = self.parts, self._health, self._snapshot
        callbacks = self._watch.report()
        if callbacks.pause_last > HANG:
            pause, longest = callbacks.pause_last, callbacks.last
            self._log.warning(f"the executor gave no sign of life for {pause:.1f} s; longest: {longest}")
        parts.clocks.refresh()
        parts.run_info.refresh()
        parts.run.look()
        parts.commands.report_repetitions()
        statuses = [
            health.link(self._status, self._link.statistics(), parts.settings.baud, self._link.low_latency.text),
            health.board(self._link.board, snapshot, parts.slow.counters),
            *(
                health.axis(axis, snapshot, parts.fault_records.records[axis], parts.slow.conditions[axis], limit)
                for axis, limit in enumerate(self._current_limits())
            ),
            health.commands(
                parts.commands.figures,
                armed=parts.arbiter.armed,
                conflict=parts.commands.conflict(),
                inactive=parts.arbiter.inactive,
            ),
            health.stream(parts.streamer.report),
            health.parameters(parts.parameters.values, parts.parameters.trouble),
            health.storage(parts.storage.storage),
            health.run_recording(parts.run.report),
            health.executor(callbacks),
        ]
        self._diagnostics.publish(diagnostic_array(self._node.get_clock().now().nanoseconds, statuses))
        if self._status.state is LinkState.CONNECTED:
            parts.slow.read_counters()

    def _current_limits(self) -> list[float | None]:
        """Current limits of the axes [A]; None until they have been read."""
        values, name = self.parts.parameters.values, "param.i_q_limit"
        if values is None:
            return [None] * AXES
        return [raw * self._catalogue[name].lsb for raw in values[name]]

    # ---- end
    def close(self, reason: str) -> None:
        """Switch both axes off, close the port and publish the state; takes a few seconds at most.

        Topics, services and timers are destroyed by the owner of the node.
        """
        self._ended = True
        connected = self._status.state is LinkState.CONNECTED
        self._inbox.close()
        switched_off = self._link.close(_SWITCH_OFF)
        if connected and not switched_off:
            self._log.warning(
                "the board did not confirm the disable command; after param.host_timeout it stops the axes"
            )
        self._lose(LinkStatus(LinkState.DISCONNECTED, reason))
        self.parts.close()
