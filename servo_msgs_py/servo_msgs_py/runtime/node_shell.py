"""Common functions of all nodes of the servo: unique names, arguments, orderly shutdown."""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, Protocol

import rclpy
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, remove_ros_args, try_shutdown

from servo_msgs_py.runtime import ros_environment
from servo_msgs_py.runtime.node_name import claim
from servo_msgs_py.runtime.parameters import ParameterError, Spec, help_text, ros_parameter_file, warn_of_unknown
from servo_msgs_py.runtime.program import complain, deferred, program

_SPIN_TIMEOUT: Final = 0.1  # longest delay until a stop request is processed [s]


class NameTakenError(RuntimeError):
    """A node with this name is already running; the text contains the remedy."""


def full_name(node: Node) -> str:
    """Namespace and name without the leading slash."""
    return str(node.get_fully_qualified_name()).lstrip("/")


def claim_name(node: Node) -> None:
    """Reserve the name of a node in its ROS domain on this machine until its context is shut down.

    Two nodes with the same name would both execute every command.

    Raises
    ------
    NameTakenError
        If another node has the name.
    """
    name, domain = full_name(node), node.context.get_domain_id()
    own = claim(name, domain)
    if own is None:
        raise NameTakenError(
            f"a node /{name} is already running in ROS domain {domain} on this machine and would execute the same "
            "commands; end it, or start this one in another namespace (--ros-args -r __ns:=/other, launch: "
            "namespace:=other)"
        )
    # The context does not keep a reference to a bound method, and thus not to the socket.
    node.context.on_shutdown(lambda: own.close())


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


def run(
    name: str,
    purpose: str,
    parameters: Mapping[str, Spec],
    make: Callable[[EventsExecutor], Runnable],
    args: Sequence[str] | None,
    *,
    endless: bool = True,
) -> int:
    """Run a node until SIGINT, SIGTERM, SIGHUP, its end or an error.

    Parameters
    ----------
    name, purpose, parameters
        For messages, ``--help`` and ``--parameter-file``.
    make : callable
        Creates the node for an executor; called after the initialisation of ROS.
    args : sequence of str, optional
        Arguments without the name of the program; by default those of the process.
    endless : bool
        Whether a signal is the ordinary end of the node.

    Returns
    -------
    int
        0 after the ordinary end, 1 after an error of the node or if its name is in use, 2 if a parameter or an argument
        is invalid.
    """
    return program(name)(lambda: _run(name, purpose, parameters, make, args, endless=endless))()


def _run(
    name: str,
    purpose: str,
    parameters: Mapping[str, Spec],
    make: Callable[[EventsExecutor], Runnable],
    args: Sequence[str] | None,
    *,
    endless: bool,
) -> int:
    try:
        own = remove_ros_args([name, *(sys.argv[1:] if args is None else args)])[1:]
    except RuntimeError as error:
        return _print_error(name, _without_source_lines(str(error)), 2)
    if own and own[0] in ("-h", "--help"):
        print(help_text(name, purpose, parameters))
        return 0
    if own == ["--parameter-file"]:
        print(ros_parameter_file(name, parameters), end="")
        return 0
    if own:
        return _print_error(name, f"unknown argument {own[0]}; --help lists all arguments", 2)
    ros_environment.prepare()
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _print_error(name, _without_source_lines(str(error)), 2)
    # Not the handlers of rclpy: ROS is needed until the orderly shutdown of the node is complete.
    with deferred() as stop:
        executor = EventsExecutor()
        node: Runnable | None = None
        failure = ""
        try:
            node = make(executor)
            warn_of_unknown(node)
            executor.add_node(node)
            while ok() and not stop.requested and not node.failure and not node.finished:
                executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
            if node.failure:
                return _print_error(name, node.failure, 1)
            if not (endless or node.finished):
                stop.check()
        except ParameterError as error:
            return _print_error(name, str(error), 2)
        except NameTakenError as error:
            return _print_error(name, str(error), 1)
        except (ExternalShutdownException, ROSInterruptException):
            return 0
        finally:
            if node is not None:
                executor.remove_node(node)
                node.shutdown()
                failure = str(node.failure)  # of the shutdown
            executor.shutdown()
            try_shutdown()
    return _print_error(name, failure, 1) if failure else 0


def _without_source_lines(text: str) -> str:
    """First line of an rcl error, without the file names and line numbers of its C sources."""
    return re.sub(r", at \S+:\d+", "", text.splitlines()[0])


def _print_error(name: str, message: str, status: int) -> int:
    complain(f"{name}: {message}")
    return status
