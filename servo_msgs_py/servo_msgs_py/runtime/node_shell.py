"""What every node of the servo has around itself: described parameters, help, an orderly end."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException, ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, remove_ros_args, try_shutdown

_SPIN_TIMEOUT: Final = 0.1  # how long a stop may go unnoticed [s]


class ParameterError(ValueError):
    """A parameter does not make sense; the text names it and says what does."""


class NameTakenError(RuntimeError):
    """A node of this name runs already; the text says what to do."""


@dataclass(frozen=True)
class Spec:
    """One parameter: default, description, range, and whether it can change while the node runs.

    In a managed node `read_only` means: it changes only while the node is unconfigured.
    """

    default: Any
    description: str
    low: float | None = None  # smallest value; None: no limit
    high: float | None = None  # largest value; None: no limit
    read_only: bool = True

    def descriptor(self, *, managed: bool = False) -> ParameterDescriptor:
        """ROS descriptor; of a managed node nothing is read-only to ROS, so the node has to refuse changes itself."""
        result = ParameterDescriptor(description=self.description, read_only=self.read_only and not managed)
        if self.read_only and managed:
            result.additional_constraints = "changes only while the node is unconfigured"
        if self.low is not None and self.high is not None:
            if isinstance(self.default, int):
                result.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=0)]
            else:
                result.floating_point_range = [FloatingPointRange(from_value=self.low, to_value=self.high, step=0.0)]
        return result


def declare(node: Node, parameters: Mapping[str, Spec], *, managed: bool = False) -> dict[str, Any]:
    """Declare parameters and return their values.

    Parameters
    ----------
    node : Node
        Owner.
    parameters : mapping of str to Spec
        What to declare.
    managed : bool
        The node has a lifecycle; see `Spec`.

    Raises
    ------
    ParameterError
        If a given value has the wrong type or is out of range.
    """
    values: dict[str, Any] = {}
    for name, spec in parameters.items():
        try:
            values[name] = node.declare_parameter(name, spec.default, spec.descriptor(managed=managed)).value
        except ParameterException as error:
            raise ParameterError(f"parameter {name}: {error}; it is meant as: {spec.description}") from None
    return values


def full_name(node: Node) -> str:
    """Namespace and name without the leading slash: what tells two nodes of one program apart."""
    return str(node.get_fully_qualified_name()).lstrip("/")


def claim_name(node: Node) -> None:
    """Claim the name of a node in its ROS domain on this machine until its context ends.

    Two nodes of one name would both obey every command. The claim is a socket in the abstract namespace of Linux: the
    system takes it back when the process ends, however it ends.

    Raises
    ------
    NameTakenError
        If another node has the name.
    """
    name, domain = full_name(node), node.context.get_domain_id()
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0ros/{domain}/{name}")
    except OSError:
        claim.close()
        raise NameTakenError(
            f"a node /{name} runs already in ROS domain {domain} on this machine and would obey the same commands; "
            "end it, or start this one in another namespace (--ros-args -r __ns:=/other, launch: namespace:=other)"
        ) from None
    # Of a bound method the context would not keep the socket.
    node.context.on_shutdown(lambda: claim.close())


@contextlib.contextmanager
def setting_up(node: Node) -> Iterator[None]:
    """Take a node apart that cannot be set up.

    Left to the garbage collector it would take the log of the next one of its name in the process with it, whenever it
    is collected: rcl knows the publisher of a log by the name of the node.
    """
    try:
        yield
    except BaseException:
        node.destroy_node()
        raise


class Runnable(Protocol):
    """A node that can be ended."""

    failure: str  # why it cannot go on; empty while it can

    finished: bool  # whether it has ended in order by itself

    def shutdown(self) -> None: ...


def help_text(name: str, purpose: str, parameters: Mapping[str, Spec]) -> str:
    """What ``--help`` of a node prints."""
    lines = [f"usage: {name} [-h] [--ros-args -p PARAMETER:=VALUE ... -r FROM:=TO ... --params-file FILE]", ""]
    lines += [*textwrap.wrap(purpose, 100), "", "parameters:"]
    for key, spec in parameters.items():
        limits = f", {spec.low:g} .. {spec.high:g}" if spec.low is not None and spec.high is not None else ""
        text = f"{spec.description} (default: {spec.default!r}{limits})"
        lines += [f"  {key}", *textwrap.wrap(text, 100, initial_indent="      ", subsequent_indent="      ")]
    return "\n".join(lines)


def run(
    name: str,
    purpose: str,
    parameters: Mapping[str, Spec],
    make: Callable[[EventsExecutor], Runnable],
    args: Sequence[str] | None,
) -> int:
    """Run a node until Ctrl-C, SIGTERM, its own end or failure.

    Parameters
    ----------
    name, purpose, parameters
        For messages and ``--help``.
    make : callable
        Makes the node for an executor, once ROS is up.
    args : sequence of str, optional
        Arguments without the program's name; those of the process by default.

    Returns
    -------
    int
        0 after an orderly end, 1 when the node could not go on or its name is taken, 2 when a parameter or an argument
        does not make sense.
    """
    try:
        own = remove_ros_args([name, *(sys.argv[1:] if args is None else args)])[1:]
    except RuntimeError as error:
        return _complain(name, _without_places(str(error)), 2)
    if own and own[0] in ("-h", "--help"):
        print(help_text(name, purpose, parameters))
        return 0
    if own:
        return _complain(name, f"unknown argument {own[0]}; --help lists what there is", 2)
    stop = threading.Event()
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _complain(name, _without_places(str(error)), 2)
    if threading.current_thread() is threading.main_thread():
        # Not rclpy's handlers: ROS has to work on until the node has ended in order.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
    executor = EventsExecutor()
    node: Runnable | None = None
    try:
        node = make(executor)
        executor.add_node(node)
        while ok() and not stop.is_set() and not node.failure and not node.finished:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
        if node.failure:
            return _complain(name, node.failure, 1)
    except ParameterError as error:
        return _complain(name, str(error), 2)
    except NameTakenError as error:
        return _complain(name, str(error), 1)
    except (KeyboardInterrupt, ExternalShutdownException, ROSInterruptException):
        return 0
    finally:
        if node is not None:
            executor.remove_node(node)
            node.shutdown()
        try_shutdown()
    return 0


def _without_places(text: str) -> str:
    """First line of an error of rcl without the places in its C sources."""
    return re.sub(r", at \S+:\d+", "", text.splitlines()[0])


def _complain(name: str, message: str, status: int) -> int:
    print(f"{name}: {message}", file=sys.stderr, flush=True)
    return status
