"""Node of a program that sends commands to a servo and waits for their effect.

Commands have a ticket, which the bridge answers, and a path has a lease, which every step of the program renews: when
the program ends in any way or is suspended, the joints stop, see `servo_msgs_py.answers`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState
from servo_msgs_py.answers import LEASE_PERIOD, Answer, Phase, answer_from_message, new_ticket
from servo_msgs_py.runtime import ros_environment
from servo_msgs_py.runtime.node_name import taken
from servo_msgs_py.runtime.parameters import warn_of_unknown
from servo_msgs_py.runtime.program import Stop, deferred
from servo_msgs_py.runtime.qos import answers_qos, command_qos
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from servo_msgs_py import topics

BRIDGE: Final = "servo_bridge"  # name of its node
STEP: Final = 0.02  # longest period of the check of a condition [s]
_AGAIN: Final = 0.5
"""Time after which a command without an answer is repeated: it may have met no subscriber [s]."""
_PERIODS: Final = 3  # most timeouts that a wait takes while the discovery of the bridge makes progress


class CommandError(RuntimeError):
    """The command had no effect, or not the whole effect; the text has the reason and a remedy."""


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
    ros_environment.prepare()
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
        warn_of_unknown(self)
        self._session = session
        self._namespace = namespace
        self._commands: Commands | None = None
        session.executor.add_node(self)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.executor.remove_node(self)
        self.destroy_node()

    def of(self, name: str) -> str:
        """Name of a topic or service of the servo."""
        return f"{self._namespace}/{name}"

    @property
    def commands(self) -> Commands:
        """Sender of the commands; its topics exist from the first use on."""
        if self._commands is None:
            self._commands = Commands(self)
        return self._commands

    def step(self) -> None:
        """Execute one callback or wait shortly, and renew the leases.

        Raises
        ------
        Interrupted
            After a signal; once.
        """
        self._session.stop.check()
        self._session.executor.spin_once(timeout_sec=STEP)
        if self._commands is not None:
            self._commands.renew()

    def holds(self, condition: Callable[[], object], timeout: float) -> bool:
        """Wait until the condition holds or for the timeout; returns whether it holds.

        The timeout [s] counts the steps of this program, each for `STEP` at most: a busy computer does not shorten it.
        It begins again, `_PERIODS` times in all, if more of the bridge was discovered meanwhile, or if a bridge runs on
        this computer and nothing of it was.
        """
        for _ in range(_PERIODS):
            found, passed = len(self._topics()), 0.0
            while not condition():
                if passed >= timeout:
                    break
                begin = time.monotonic()
                self.step()
                passed += min(time.monotonic() - begin, STEP)
            else:
                return True
            if len(self._topics()) <= found and not self.undiscovered:
                break
        return False

    def _topics(self) -> list[str]:
        """Discovered topics of the servo."""
        return [name for name, _ in self.get_topic_names_and_types() if name.startswith(self.of(""))]

    @property
    def undiscovered(self) -> bool:
        """Whether the bridge runs on this computer and in this ROS domain, but is not discovered."""
        bridge = self.of(BRIDGE).lstrip("/")
        return not self.count_publishers(self.of(topics.LINK)) and taken(bridge, self.context.get_domain_id())


class Commands:
    """Set-points and paths with tickets.

    Parameters
    ----------
    client : Client
        Sender.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._answers: dict[str, Answer] = {}  # newest, by ticket
        self._paths: list[str] = []  # tickets of paths that may not have ended
        self._renewed = 0.0  # steady time [s]
        self.sent = False  # whether a joint may be in motion for this program
        of, qos = client.of, command_qos()
        client.create_subscription(DiagnosticStatus, of(topics.ANSWERS), self._on_answer, answers_qos())
        self._publishers = {
            JointState: client.create_publisher(JointState, of(topics.JOINT_COMMANDS), qos),
            JointTrajectory: client.create_publisher(JointTrajectory, of(topics.JOINT_TRAJECTORY), qos),
        }
        self._leases = client.create_publisher(String, of(topics.LEASES), qos)

    def missing(self) -> list[str]:
        """Topics of commands without a subscriber."""
        publishers = (*self._publishers.values(), self._leases)
        return [each.topic_name for each in publishers if not each.get_subscription_count()]

    def publish(self, message: JointState | JointTrajectory) -> str:
        """Publish a command once; returns its ticket."""
        ticket = message.header.frame_id = new_ticket(self._client.get_name())
        self.sent = True
        self._publishers[type(message)].publish(message)
        if isinstance(message, JointTrajectory):
            self._paths.append(ticket)
        return ticket

    def send(self, message: JointState | JointTrajectory, timeout: float) -> str:
        """Publish a command until it is answered; returns its ticket.

        Raises
        ------
        CommandError
            If it is refused, or not answered within the timeout [s].
        """
        if not self._client.holds(lambda: not self.missing(), timeout):
            raise CommandError(f"no subscriber on {', '.join(self.missing())} within {timeout:g} s; start the bridge")
        ticket = self.publish(message)
        published = time.monotonic()

        def answered() -> bool:
            nonlocal published
            if time.monotonic() >= published + _AGAIN:
                published = time.monotonic()
                self.repeat(message)
            return ticket in self._answers

        if not self._client.holds(answered, timeout):
            raise CommandError(f"no answer of the bridge to the command within {timeout:g} s")
        self.answer(ticket)
        return ticket

    def repeat(self, message: JointState | JointTrajectory) -> None:
        """Publish a command again, with its ticket."""
        self._publishers[type(message)].publish(message)

    def answer(self, ticket: str) -> Answer | None:
        """Newest answer to a command; None: not answered.

        Raises
        ------
        CommandError
            If it was refused or aborted.
        """
        answer = self._answers.get(ticket)
        if answer is not None and answer.phase is Phase.REFUSED:
            raise CommandError(f"refused, no motion: {answer.text}")
        if answer is not None and answer.phase is Phase.ABORTED:
            raise CommandError(f"stopped before the end: {answer.text}")
        return answer

    def renew(self) -> None:
        """Renew the leases of the paths that have not ended, if it is time."""
        now = time.monotonic()
        if not self._paths or now < self._renewed + LEASE_PERIOD:
            return
        self._renewed = now
        answers = self._answers
        self._paths = [ticket for ticket in self._paths if ticket not in answers or not answers[ticket].phase.final]
        for ticket in self._paths:
            self._leases.publish(String(data=ticket))

    def _on_answer(self, message: DiagnosticStatus) -> None:
        answer = answer_from_message(message)
        self._answers[answer.ticket] = answer
