"""``servo-command``: one command to the servo over ROS topics and services, for machines without the ros2 command.

servo-command enable
servo-command position axis1=6.28 axis2=-6.28
servo-command velocity axis1=50 --for 2
servo-command quick_stop
servo-command state
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import rclpy
from rcl_interfaces.msg import Log
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args, try_shutdown
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from servo_msgs_py import topics

__all__ = ["CommandError", "Commander", "main"]

_STEP: Final = 0.02  # [s]
_MATCH: Final = 0.3  # until a subscription hears what a running node publishes [s]
_REPEAT: Final = 0.1  # between two velocity or effort set-points, which time out on silence [s]
_QUANTITIES: Final = ("position", "velocity", "effort")
_UNITS: Final = {"position": "rad", "velocity": "rad/s", "effort": "N m"}


class CommandError(RuntimeError):
    """The command had no effect; the text says why and what to do."""


class Commander(Node):
    """A user of one servo."""

    def __init__(self, executor: EventsExecutor, namespace: str, patience: float) -> None:
        super().__init__("servo_command")
        self._runner = executor
        self._namespace = namespace
        self._patience = patience
        executor.add_node(self)

    def _of(self, name: str) -> str:
        return f"{self._namespace}/{name}"

    def wait_for(self, condition: Callable[[], Any], what: str) -> None:
        """Turn the executor until the condition holds.

        Raises
        ------
        CommandError
            If it does not within the patience.
        """
        deadline = time.monotonic() + self._patience
        while not condition():
            if time.monotonic() >= deadline:
                raise CommandError(f"{what} within {self._patience:g} s; is `make up` running in the same ROS domain?")
            self._runner.spin_once(timeout_sec=_STEP)

    def _call(self, kind: Any, request: Any, name: str) -> str:
        client = self.create_client(kind, self._of(name))
        self.wait_for(client.service_is_ready, f"no service {self._of(name)} was found")
        future = client.call_async(request)
        self.wait_for(future.done, f"{self._of(name)} did not answer")
        response = future.result()
        if not response.success:
            raise CommandError(f"{name} was refused: {response.message}")
        return str(response.message)

    def enable(self, on: bool) -> str:
        """Enable or disable both axes; returns what the service says."""
        return self._call(SetBool, SetBool.Request(data=on), topics.ENABLE)

    def trigger(self, name: str) -> str:
        """Call ``quick_stop`` or ``clear_faults``."""
        return self._call(Trigger, Trigger.Request(), name)

    def state(self) -> str:
        """State of the servo and its joints now, for people."""
        states: list[str] = []
        joints: list[JointState] = []
        self.create_subscription(String, self._of(topics.STATE), lambda m: states.append(m.data), topics.latched_qos())
        self.create_subscription(JointState, self._of(topics.JOINT_STATES), joints.append, topics.telemetry_qos())
        self.wait_for(lambda: states, f"no {self._of(topics.STATE)} was heard")
        lines = [states[-1]]
        if not states[-1].startswith("DISCONNECTED"):
            self.wait_for(lambda: joints, f"no {self._of(topics.JOINT_STATES)} were heard")
            last = joints[-1]
            lines += [
                f"  {name}: {position:.4f} rad, {velocity:.3f} rad/s"
                for name, position, velocity in zip(last.name, last.position, last.velocity, strict=True)
            ]
        return "\n".join(lines)

    def set_points(self, quantity: str, targets: dict[str, float], duration: float) -> None:
        """Publish set-points by joint name; repeated for `duration` [s] when it is not 0.

        Raises
        ------
        CommandError
            If the bridge rejects them, or does not say within the patience that they took effect.
        """
        applied: list[Float64MultiArray] = []
        rejected: list[str] = []
        self.create_subscription(
            Float64MultiArray, self._of(topics.COMMANDS_APPLIED), applied.append, topics.telemetry_qos()
        )
        self.create_subscription(Log, "/rosout", lambda m: self._notice(m, rejected), topics.telemetry_qos())
        topic = self._of(topics.JOINT_COMMANDS)
        publisher = self.create_publisher(JointState, topic, topics.command_qos())
        self.wait_for(publisher.get_subscription_count, f"nobody listens to {topic}")
        self.wait_for(lambda: self.count_publishers("/rosout") > 1, "the log of the bridge was not found")
        self._settle()
        message = JointState(name=list(targets))
        setattr(message, quantity, list(targets.values()))
        end = time.monotonic() + duration
        while True:
            publisher.publish(message)
            pause = time.monotonic() + _REPEAT
            while time.monotonic() < min(pause, end):
                self._runner.spin_once(timeout_sec=_STEP)
            if rejected or time.monotonic() >= end:
                break
        self.wait_for(lambda: applied or rejected, "the bridge neither took nor rejected the set-points")
        if rejected:
            raise CommandError(rejected[0])

    def _notice(self, message: Log, rejected: list[str]) -> None:
        if message.name.endswith(".servo_bridge") and message.msg.startswith("rejected"):
            rejected.append(message.msg)

    def _settle(self) -> None:
        """Let the new subscriptions be matched: what is published before is not heard."""
        deadline = time.monotonic() + _MATCH
        while time.monotonic() < deadline:
            self._runner.spin_once(timeout_sec=_STEP)

    def close(self) -> None:
        """End the node."""
        self._runner.remove_node(self)
        self.destroy_node()


def _target(text: str) -> tuple[str, float]:
    joint, separator, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not (joint and separator and math.isfinite(number)):
        raise argparse.ArgumentTypeError(f"{text!r}: write JOINT=VALUE, for example axis1=6.28")
    return joint, number


def _duration(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is no duration in seconds")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="servo-command", description="Send one command to the servo over ROS.")
    parser.add_argument("--namespace", default="/servo", help="of the bridge (default: %(default)s)")
    parser.add_argument("--wait", type=float, default=10.0, metavar="S", help="patience (default: %(default)s)")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    for verb, text in (
        ("enable", "find the rotors and hold position"),
        ("disable", "ramp down, outputs off"),
        (topics.QUICK_STOP, "ramp down at the limit and hold; enable again to go on"),
        (topics.CLEAR_FAULTS, "clear the faults whose cause is gone"),
        ("state", "print state, positions and speeds"),
    ):
        verbs.add_parser(verb, help=text)
    for quantity in _QUANTITIES:
        verb_parser = verbs.add_parser(
            quantity, help=f"set-points [{_UNITS[quantity]}], both joints at once if both are named"
        )
        verb_parser.add_argument("targets", nargs="+", type=_target, metavar="JOINT=VALUE")
        if quantity == "position":
            verb_parser.set_defaults(duration=0.0)
        else:
            verb_parser.add_argument(
                "--for",
                dest="duration",
                type=_duration,
                default=1.0,
                metavar="S",
                help="repeat for so long (default: 1)",
            )
    return parser


def _perform(commander: Commander, args: argparse.Namespace) -> str:
    if args.verb in _QUANTITIES:
        commander.set_points(args.verb, dict(args.targets), args.duration)
        return "took effect"
    if args.verb == "state":
        return commander.state()
    if args.verb in ("enable", "disable"):
        return commander.enable(args.verb == "enable")
    return commander.trigger(args.verb)


def main(args: Sequence[str] | None = None) -> int:
    """Command line.

    Returns
    -------
    int
        0 when the command was accepted, 1 when it was refused or nobody answered, 2 for a wrong usage.
    """
    argv = list(sys.argv if args is None else ["servo-command", *args])
    arguments = _parser().parse_args(remove_ros_args(argv)[1:])
    commander: Commander | None = None
    try:
        rclpy.init(args=argv)
        commander = Commander(EventsExecutor(), arguments.namespace.rstrip("/"), arguments.wait)
        print(_perform(commander, arguments))
        return 0
    except (CommandError, NameValidationException, RuntimeError) as error:
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
