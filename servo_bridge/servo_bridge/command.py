"""``servo-command``: send one command to the servo over ROS; a replacement for the ros2 command line.

servo-command enable
servo-command position axis1=6.28 axis2=-6.28
servo-command velocity axis1=50 --for 2
servo-command move axis1=31.4 axis2=-31.4 --time 2
servo-command follow path.csv
servo-command sine axis1 --amplitude 1 --frequency 2 --for 10
servo-command home axis1 --method stop-negative
servo-command zero axis1 0.5
servo-command quick_stop
servo-command state
servo-command set 'param.features[0]=ANTI_WINDUP+POSITION_LIMITS' param.i_q_limit=1.0,1.5
servo-command get param.features
"""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown
from sensor_msgs.msg import JointState
from servo_msgs_py.board_parameters import Assignment, RawParameters, applied, find, merged, parameters, parse, si
from servo_msgs_py.catalogue import Catalogue, Variable
from servo_msgs_py.convert import parameters_from_message
from servo_msgs_py.joints import Joint
from servo_msgs_py.robot_description import Motor, joints_of, motors_of
from servo_msgs_py.runtime.qos import command_qos, latched_qos, telemetry_qos
from servo_msgs_py.value_text import value_text
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from servo_bridge.command_paths import PATH_VERBS, add_path_verbs, run_path
from servo_bridge.homing import METHODS
from servo_bridge.trajectory.errors import TrajectoryError
from servo_msgs_py import argument, topics

_STEP: Final = 0.02  # [s]
_MATCH: Final = 0.3  # time until a new subscription is matched [s]
_REPEAT: Final = 0.05  # period of velocity and effort set-points, which expire otherwise [s]
_QUANTITIES: Final = ("position", "velocity", "effort")
_BRIDGE: Final = "servo_bridge"  # name of the bridge node
_LIST: Final = "board_parameters"  # parameter of the bridge
_LOST: Final = "DISCONNECTED"  # first word of the state without a board
_DIAGNOSTICS: Final = 2.5  # timeout; the period is 1 s [s]
_HOME_POSITIONS: Final = "home_positions"  # parameter of the bridge
_HOMING: Final = 600.0  # timeout of a homing [s]
_UNITS: Final = {"position": "rad", "velocity": "rad/s", "effort": "N m"}


class CommandError(RuntimeError):
    """The command had no effect; the text has the reason and a remedy."""


