"""Topics with the telemetry of the board."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import (
    AppliedCommand,
    applied_message,
    joint_state_from_values,
    parameters_message,
    snapshot_message,
    trace_message,
)
from servo_msgs_py.fault_record import FaultRecord
from servo_msgs_py.joints import Joint
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.units import PERIOD_NS
from std_msgs.msg import Bool, Float64MultiArray, Int64MultiArray, String

from servo_bridge.homing import Homing
from servo_bridge.part import Part
from servo_bridge.telemetry import Snapshot
from servo_msgs_py import topics

_ROWS_MAX: Final = 500
"""Samples in one snapshot message, above 0.1 MB."""


class Publications(Part):
    """Publishers of telemetry, state and applied commands.

    Parameters
    ----------
    node : Node
        Owner.
    joints : sequence of Joint
        In the order of the axes.
    names : sequence of str
        Columns of a snapshot.
    homing : Homing
        State of the positions.
    torque_constants : callable
        Of the motors, by axis [N m/A]; empty: not known, efforts are omitted.
    joint_states_rate : float
        Largest rate of joint_states [Hz]; 0: every sample.
    snapshot_period : float
        Shortest time between two snapshot messages [s].
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[Joint],
        names: Sequence[str],
        homing: Homing,
        torque_constants: Callable[[], Sequence[float]],
        *,
        joint_states_rate: float,
        snapshot_period: float,
    ) -> None:
        self._joints = list(joints)
        self._homing = homing
        self._torque_constants = torque_constants
        self._columns = [*names, *topics.STAMP_COLUMNS]
        self._joint_ticks = round(1e9 / joint_states_rate / PERIOD_NS) if joint_states_rate > 0.0 else 0
        self._snapshot_ticks = round(snapshot_period * 1e9 / PERIOD_NS)
        self._next_joint = self._next_snapshot = 0
        self._epoch = 0
        self._rows: list[list[float]] = []
        self._last_known: list[bool | None] = [None] * len(self._joints)
        self._last_description = ""
        self._last_lost: str | None = None
        self._last_state: str | None = None
        self._last_armed: bool | None = None
        deep, latched = telemetry_qos(), latched_qos()
        self._joint_states = node.create_publisher(JointState, topics.JOINT_STATES, deep)
        self._snapshot = node.create_publisher(Float64MultiArray, topics.SNAPSHOT, deep)
        self._applied = node.create_publisher(Int64MultiArray, topics.COMMANDS_APPLIED, deep)
        self._parameters = node.create_publisher(Float64MultiArray, topics.PARAMETERS, latched)
        self._windings = node.create_publisher(Float64MultiArray, topics.WINDING_TEMPERATURES, latched)
        self._fault_records = [
            node.create_publisher(Float64MultiArray, topics.fault_record_topic(joint.name), latched) for joint in joints
        ]
        self._description = node.create_publisher(String, topics.ROBOT_DESCRIPTION, latched)
        self._known = [
            node.create_publisher(Bool, topics.position_known_topic(joint.name), latched) for joint in joints
        ]
        self._link = node.create_publisher(DiagnosticStatus, topics.LINK, latched)
        self._state = node.create_publisher(String, topics.STATE, latched)
        self._armed = node.create_publisher(Bool, topics.ARMED, latched)

    def on_sample(self, snapshot: Snapshot) -> None:
        """Publish a sample, limited by the rates; no joint_states while the positions have another reference.

        A backlog after a hang of the bridge goes into few large snapshot messages, without a loss, and not into
        joint_states: thousands of messages at once overrun receivers, and a change of `armed` among them is lost.
        """
        self._publish_positions_known()
        if snapshot.epoch != self._epoch:
            self.flush()
            self._epoch = snapshot.epoch
            self._next_joint = self._next_snapshot = 0
        if not snapshot.backlog and not self._homing.restoring and snapshot.tick >= self._next_joint:
            # Step from the last due tick, not from this one, to keep the mean rate.
            self._next_joint = max(self._next_joint + self._joint_ticks, snapshot.tick)
            constants = self._torque_constants() or None
            message = joint_state_from_values(self._joints, snapshot.stamp_ns, snapshot.values, constants)
            self._joint_states.publish(message)
        self._rows.append([*snapshot.values.values(), *divmod(snapshot.stamp_ns, 1_000_000_000)])
        due = snapshot.tick >= self._next_snapshot and not snapshot.backlog
        if due or len(self._rows) >= _ROWS_MAX:
            self._next_snapshot = snapshot.tick + self._snapshot_ticks
            self.flush()

    def lost(self, reason: str) -> None:
        """Publish what is collected, and that no position is known."""
        self.flush()
        self._publish_positions_known()

    def flush(self) -> None:
        """Publish the collected samples in a snapshot message."""
        if self._rows:
            self._snapshot.publish(snapshot_message(self._columns, self._rows))
            self._rows.clear()

    def applied(self, command: AppliedCommand) -> None:
        """Publish an applied write."""
        self._applied.publish(applied_message(command))

    def fault_record(self, record: FaultRecord) -> None:
        """Publish the record of the first fault of an axis."""
        self._fault_records[record.axis].publish(trace_message(record.samples, record.summary()))

    def parameters(self, values: RawParameters, catalogue: Catalogue) -> None:
        """Publish the parameters of the board."""
        self._parameters.publish(parameters_message(values, catalogue))

    def windings(self, temperatures: Sequence[float]) -> None:
        """Publish the temperatures of the windings, in the order of the axes [deg C]."""
        self._windings.publish(Float64MultiArray(data=list(temperatures)))

    def description(self, text: str) -> None:
        """Publish the robot description if it has changed."""
        if text != self._last_description:
            self._last_description = text
            self._description.publish(String(data=text))

    def _publish_positions_known(self) -> None:
        for axis, (now, publisher) in enumerate(zip(self._homing.known, self._known, strict=True)):
            if now != self._last_known[axis]:
                self._last_known[axis] = now
                publisher.publish(Bool(data=now))

    def disconnected(self, reason: str) -> None:
        """Publish that no board is connected, if that or the reason has changed."""
        self._connection(reason, f"DISCONNECTED {reason}", armed=False)

    def state(self, text: str, *, armed: bool) -> None:
        """Publish the state of a connected board and armed, if they have changed."""
        self._connection("", text, armed=armed)

    def _connection(self, lost: str, text: str, *, armed: bool) -> None:
        if armed != self._last_armed:
            self._last_armed = armed
            self._armed.publish(Bool(data=armed))
        if lost != self._last_lost:
            self._last_lost = lost
            level = DiagnosticStatus.ERROR if lost else DiagnosticStatus.OK
            self._link.publish(DiagnosticStatus(level=level, name=topics.LINK, message=lost or "connected"))
        if text != self._last_state:
            self._last_state = text
            self._state.publish(String(data=text))
