"""Client of one servo for ``servo-command``: services, state, parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from servo_msgs_py.board_parameters import Assignment, RawParameters, applied, merged, parameters, parse, si
from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name
from servo_msgs_py.convert import NO_FAULT, parameters_from_message, snapshot_table
from servo_msgs_py.joints import Joint
from servo_msgs_py.robot_description import Motor, joints_of, motors_of
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.value_text import value_text
from std_msgs.msg import Bool, Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from servo_bridge.client import BRIDGE, Client, CommandError, Session
from servo_msgs_py import topics

_LIST: Final = "board_parameters"  # parameter of the bridge
_DIAGNOSTICS: Final = 2.5  # timeout; the period is 1 s [s]
_HOME_POSITIONS: Final = "home_positions"  # parameter of the bridge
_HOMING: Final = 600.0  # timeout of a homing [s]
_ERROR: Final = (DiagnosticStatus.ERROR, DiagnosticStatus.STALE)


class Commander(Client):
    """Client of one servo.

    Parameters
    ----------
    session : Session
        ROS of this program.
    namespace : str
        Namespace of the bridge.
    timeout : float
        Timeout of responses [s].
    """

    def __init__(self, session: Session, namespace: str, timeout: float) -> None:
        super().__init__("servo_command", session, namespace)
        self.timeout = timeout  # of responses [s]
        self._catalogue = Catalogue.load()
        self._armed: list[bool] = []  # whether set-points are accepted, as received
        self._texts: list[str] = []  # states for people, as received
        self._links: list[DiagnosticStatus] = []  # as received

    def _part(self, name: str) -> str:
        """Name of a status of the bridge in /diagnostics."""
        return f"{self.of(BRIDGE).lstrip('/')}: {name}"

    def wait_for(self, condition: Callable[[], object], failure: str, timeout: float | None = None) -> None:
        """Wait until the condition holds; `timeout` [s], default: that of this client.

        Raises
        ------
        CommandError
            If it does not within the timeout.
        """
        timeout = self.timeout if timeout is None else timeout
        if not self.holds(condition, timeout):
            hint = "check that the bridge runs in the same ROS domain (`make up`)"
            if self.undiscovered:
                hint = (
                    "the bridge runs on this computer and in this ROS domain, but ROS does not find it: give both the "
                    "same ROS_AUTOMATIC_DISCOVERY_RANGE and RMW_IMPLEMENTATION, or relieve the computer"
                )
            raise CommandError(f"{failure} within {timeout:g} s; {hint}")

    # ---- services
    def _call(
        self, kind: Any, request: Any, name: str, timeout: float | None = None, check: Callable[[], None] | None = None
    ) -> Any:
        """Response of a service; `check` is called while it is awaited, and may raise an exception."""
        client = self.create_client(kind, self.of(name))
        self.wait_for(client.service_is_ready, f"no service {self.of(name)} was found")
        future = client.call_async(request)

        def answered() -> bool:
            if check is not None:
                check()
            return bool(future.done())

        self.wait_for(answered, f"{self.of(name)} did not answer", timeout)
        return future.result()

    def _call_checked(self, kind: Any, request: Any, name: str, action: str) -> str:
        """Call a service and check its success."""
        response = self._call(kind, request, name)
        if not response.success:
            raise CommandError(f"{action} was refused: {response.message}")
        return str(response.message)

    def enable(self) -> str:
        """Enable the axes in use; wait until set-points are accepted.

        Raises
        ------
        CommandError
            If they are not, with the reason.
        """
        text = self._call_checked(SetBool, SetBool.Request(data=True), topics.ENABLE, "enable")
        self.watch()
        if not self.holds(lambda: self._armed[-1:] == [True], self.timeout):
            raise CommandError(f"set-points are not accepted within {self.timeout:g} s: {self._texts[-1]}; {text}")
        return f"the axes in use are enabled: {self._texts[-1]}"

    def disable(self) -> str:
        """Disable both axes; wait until the outputs are off.

        Raises
        ------
        CommandError
            If they are not, with the reason.
        """
        self._call_checked(SetBool, SetBool.Request(data=False), topics.ENABLE, "disable")
        self.watch()
        newest: dict[str, float] = {}

        def take(message: Float64MultiArray) -> None:
            names, table = snapshot_table(message)
            newest.update(zip(names, table[-1].tolist(), strict=True))

        self.create_subscription(Float64MultiArray, self.of(topics.SNAPSHOT), take, telemetry_qos())
        run = self._catalogue.enums["state_t"]["RUN"]

        def off() -> bool:
            if not self.connected:
                raise CommandError(f"the board was lost before its outputs were off: {self._links[-1].message}")
            return bool(newest) and all(newest[f"{axis_name(axis)}.state"] != run for axis in range(AXES))

        if not self.holds(off, self.timeout):
            raise CommandError(f"the outputs are not off within {self.timeout:g} s: {self._texts[-1]}")
        return "both axes are disabled"

    def trigger(self, name: str) -> str:
        """Call ``quick_stop`` or ``clear_faults``."""
        return self._call_checked(Trigger, Trigger.Request(), name, name)

    def home(self, joint: str, method: str, position: float | None, check: Callable[[], None] | None = None) -> str:
        """Home a joint, or set its present position, to `position` [rad]; None: parameter `home_positions`.

        `check` is called during the homing, and may raise an exception.

        Raises
        ------
        CommandError
            If the joint does not exist, or the bridge or the board refuses, with the reason.
        """
        names = [one.name for one in self.joints()]
        if joint not in names:
            raise CommandError(f"joint {joint} does not exist; the joints are {', '.join(names)}")
        if position is not None:
            self._set_home_position(names.index(joint), position)
        response = self._call(Trigger, Trigger.Request(), topics.home_service(joint, method), _HOMING, check)
        if not response.success:
            raise CommandError(response.message)
        return str(response.message)

    def _set_home_position(self, axis: int, position: float) -> None:
        bridge = f"{BRIDGE}/"
        request = GetParameters.Request(names=[_HOME_POSITIONS])
        values = list(self._call(GetParameters, request, bridge + "get_parameters").values[0].double_array_value)
        values[axis] = position
        parameter = Parameter(_HOME_POSITIONS, value=values).to_parameter_msg()
        answer = self._call(SetParameters, SetParameters.Request(parameters=[parameter]), bridge + "set_parameters")
        if not answer.results[0].successful:
            raise CommandError(answer.results[0].reason)

    # ---- state
    def watch(self) -> None:
        """Receive the state from now on; returns when it is known."""
        if not self._armed:
            self.create_subscription(DiagnosticStatus, self.of(topics.LINK), self._links.append, latched_qos())
            self.create_subscription(Bool, self.of(topics.ARMED), lambda m: self._armed.append(m.data), latched_qos())
            self.create_subscription(String, self.of(topics.STATE), lambda m: self._texts.append(m.data), latched_qos())
        received = self._armed, self._texts, self._links
        self.wait_for(lambda: all(received), f"no {self.of(topics.ARMED)} was received")

    @property
    def connected(self) -> bool:
        """Whether the bridge has a board; after `watch`."""
        return bool(self._links[-1].level == DiagnosticStatus.OK)

    def require_armed(self) -> None:
        """Raise `CommandError` if set-points are not accepted any more; after `watch`."""
        if not self._armed[-1]:
            self.holds(lambda: False, 0.1)  # the state that belongs to it
            raise CommandError(
                f"stopped: set-points are not accepted any more ({self._texts[-1]}); see `servo-command state`"
            )

    def state(self) -> tuple[str, str]:
        """Text of the state of the servo and its joints, with faults and limits; and what is not ready, else empty."""
        joints: list[JointState] = []
        reports: list[DiagnosticArray] = []
        self.create_subscription(JointState, self.of(topics.JOINT_STATES), joints.append, telemetry_qos())
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, reports.append, telemetry_qos())
        self.watch()
        text = self._texts[-1]
        if not self.connected:
            return text, "the board is not connected"
        self.wait_for(lambda: joints, f"no {self.of(topics.JOINT_STATES)} were received")
        last = joints[-1]
        names = [self._part(name) for name in last.name]
        self.holds(lambda: _statuses(reports).keys() >= set(names), _DIAGNOSTICS)  # print the rest without them
        statuses = _statuses(reports)
        lines = [text]
        for name, position, velocity in zip(last.name, last.position, last.velocity, strict=True):
            lines += _joint_lines(name, position, velocity, _values(statuses.get(self._part(name))))
        board = statuses.get(self._part("parameters"))
        if board is not None and board.level != DiagnosticStatus.OK:
            lines.append(f"  parameters: {board.message}")
        return "\n".join(lines), self._trouble(statuses)

    def _trouble(self, statuses: Mapping[str, DiagnosticStatus]) -> str:
        own = {name: status for name, status in statuses.items() if name.startswith(self._part(""))}
        if not own:
            return f"no {topics.DIAGNOSTICS} of the bridge were received"
        reasons = [f"{name}: {status.message}" for name, status in own.items() if status.level in _ERROR]
        if reasons:
            return "; ".join(reasons)
        return "" if self._armed[-1] else "set-points are not accepted (armed is false); call enable"

    def _latched(self, name: str) -> str:
        """Text of a latched topic."""
        texts: list[str] = []
        self.create_subscription(String, self.of(name), lambda m: texts.append(m.data), latched_qos())
        self.wait_for(lambda: texts, f"no {self.of(name)} was received")
        return texts[-1]

    def motors(self) -> list[Motor]:
        """Motors in the order of the axes; empty if the bridge does not have their data."""
        return motors_of(self._latched(topics.ROBOT_DESCRIPTION))

    def joints(self) -> list[Joint]:
        """Joints in the order of the axes.

        Raises
        ------
        CommandError
            If the robot description of the bridge does not have them.
        """
        try:
            return joints_of(self._latched(topics.ROBOT_DESCRIPTION))
        except ValueError as error:
            raise CommandError(f"{self.of(topics.ROBOT_DESCRIPTION)}: {error}") from None

    def positions(self) -> dict[str, float]:
        """Positions of the joints [rad], by name."""
        received: list[JointState] = []
        topic = self.of(topics.JOINT_STATES)
        subscription = self.create_subscription(JointState, topic, received.append, telemetry_qos())
        self.wait_for(lambda: received, f"no {topic} were received")
        self.destroy_subscription(subscription)
        return dict(zip(received[-1].name, received[-1].position, strict=True))

    # ---- parameters of the board
    def parameters(self, accepted: Callable[[RawParameters], bool] = lambda _: True) -> RawParameters:
        """Raw parameters of the board, when `accepted` returns true for them.

        Raises
        ------
        CommandError
            After the timeout, or if there is no board.
        """
        self.watch()
        if not self.connected:
            raise CommandError(f"the board is not connected: {self._links[-1].message}")
        received: list[RawParameters] = []

        def take(message: Float64MultiArray) -> None:
            received.append(parameters_from_message(message, self._catalogue))

        topic = self.of(topics.PARAMETERS)
        self.create_subscription(Float64MultiArray, topic, take, latched_qos())
        self.wait_for(lambda: received, f"no {topic} were received")
        self.wait_for(lambda: accepted(received[-1]), "the parameters were not applied (see /diagnostics)")
        return received[-1]

    def get(self, names: Sequence[tuple[Variable, int | None]]) -> str:
        """Text of parameters of the board; default: all."""
        values = si(self.parameters(), self._catalogue)
        lines = []
        for variable, element in names or [(variable, None) for variable in parameters(self._catalogue)]:
            value = values[variable.name]
            if element is not None and isinstance(value, list):
                value = value[element]
            name = variable.name if element is None else f"{variable.name}[{element}]"
            lines.append(f"{name} = {value_text(variable, value, self._catalogue)}")
        return "\n".join(lines)

    def set(self, assignments: Sequence[Assignment]) -> str:
        """Set parameters of the board through the parameter of the bridge; wait until the board has them.

        Raises
        ------
        CommandError
            If the bridge or the board refuses them, with the reason.
        """
        bridge = f"{BRIDGE}/"
        request = GetParameters.Request(names=[_LIST])
        before = self._call(GetParameters, request, bridge + "get_parameters").values[0].string_array_value
        known = [parse(text, self._catalogue) for text in before if text]
        texts = [assignment.text for assignment in merged(known, assignments)]
        parameter = Parameter(_LIST, value=texts).to_parameter_msg()
        answer = self._call(SetParameters, SetParameters.Request(parameters=[parameter]), bridge + "set_parameters")
        (result,) = answer.results
        if not result.successful:
            raise CommandError(f"set was refused: {result.reason}")
        self.watch()
        if not self.connected:
            return "the board is not connected; the parameters are set after the connection"
        reports: list[DiagnosticArray] = []
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, reports.append, telemetry_qos())
        try:
            self.parameters(lambda present: applied(assignments, present) == present)
        except CommandError:
            board = _statuses(reports).get(self._part("parameters"))
            if board is None or board.level == DiagnosticStatus.OK:
                raise
            raise CommandError(f"set failed: {board.message}") from None
        return self.get([(assignment.variable, assignment.element) for assignment in assignments])


def _joint_lines(name: str, position: float, velocity: float, values: Mapping[str, str]) -> list[str]:
    """Text of one joint; `values` of its status."""
    lines = [f"  {name}: {position:.4f} rad, {velocity:.3f} rad/s"]
    if "home state" in values:
        lines[0] += f", home state {values['home state']}"
    for key, heading in (("faults", "fault"), ("first fault", "first fault"), ("limits", "at limit")):
        if values.get(key, NO_FAULT) != NO_FAULT:
            lines.append(f"    {heading} {values[key]}")
    remaining = values.get("current limit left [%]", "100")
    if float(remaining) < 100.0:
        lines.append(f"    winding at {values['winding [deg C]']} deg C: current limit derated to {remaining} %")
    if float(values.get("oscillation [Hz]", 0.0)):
        lines.append(f"    oscillation at {values['oscillation [Hz]']} Hz since it was enabled")
    return lines


def _statuses(reports: Sequence[DiagnosticArray]) -> dict[str, DiagnosticStatus]:
    """Newest status of each name."""
    return {status.name: status for report in reports for status in report.status}


def _values(status: DiagnosticStatus | None) -> dict[str, str]:
    return {} if status is None else {pair.key: pair.value for pair in status.values}
