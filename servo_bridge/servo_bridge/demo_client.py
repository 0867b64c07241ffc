"""Client of the servo for the demonstration, over ROS topics and services only."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from servo_msgs_py.convert import AppliedCommand, applied_from_message, from_stamp, snapshot_table, to_stamp
from servo_msgs_py.robot_description import joints_of
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.units import PERIOD_NS
from std_msgs.msg import Float64MultiArray, Int64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from servo_bridge.client import STEP, Client, CommandError, Session
from servo_bridge.command_paths import path_message
from servo_bridge.trajectory.path import Path
from servo_msgs_py import topics

_ANSWER: Final = 5.0  # timeout of a service [s of board time]
_SILENCE: Final = 10.0  # longest time without telemetry [s of this process]


class ServoClient(Client):
    """Sends commands to one servo and records its data.

    Parameters
    ----------
    session : Session
        ROS of this program.
    servo, twin : str
        Namespaces of the bridge and of its twin.
    """

    def __init__(self, session: Session, servo: str, twin: str) -> None:
        super().__init__("servo_demo", session, servo)
        self.joints: list[str] = []
        self.geared: list[str] | None = None  # joints with a gear ratio, direction or offset; None: not known
        self.state = ""  # for people
        self.connected = False  # whether the bridge has a board
        self.columns: list[str] = []
        self.applied: list[AppliedCommand] = []
        self._rows: list[NDArray[np.float64]] = []
        self._residuals: list[tuple[int, list[float]]] = []
        self._residual_topic = f"{twin}/{topics.RESIDUAL}"
        self.twin_state = ""
        deep = telemetry_qos(1000)
        self._names = self.create_subscription(JointState, self.of(topics.JOINT_STATES), self._on_names, deep)
        self.create_subscription(Float64MultiArray, self.of(topics.SNAPSHOT), self._on_snapshot, deep)
        self.create_subscription(Int64MultiArray, self.of(topics.COMMANDS_APPLIED), self._on_applied, deep)
        self.create_subscription(String, self.of(topics.STATE), self._on_state, latched_qos())
        self.create_subscription(DiagnosticStatus, self.of(topics.LINK), self._on_link, latched_qos())
        self.create_subscription(JointState, self._residual_topic, self._on_residual, deep)
        self.create_subscription(String, f"{twin}/{topics.STATE}", self._on_twin_state, latched_qos())
        self._description = self.of(topics.ROBOT_DESCRIPTION)
        self.create_subscription(String, self._description, self._on_description, latched_qos())
        self._ticket = ""  # of the newest command
        self._enable = self.create_client(SetBool, self.of(topics.ENABLE))
        self._quick_stop = self.create_client(Trigger, self.of(topics.QUICK_STOP))

    # ---- waiting
    def wait_for(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until the condition holds or for the timeout; returns whether it holds.

        The timeout counts board time [s]. Without telemetry it counts the turns of this loop, each for `STEP` at most:
        on a slow computer, or one that stops its processes, both last longer than the clock says.

        Raises
        ------
        CommandError
            If the telemetry has ended: the bridge or its board was lost.
        Interrupted
            After a signal; once, so that the axes can be disabled.
        """
        passed = silent = 0.0
        tick = self.tick if self._rows else None
        while not condition():
            if tick is not None and silent >= _SILENCE:
                raise CommandError(f"no telemetry for {_SILENCE:g} s: the bridge or its board was lost")
            if passed >= timeout or (tick is None and silent >= timeout):
                return False
            begin = time.monotonic()
            self.step()
            silent += min(time.monotonic() - begin, STEP)
            before, tick = tick, self.tick if self._rows else None
            if tick != before:
                silent = 0.0
                passed += max(tick - before, 0) * PERIOD_NS * 1e-9 if tick is not None and before is not None else 0.0
        return True

    def missing(self) -> list[str]:
        """Topics and services of the servo that are not there yet."""
        connected = {
            topics.JOINT_STATES: self.joints,
            topics.SNAPSHOT: self._rows,
            topics.STATE: self.state,
            topics.LINK: self.connected,
            topics.ROBOT_DESCRIPTION: self.geared is not None,
            topics.ENABLE: self._enable.service_is_ready(),
            topics.QUICK_STOP: self._quick_stop.service_is_ready(),
        }
        return [*(name for name, there in connected.items() if not there), *self.commands.missing()]

    @property
    def twin_present(self) -> bool:
        """True if a twin publishes residuals."""
        return bool(self.count_publishers(self._residual_topic))

    # ---- commands
    def enable(self, on: bool) -> None:
        """Call ``enable``; raises `CommandError` with the reason if it is refused."""
        self._call(self._enable, SetBool.Request(data=on), topics.ENABLE)

    def quick_stop(self) -> None:
        """Call ``quick_stop``; raises `CommandError` with the reason if it is refused."""
        self._call(self._quick_stop, Trigger.Request(), topics.QUICK_STOP)

    def _call(self, client: Any, request: Any, name: str) -> None:
        future = client.call_async(request)
        if not self.wait_for(future.done, _ANSWER):
            raise CommandError(f"the service {self.of(name)} does not respond; see the log of servo_bridge")
        response = future.result()
        if not response.success:
            raise CommandError(f"the service {self.of(name)} refused: {response.message}")

    def command(self, targets: Mapping[int, float]) -> None:
        """Publish positions [rad] by axis."""
        names = [self.joints[axis] for axis in targets]
        self._ticket = self.commands.publish(JointState(name=names, position=list(targets.values())))

    def follow(self, path: Path, start_ns: int) -> None:
        """Publish a path that begins at the present positions, to be started at a ROS time [ns]."""
        message = path_message(path)
        message.header.stamp = to_stamp(start_ns)
        self._ticket = self.commands.publish(message)

    def check(self) -> None:
        """Raise `CommandError` if the newest command was refused or aborted."""
        self.commands.answer(self._ticket)

    # ---- recordings
    @property
    def tick(self) -> int:
        """Tick of the last sample."""
        return int(self._rows[-1][self.columns.index("tick")])

    def latest(self, column: str) -> float:
        """Last value of a column [SI]."""
        return float(self._rows[-1][self.columns.index(column)])

    def since(self, tick: int, columns: Sequence[str]) -> list[NDArray[np.float64]]:
        """Columns of all samples since `tick` [SI], each of shape (samples,)."""
        index = self.columns.index("tick")
        first = len(self._rows)
        while first and self._rows[first - 1][index] >= tick:
            first -= 1
        chosen = np.array(self._rows[first:]).reshape(-1, len(self.columns))
        return [chosen[:, self.columns.index(name)] for name in columns]

    def stamp_ns(self, tick: int) -> int:
        """ROS time of the first sample since `tick` [ns]."""
        seconds, nanoseconds = self.since(tick, topics.STAMP_COLUMNS)
        return int(seconds[0]) * 1_000_000_000 + int(nanoseconds[0])

    def residuals(self, start_ns: int, end_ns: int) -> NDArray[np.float64]:
        """Position residuals, shape (samples, joints), within a span of ROS time [ns]."""
        chosen = [values for stamp, values in self._residuals if start_ns <= stamp <= end_ns]
        return np.array(chosen, dtype=np.float64).reshape(-1, len(self.joints))

    def residual_after(self, stamp_ns: int) -> bool:
        """True if a residual of this time or later has been received."""
        return bool(self._residuals) and self._residuals[-1][0] >= stamp_ns

    def now_ns(self) -> int:
        """ROS time [ns]."""
        return int(self.get_clock().now().nanoseconds)

    # ---- subscriptions
    def _on_names(self, message: JointState) -> None:
        self.joints = list(message.name)

    def _on_snapshot(self, message: Float64MultiArray) -> None:
        columns, rows = snapshot_table(message)
        if columns != self.columns:
            self.columns = columns
            self._rows.clear()
        self._rows.extend(rows)

    def _on_applied(self, message: Int64MultiArray) -> None:
        self.applied.append(applied_from_message(message))

    def _on_description(self, message: String) -> None:
        try:
            joints = joints_of(message.data)
        except ValueError as error:
            self.get_logger().warning(f"{self._description}: {error}")
            return
        self.geared = [joint.name for joint in joints if (joint.reduction, joint.offset) != (1.0, 0.0)]

    def _on_state(self, message: String) -> None:
        self.state = message.data

    def _on_link(self, message: DiagnosticStatus) -> None:
        self.connected = message.level == DiagnosticStatus.OK

    def _on_twin_state(self, message: String) -> None:
        self.twin_state = message.data

    def _on_residual(self, message: JointState) -> None:
        self._residuals.append((from_stamp(message.header.stamp), list(message.position)))
