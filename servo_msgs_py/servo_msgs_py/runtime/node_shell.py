"""Common functions of all nodes of the servo: parameters with descriptions, help, orderly shutdown."""

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

_SPIN_TIMEOUT: Final = 0.1  # longest delay until a stop request is processed [s]


class ParameterError(ValueError):
    """A parameter is invalid; the text contains its name and its valid values."""


class NameTakenError(RuntimeError):
    """A node with this name is already running; the text contains the remedy."""


@dataclass(frozen=True)
class Spec:
    """One parameter: default, description, range, and whether it can change at run time.

    In a managed node, a `read_only` parameter can change only while the node is unconfigured.
    """

    default: Any
    description: str
    low: float | None = None  # smallest value; None: no limit
    high: float | None = None  # largest value; None: no limit
    read_only: bool = True

    def descriptor(self, *, managed: bool = False) -> ParameterDescriptor:
        """ROS descriptor; a managed node has no read-only parameters in ROS, so the node has to reject changes."""
        result = ParameterDescriptor(description=self.description, read_only=self.read_only and not managed)
        if self.read_only and managed:
            result.additional_constraints = "can be changed only while the node is unconfigured"
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
        Their specifications.

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
            raise ParameterError(f"parameter {name}: {error}; description: {spec.description}") from None
    return values


def full_name(node: Node) -> str:
    """Namespace and name without the leading slash."""
    return str(node.get_fully_qualified_name()).lstrip("/")


def claim_name(node: Node) -> None:
    """Reserve the name of a node in its ROS domain on this machine until its context is shut down.

    Two nodes with the same name would both execute every command. The reservation is a socket in the abstract namespace
    of Linux; the system releases it when the process ends for any reason.

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
            f"a node /{name} is already running in ROS domain {domain} on this machine and would execute the same "
            "commands; end it, or start this one in another namespace (--ros-args -r __ns:=/other, launch: "
            "namespace:=other)"
        ) from None
    # The context does not keep a reference to a bound method, and thus not to the socket.
    node.context.on_shutdown(lambda: claim.close())


@contextlib.contextmanager
def destroyed_on_error(node: Node) -> Iterator[None]:
    """Destroy a node whose set-up fails.

    If the garbage collector destroyed it later, the log publisher of the next node with the same name in the process
    would be destroyed with it, because rcl identifies the publisher by the name of the node.
    """
    try:
        yield
    except BaseException:
        node.destroy_node()
        raise


class Runnable(Protocol):
    """A node with an orderly shutdown."""

    failure: str  # cause of an error that ends the node; empty if there is none

    finished: bool  # whether the node has ended without an error

    def shutdown(self) -> None: ...


def help_text(name: str, purpose: str, parameters: Mapping[str, Spec]) -> str:
    """Text of ``--help`` of a node."""
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
    """Run a node until Ctrl-C, SIGTERM, its end or an error.

    Parameters
    ----------
    name, purpose, parameters
        For messages and ``--help``.
    make : callable
        Creates the node for an executor; called after the initialisation of ROS.
    args : sequence of str, optional
        Arguments without the name of the program; by default those of the process.

    Returns
    -------
    int
        0 after an orderly end, 1 after an error of the node or if its name is in use, 2 if a parameter or an argument
        is invalid.
    """
    try:
        own = remove_ros_args([name, *(sys.argv[1:] if args is None else args)])[1:]
    except RuntimeError as error:
        return _print_error(name, _without_source_lines(str(error)), 2)
    if own and own[0] in ("-h", "--help"):
        print(help_text(name, purpose, parameters))
        return 0
    if own:
        return _print_error(name, f"unknown argument {own[0]}; --help lists all arguments", 2)
    stop = threading.Event()
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _print_error(name, _without_source_lines(str(error)), 2)
    if threading.current_thread() is threading.main_thread():
        # Not the handlers of rclpy: ROS is needed until the orderly shutdown of the node is complete.
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
            return _print_error(name, node.failure, 1)
    except ParameterError as error:
        return _print_error(name, str(error), 2)
    except NameTakenError as error:
        return _print_error(name, str(error), 1)
    except (KeyboardInterrupt, ExternalShutdownException, ROSInterruptException):
        return 0
    finally:
        if node is not None:
            executor.remove_node(node)
            node.shutdown()
        try_shutdown()
    return 0


def _without_source_lines(text: str) -> str:
    """First line of an rcl error, without the file names and line numbers of its C sources."""
    return re.sub(r", at \S+:\d+", "", text.splitlines()[0])


def _print_error(name: str, message: str, status: int) -> int:
    print(f"{name}: {message}", file=sys.stderr, flush=True)
    return status
