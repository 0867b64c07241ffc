"""How the nodes of this package run: until Ctrl-C or SIGTERM, and to an orderly end."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Final, Protocol

import rclpy
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, try_shutdown

from servo_twin.ros_parameters import ParameterError

__all__ = ["Runnable", "run"]

_SPIN_TIMEOUT: Final = 0.1  # how long a stop may go unnoticed [s]


class Runnable(Protocol):
    """A node that can be ended."""

    failure: str
    """Why it cannot go on; empty while it can."""

    def shutdown(self) -> None: ...


def run(name: str, make: Callable[[], Runnable], args: Sequence[str] | None) -> int:
    """Run a node until Ctrl-C, SIGTERM or its own failure.

    Parameters
    ----------
    name : str
        For messages.
    make : callable
        Makes the node, once ROS is up.
    args : sequence of str, optional
        ROS arguments; those of the process by default.

    Returns
    -------
    int
        0 after an orderly end, 1 when the node could not go on, 2 when a parameter or an argument does not make sense.
    """
    stop = threading.Event()
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _complain(name, str(error).splitlines()[0], 2)
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
    executor = EventsExecutor()
    node: Runnable | None = None
    try:
        node = make()
        executor.add_node(node)
        while ok() and not stop.is_set() and not node.failure:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
        if node.failure:
            return _complain(name, node.failure, 1)
    except ParameterError as error:
        return _complain(name, str(error), 2)
    except (KeyboardInterrupt, ExternalShutdownException, ROSInterruptException):
        return 0
    finally:
        if node is not None:
            executor.remove_node(node)
            node.shutdown()
        try_shutdown()
    return 0


def _complain(name: str, message: str, status: int) -> int:
    print(f"{name}: {message}", file=sys.stderr, flush=True)
    return status
