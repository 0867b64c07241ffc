"""``servo_viewer``: board and twin in the rerun viewer, as a ROS 2 node.

A thin shell: messages are passed to `Viewer`, whose thread writes them to a file, to a web page on the loopback
interface, or both. Nothing is sent to the board.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import FAULTS, NO_FAULT, applied_from_message, from_stamp, trace_from_message
from servo_msgs_py.joints import joint_names
from servo_msgs_py.rerun_file import RecordingError
from servo_msgs_py.robot_description import joints_of
from servo_msgs_py.runtime.node_shell import destroyed_on_error, run
from servo_msgs_py.runtime.notify import notify
from servo_msgs_py.runtime.parameters import ParameterError, declare, spec
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.trace import Trace
from std_msgs.msg import Bool, Float64MultiArray, Int64MultiArray, String

from servo_msgs_py import topics
from servo_twin.view import scene
from servo_twin.view.recording import Recording
from servo_twin.view.viewer import Change, Viewer
from servo_twin.view.web_page import WebPage, WebPageError, free_port

PARAMETERS: Final = {
    "record": spec("", "file for the recording (.rrd); an existing file is replaced; empty: none"),
    "web": spec(True, "serve the live viewer to a browser on this machine; its address is printed"),
    "grpc_port": spec(9876, "port of the data for the live viewer; the next free one if it is in use", 1024, 65535),
    "web_port": spec(9090, "port of the page of the live viewer; the next free one if it is in use", 1024, 65535),
    "board_namespace": spec(
        "servo", "namespace of the bridge node; without a leading slash relative to the namespace of the viewer"
    ),
    "twin_namespace": spec("twin", "namespace of the twin node, as board_namespace; the twin is optional"),
}
"""Parameters of the node; ``config/servo_viewer.yaml`` is generated from them."""


class ServoViewer(Node):
    """The node.

    Parameters
    ----------
    node_arguments : keyword arguments
        For `rclpy.node.Node`.

    Raises
    ------
    ParameterError
        If a parameter is invalid, or the file or a port cannot be opened.
    """

    finished = False  # runs until it is stopped

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("servo_viewer", **node_arguments)
        with destroyed_on_error(self):
            self._set_up()

    def _set_up(self) -> None:
        self.failure = ""  # reason for the end of the node; empty: none
        self._log = Node.get_logger(self)
        self._values = declare(self, PARAMETERS)
        if not (self._values["record"] or self._values["web"]):
            raise ParameterError("no output: set parameter record to a file, or web to true")
        self._page: WebPage | None = None
        try:
            recording = self._open()
        except (RecordingError, WebPageError) as error:
            raise ParameterError(str(error)) from None
        self._dropped = 0
        self._described = False
        self._viewer = Viewer(recording, Catalogue.load(), self._now())
        self._viewer.start()
        self._subscribe()
        self.create_timer(1.0, self._every_second, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # ---- construction
    def _open(self) -> Recording:
        record = self._values["record"]
        path = Path(record).expanduser().absolute() if record else None
        if not self._values["web"]:
            recording = Recording(path)
        else:
            port = self._port("grpc_port")
            recording = Recording(path, port)
            try:
                self._page = WebPage(self._port("web_port", exclude=port), recording.uri)
            except WebPageError:
                recording.close()
                raise
        outputs = [f"recording to {path}"] if path is not None else []
        if self._page is not None:
            outputs.append(f"viewer on this machine: {self._page.url}")
        print(*outputs, sep="\n", flush=True)
        notify(", ".join(outputs), ready=True)
        return recording

    def _port(self, name: str, exclude: int | None = None) -> int:
        requested: int = self._values[name]
        port = free_port(requested, exclude)
        if port != requested:
            self._log.warning(f"{name} {requested} is in use (another viewer?); using {port}")
        return port

    def _subscribe(self) -> None:
        board, twin = (
            topics.within(self.get_namespace(), self._values[f"{name}_namespace"]) for name in ("board", "twin")
        )
        # Deep queues: rows may be late after a stall; `Viewer` counts the rows that it drops.
        deep, latched = telemetry_qos(500), latched_qos()
        viewer = self._viewer
        for namespace, take in ((board, viewer.board), (twin, viewer.twin)):
            topic = f"{namespace}/{topics.SNAPSHOT}"
            self.create_subscription(Float64MultiArray, topic, partial(self._on_snapshot, topic, take), deep)
        for topic, source in (
            (f"{board}/{topics.RECORDING}", scene.BOARD),
            (f"{twin}/{topics.RECORDING}", scene.TWIN),
            (f"{twin}/{topics.RESIDUAL_RECORDING}", scene.RESIDUAL),
        ):
            self.create_subscription(Float64MultiArray, topic, partial(self._on_recording, topic, source), latched)
        description = f"{board}/{topics.ROBOT_DESCRIPTION}"
        self.create_subscription(String, description, partial(self._on_description, description), latched)
        self.create_subscription(Int64MultiArray, f"{board}/{topics.COMMANDS_APPLIED}", self._on_applied, deep)
        self.create_subscription(JointState, f"{twin}/{topics.RESIDUAL}", self._on_residual, deep)
        self.create_subscription(DiagnosticStatus, f"{board}/{topics.LINK}", self._on_link, latched)
        self.create_subscription(Bool, f"{twin}/{topics.HEALTHY}", self._on_healthy, latched)
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, 50)
        self.create_subscription(DiagnosticArray, f"{twin}/{topics.DIAGNOSIS}", self._on_diagnosis, latched)

    # ---- input
    def _on_snapshot(self, topic: str, take: Callable[[Trace], None], message: Float64MultiArray) -> None:
        samples = self._decoded(topic, message)
        if samples is None:
            return
        if not self._described:  # units unknown
            text = f"{topic} is not shown: joints unknown, no robot_description in the same namespace"
            self._log.warning(text, throttle_duration_sec=10.0, skip_first=True)
            return
        take(samples)

    def _decoded(self, topic: str, message: Float64MultiArray) -> Trace | None:
        """Samples of a message; None and a warning if it is invalid."""
        try:
            return trace_from_message(message)
        except ValueError as error:
            self._log.warning(f"{topic}: {error}", throttle_duration_sec=10.0)
            return None

    def _on_recording(self, topic: str, source: str, message: Float64MultiArray) -> None:
        points = self._decoded(topic, message)
        if points is not None:
            self._viewer.burst(source, points)

    def _on_description(self, topic: str, message: String) -> None:
        try:
            joints = joints_of(message.data)
        except ValueError as error:
            self._log.warning(f"{topic}: {error}")
            return
        if not self._described:
            self._log.info(f"joints: {', '.join(joint_names(joints))}")
        self._described = True
        self._viewer.joints(joints)

    def _on_applied(self, message: Int64MultiArray) -> None:
        try:
            command = applied_from_message(message)
        except ValueError as error:
            self._log.warning(str(error), throttle_duration_sec=10.0)
            return
        self._viewer.applied(command)

    def _on_residual(self, message: JointState) -> None:
        fields = {field: list(getattr(message, field)) for field in scene.RESIDUALS}
        self._viewer.residual(from_stamp(message.header.stamp), fields)

    def _on_link(self, message: DiagnosticStatus) -> None:
        lost = "" if message.level == DiagnosticStatus.OK else message.message
        self._viewer.link(self._now(), lost)

    def _on_healthy(self, message: Bool) -> None:
        self._viewer.healthy(self._now(), message.data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        stamp = from_stamp(message.header.stamp)
        for status in message.status:
            if any(entry.key == FAULTS and entry.value != NO_FAULT for entry in status.values):
                continue  # the telemetry has them
            self._viewer.diagnosis(stamp, status.name, status.level[0], status.message)

    def _on_diagnosis(self, message: DiagnosticArray) -> None:
        found: list[Change] = []
        estimates: dict[tuple[str, str], dict[str, float]] = {}
        for axis, status in enumerate(message.status):  # the joints in order, then the bus
            source = axis_name(axis) if axis < AXES else "bus"
            if status.level != DiagnosticStatus.OK:
                values = {entry.key: entry.value for entry in status.values}
                found.append(Change(source, values.get("kind", ""), values.get("changes", ""), status.message))
            for entry in status.values:
                name, dot, curve = entry.key.partition(".")
                if dot:
                    estimates.setdefault((source, name), {})[curve] = float(entry.value)
        self._viewer.changes(from_stamp(message.header.stamp), found, estimates)

    def _every_second(self) -> None:
        self.failure = self.failure or self._viewer.failure
        dropped = self._viewer.dropped
        if dropped != self._dropped:
            self._log.warning(f"{dropped - self._dropped} messages dropped: the recording is not written fast enough")
            self._dropped = dropped

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    # ---- end
    def shutdown(self) -> None:
        """Write pending data, close recording, page and node; takes a few seconds at most."""
        if not self._viewer.close():
            self._log.error("timeout while closing the recording; `rerun rrd optimize` may repair it")
        self.failure = self.failure or self._viewer.failure
        if self._page is not None:
            self._page.close()
        Node.destroy_node(self)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; returns the exit status."""
    purpose = "Board and twin in the rerun viewer: a recording, a live page in the browser, or both."
    return run("servo_viewer", purpose, PARAMETERS, lambda _: ServoViewer(), args)


if __name__ == "__main__":
    sys.exit(main())