class Commander(Node):
    """Client of one servo.

    Parameters
    ----------
    executor : EventsExecutor
        Runs this node; spun by `wait_for` and `spin_for` only.
    namespace : str
        Namespace of the bridge.
    timeout : float
        Timeout of responses [s].
    interrupted : threading.Event
        Set by a signal handler. Waiting functions then raise `KeyboardInterrupt` and clear the event, so that the
        motion can still be stopped.
    """

    def __init__(self, executor: EventsExecutor, namespace: str, timeout: float, interrupted: threading.Event) -> None:
        super().__init__("servo_command")
        self._interrupted = interrupted
        self._log_lines: list[str] | None = None
        self._path_log: Callable[[str], list[str]] = lambda _: []
        self._matched_publishers: dict[str, Any] = {}
        self._runner = executor
        self._namespace = namespace
        self._timeout = timeout
        self._catalogue = Catalogue.load()
        executor.add_node(self)

    def _of(self, name: str) -> str:
        return f"{self._namespace}/{name}"

    def _part(self, name: str) -> str:
        """Name of a status of the bridge in /diagnostics."""
        return f"{self._of(_BRIDGE).lstrip('/')}: {name}"

    def wait_for(self, condition: Callable[[], Any], failure: str, timeout: float | None = None) -> None:
        """Spin the executor until the condition holds; `timeout` [s], default: that of this client.

        Raises
        ------
        CommandError
            If it does not within the timeout.
        """
        timeout = self._timeout if timeout is None else timeout
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline:
                raise CommandError(
                    f"{failure} within {timeout:g} s; check that the bridge runs in the same ROS domain (`make up`)"
                )
            self._spin()

    def _spin(self) -> None:
        if self._interrupted.is_set():
            self._interrupted.clear()
            raise KeyboardInterrupt
        self._runner.spin_once(timeout_sec=_STEP)

    def _call(self, kind: Any, request: Any, name: str) -> Any:
        client = self.create_client(kind, self._of(name))
        self.wait_for(client.service_is_ready, f"no service {self._of(name)} was found")
        future = client.call_async(request)
        self.wait_for(future.done, f"{self._of(name)} did not answer")
        return future.result()

    def _call_checked(self, kind: Any, request: Any, name: str, action: str) -> str:
        """Call a service and check its success."""
        response = self._call(kind, request, name)
        if not response.success:
            raise CommandError(f"{action} was refused: {response.message}")
        return str(response.message)

    def enable(self, on: bool) -> str:
        """Enable or disable both axes; returns the message of the service."""
        return self._call_checked(SetBool, SetBool.Request(data=on), topics.ENABLE, "enable" if on else "disable")

    def trigger(self, name: str) -> str:
        """Call ``quick_stop`` or ``clear_faults``."""
        return self._call_checked(Trigger, Trigger.Request(), name, name)

    def home(self, joint: str, method: str, position: float | None) -> str:
        """Home a joint, or set its present position, to `position` [rad]; None: parameter `home_positions`.

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
        name = topics.home_service(joint, method)
        client = self.create_client(Trigger, self._of(name))
        self.wait_for(client.service_is_ready, f"no service {self._of(name)} was found")
        future = client.call_async(Trigger.Request())
        self.wait_for(future.done, f"{self._of(name)} did not answer", _HOMING)
        response = future.result()
        assert response is not None
        if not response.success:
            raise CommandError(response.message)
        return str(response.message)

    def _set_home_position(self, axis: int, position: float) -> None:
        bridge = f"{_BRIDGE}/"
        request = GetParameters.Request(names=[_HOME_POSITIONS])
        values = list(self._call(GetParameters, request, bridge + "get_parameters").values[0].double_array_value)
        values[axis] = position
        parameter = Parameter(_HOME_POSITIONS, value=values).to_parameter_msg()
        answer = self._call(SetParameters, SetParameters.Request(parameters=[parameter]), bridge + "set_parameters")
        if not answer.results[0].successful:
            raise CommandError(answer.results[0].reason)

    def state(self) -> str:
        """Text of the state of the servo and its joints, with faults and limits."""
        joints: list[JointState] = []
        reports: list[DiagnosticArray] = []
        self.create_subscription(JointState, self._of(topics.JOINT_STATES), joints.append, telemetry_qos())
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, reports.append, telemetry_qos())
        state = self._state()
        lines = [state]
        if state.startswith(_LOST):
            return state
        self.wait_for(lambda: joints, f"no {self._of(topics.JOINT_STATES)} were received")
        last = joints[-1]
        names = [self._part(name) for name in last.name]
        with contextlib.suppress(CommandError):  # print the rest if there are no diagnostics
            self.wait_for(lambda: _statuses(reports).keys() >= set(names), "no diagnostics", _DIAGNOSTICS)
        statuses = _statuses(reports)
        for name, position, velocity in zip(last.name, last.position, last.velocity, strict=True):
            lines.append(f"  {name}: {position:.4f} rad, {velocity:.3f} rad/s")
            values = _values(statuses.get(self._part(name)))
            if "home state" in values:
                lines[-1] += f", position {values['home state']}"
            for key, heading in (("faults", "fault"), ("first fault", "first fault"), ("limits", "at limit")):
                if values.get(key, "none") != "none":
                    lines.append(f"    {heading} {values[key]}")
            remaining = values.get("current limit left [%]", "100")
            if remaining != "100":
                lines.append(
                    f"    winding at {values['winding [deg C]']} deg C: current limit derated to {remaining} %"
                )
        board = statuses.get(self._part("parameters"))
        if board is not None and board.level != DiagnosticStatus.OK:
            lines.append(f"  parameters: {board.message}")
        return "\n".join(lines)

    def _state(self) -> str:
        return self._latched(topics.STATE)

    def _latched(self, name: str) -> str:
        """Text of a latched topic."""
        texts: list[str] = []
        self.create_subscription(String, self._of(name), lambda m: texts.append(m.data), latched_qos())
        self.wait_for(lambda: texts, f"no {self._of(name)} was received")
        return texts[-1]

    # ---- parameters of the board
    def parameters(self, accepted: Callable[[RawParameters], bool] = lambda _: True) -> RawParameters:
        """Raw parameters of the board, when `accepted` returns true for them.

        Raises
        ------
        CommandError
            After the timeout, or if there is no board.
        """
        state = self._state()
        if state.startswith(_LOST):
            raise CommandError(f"the board is not connected: {state}")
        received: list[RawParameters] = []

        def take(message: Float64MultiArray) -> None:
            received.append(parameters_from_message(message, self._catalogue))

        topic = self._of(topics.PARAMETERS)
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
        bridge = f"{_BRIDGE}/"
        request = GetParameters.Request(names=[_LIST])
        before = self._call(GetParameters, request, bridge + "get_parameters").values[0].string_array_value
        known = [parse(text, self._catalogue) for text in before if text]
        texts = [assignment.text for assignment in merged(known, assignments)]
        parameter = Parameter(_LIST, value=texts).to_parameter_msg()
        answer = self._call(SetParameters, SetParameters.Request(parameters=[parameter]), bridge + "set_parameters")
        (result,) = answer.results
        if not result.successful:
            raise CommandError(f"set was refused: {result.reason.removeprefix(f'parameter {_LIST}: ')}")
        if self._state().startswith(_LOST):
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

    def set_points(self, quantity: str, targets: dict[str, float], duration: float) -> None:
        """Publish set-points by joint name; repeated for `duration` [s] if it is not 0.

        Raises
        ------
        CommandError
            If the bridge rejects them, or does not report their effect within the timeout.
        """
        applied: list[Float64MultiArray] = []
        log = self._bridge_log()
        self.create_subscription(Float64MultiArray, self._of(topics.COMMANDS_APPLIED), applied.append, telemetry_qos())
        publisher = self._publisher(JointState, topics.JOINT_COMMANDS)
        message = JointState(name=list(targets))
        setattr(message, quantity, list(targets.values()))
        end = time.monotonic() + duration
        while True:
            publisher.publish(message)
            pause = time.monotonic() + _REPEAT
            while time.monotonic() < min(pause, end):
                self._spin()
            if log("rejected") or time.monotonic() >= end:
                break
        self.wait_for(lambda: applied or log("rejected"), "no response of the bridge to the set-points")
        if log("rejected"):
            raise CommandError(log("rejected")[0])

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
            raise CommandError(f"{self._of(topics.ROBOT_DESCRIPTION)}: {error}") from None

    def positions(self) -> dict[str, float]:
        """Positions of the joints [rad], by name."""
        received: list[JointState] = []
        topic = self._of(topics.JOINT_STATES)
        subscription = self.create_subscription(JointState, topic, received.append, telemetry_qos())
        self.wait_for(lambda: received, f"no {topic} were received")
        self.destroy_subscription(subscription)
        return dict(zip(received[-1].name, received[-1].position, strict=True))

    def send_path(self, message: JointTrajectory) -> None:
        """Publish a trajectory and wait until the bridge follows it.

        Raises
        ------
        CommandError
            If the bridge rejects it, or does not respond within the timeout.
        """
        log = self._bridge_log()
        self._publisher(JointTrajectory, topics.JOINT_TRAJECTORY).publish(message)
        self.wait_for(
            lambda: log("following a trajectory" if len(message.points) else "stopping ") or log("rejected"),
            "no response of the bridge to the trajectory",
        )
        if log("rejected"):
            raise CommandError(log("rejected")[0])
        self._path_log = log

    def path_starts(self) -> int:
        """How often the bridge has begun the last trajectory: again if its first points came too late."""
        return len(self._path_log("following a trajectory"))

    def path_refusal(self) -> str:
        """Message of the bridge about points of the last trajectory that the board refused; empty if there are none."""
        return next(iter(self._path_log("the board has refused points")), "")

    def spin_for(self, seconds: float) -> None:
        """Spin the executor for a time [s]."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._spin()

    def _bridge_log(self) -> Callable[[str], list[str]]:
        """Subscribe to the log of the bridge; the result returns the new lines that begin with a text."""
        if self._log_lines is None:
            self._log_lines = []
            self.create_subscription(Log, "/rosout", self._on_log, telemetry_qos())
        lines = self._log_lines
        first = len(lines)
        return lambda beginning: [line for line in lines[first:] if line.startswith(beginning)]

    def _on_log(self, message: Log) -> None:
        if self._log_lines is not None and message.name == self._of(_BRIDGE).strip("/").replace("/", "."):
            self._log_lines.append(message.msg)

    def _publisher(self, kind: Any, name: str) -> Any:
        """Publisher that is matched with the bridge; the log of the bridge is matched, too."""
        if name in self._matched_publishers:
            return self._matched_publishers[name]
        topic = self._of(name)
        publisher = self._matched_publishers[name] = self.create_publisher(kind, topic, command_qos())
        self.wait_for(publisher.get_subscription_count, f"no subscriber on {topic}")
        self.wait_for(lambda: self.count_publishers("/rosout") > 1, "the log of the bridge was not found")
        self.spin_for(_MATCH)  # messages published before the subscriptions are matched would be lost
        return publisher

    def close(self) -> None:
        """Destroy the node."""
        self._runner.remove_node(self)
        self.destroy_node()


