"""Node of a program that sends commands to a servo and waits for their effect."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from servo_msgs_py.runtime.program import Stop, deferred

STEP: Final = 0.02  # longest period of the check of a condition [s]


class Session:
    """ROS for one program: initialised, with an executor and the signals that end the program.

    Parameters
    ----------
    executor : EventsExecutor
        Runs the node of the program.
    stop : Stop
        A signal ends the program between two steps of the executor, so that a motion can still be stopped.
    """

    def __init__(self, executor: EventsExecutor, stop: Stop) -> None:
        self.executor = executor
        self.stop = stop


@contextmanager
def ros_session(argv: Sequence[str]) -> Iterator[Session]:
    """Initialise ROS; at the end nothing of it is left that could run while the interpreter ends.

    Parameters
    ----------
    argv : sequence of str
        Arguments with the name of the program.
    """
    rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    try:
        with deferred() as stop:
            executor = EventsExecutor()
            try:
                yield Session(executor, stop)
            finally:
                executor.shutdown()
    finally:
        try_shutdown()


class Client(Node):
    """Node that runs only while the program waits.

    Parameters
    ----------
    name : str
        Name of the node.
    session : Session
        Its executor.
    namespace : str
        Namespace of the servo.
    """

    def __init__(self, name: str, session: Session, namespace: str) -> None:
        super().__init__(name)
        self._session = session
        self._namespace = namespace
        session.executor.add_node(self)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.executor.remove_node(self)
        self.destroy_node()

    def of(self, name: str) -> str:
        """Name of a topic or service of the servo."""
        return f"{self._namespace}/{name}"

    def step(self) -> None:
        """Execute one callback or wait shortly.

        Raises
        ------
        Interrupted
            After a signal; once.
        """
        self._session.stop.check()
        self._session.executor.spin_once(timeout_sec=STEP)

    def holds(self, condition: Callable[[], object], timeout: float) -> bool:
        """Wait until the condition holds or for the timeout [s]; returns whether it holds."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline:
                return False
            self.step()
        return True