def _statuses(reports: Sequence[DiagnosticArray]) -> dict[str, DiagnosticStatus]:
    """Newest status of each name."""
    return {status.name: status for report in reports for status in report.status}


def _values(status: DiagnosticStatus | None) -> dict[str, str]:
    return {} if status is None else {pair.key: pair.value for pair in status.values}


def _target(text: str) -> tuple[str, float]:
    joint, separator, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        joint = ""
    if not (joint and separator):
        raise argparse.ArgumentTypeError(f"{text!r}: write JOINT=VALUE, for example axis1=6.28")
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r}: {value} is not a finite number")
    return joint, number


def _assignment(text: str) -> Assignment:
    try:
        return parse(text, Catalogue.load())
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parameter(text: str) -> tuple[Variable, int | None]:
    try:
        return find(text, Catalogue.load())
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="servo-command", description="Send one command to the servo over ROS.")
    parser.add_argument("--namespace", default="/servo", help="namespace of the bridge (default: %(default)s)")
    parser.add_argument("--wait", type=float, default=10.0, metavar="S", help="time to wait (default: %(default)s)")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    for verb, text in (
        ("enable", "enable both axes (rotor search, then position hold)"),
        ("disable", "stop with a ramp, then switch the outputs off"),
        (
            topics.QUICK_STOP,
            "stop as param.on_quick_stop says, by default at the acceleration limit, and hold; enable to continue",
        ),
        (topics.CLEAR_FAULTS, "clear the faults whose cause is gone"),
        ("state", "print state, positions, speeds, faults with remedy, active limits"),
    ):
        verbs.add_parser(verb, help=text)
    homer = verbs.add_parser("home", help="home a joint to a hard stop or a home switch (the joint moves)")
    homer.add_argument("joint", metavar="JOINT")
    homer.add_argument(
        "--method", required=True, choices=[name.replace("_", "-") for name in METHODS if name != "here"]
    )
    homer.add_argument(
        "--position",
        type=argument.finite,
        metavar="RAD",
        help="position of the joint at the reference; stored in parameter home_positions of the bridge (default)",
    )
    zero = verbs.add_parser("zero", help="set the present position of a joint")
    zero.add_argument("joint", metavar="JOINT")
    zero.add_argument("position", nargs="?", type=argument.finite, default=0.0, metavar="RAD", help="default: 0")
    setter = verbs.add_parser("set", help="set parameters of the board; the bridge repeats this after a reconnection")
    setter.add_argument(
        "assignments",
        nargs="+",
        type=_assignment,
        metavar="NAME=VALUE",
        help="such as 'param.features[0]=ANTI_WINDUP+POSITION_LIMITS' or param.i_q_limit=1.0,1.5",
    )
    getter = verbs.add_parser("get", help="print parameters of the board")
    getter.add_argument("names", nargs="*", type=_parameter, metavar="NAME", help="default: all")
    for quantity in _QUANTITIES:
        verb_parser = verbs.add_parser(quantity, help=f"set-points [{_UNITS[quantity]}] of one or both joints")
        verb_parser.add_argument("targets", nargs="+", type=_target, metavar="JOINT=VALUE")
        if quantity == "position":
            verb_parser.set_defaults(duration=0.0)
        else:
            verb_parser.add_argument(
                "--for",
                dest="duration",
                type=argument.not_negative,
                default=1.0,
                metavar="S",
                help="time for which they are repeated (default: 1)",
            )
    add_path_verbs(verbs, _target)
    return parser


def _perform(commander: Commander, args: argparse.Namespace) -> str:
    if args.verb in _QUANTITIES:
        commander.set_points(args.verb, dict(args.targets), args.duration)
        return "took effect"
    if args.verb in PATH_VERBS:
        return run_path(commander, args)
    if args.verb == "state":
        return commander.state()
    if args.verb == "set":
        return commander.set(args.assignments)
    if args.verb == "home":
        return commander.home(args.joint, args.method.replace("-", "_"), args.position)
    if args.verb == "zero":
        return commander.home(args.joint, "here", args.position)
    if args.verb == "get":
        return commander.get(args.names)
    if args.verb in ("enable", "disable"):
        return commander.enable(args.verb == "enable")
    return commander.trigger(args.verb)


def main(args: Sequence[str] | None = None) -> int:
    """Run the program.

    Returns
    -------
    int
        0: the command was accepted; 1: it was refused, or there was no response; 2: wrong arguments; 130: Ctrl-C or
        SIGTERM.
    """
    argv = list(sys.argv if args is None else ["servo-command", *args])
    parser = _parser()
    arguments = parser.parse_args(remove_ros_args(argv)[1:])
    joints = [joint for joint, _ in getattr(arguments, "targets", [])]
    twice = next((joint for joint in joints if joints.count(joint) > 1), None)
    if twice is not None:
        parser.error(f"{twice} is given twice")
    commander: Commander | None = None
    interrupted = threading.Event()
    try:
        # After Ctrl-C the motion must still be stopped, so the context has to stay valid. An exception raised in a
        # signal handler would not pass through the executor unchanged.
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: interrupted.set())
        commander = Commander(EventsExecutor(), arguments.namespace.rstrip("/"), arguments.wait, interrupted)
        print(_perform(commander, arguments))
        return 0
    except (CommandError, NameValidationException, RuntimeError, TrajectoryError) as error:
        print(f"servo-command: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 130
    finally:
        if commander is not None:
            commander.close()
        try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
