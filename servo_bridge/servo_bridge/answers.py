"""Publisher of the answers to commands with a ticket."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from servo_msgs_py.answers import TICKET, Answer, Phase, answer_message
from servo_msgs_py.runtime.qos import answers_qos

from servo_msgs_py import topics

_KEPT: Final = 64  # number of tickets whose last answer is known


class Answers:
    """The topic ``answers``.

    Parameters
    ----------
    node : Node
        Owner.
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(DiagnosticStatus, topics.ANSWERS, answers_qos())
        self._last: OrderedDict[str, Answer] = OrderedDict()  # by ticket, the newest at the end

    def known(self, ticket: str) -> bool:
        """Whether a command with this ticket was answered, so that this message is a repetition."""
        return ticket in self._last

    def refused(self, ticket: str) -> bool:
        """Whether a command with this ticket was refused: its sender may not know that yet, and repeat it."""
        last = self._last.get(ticket)
        return last is not None and last.phase is Phase.REFUSED

    def publish(self, answer: Answer) -> None:
        """Publish an answer, unless the command has no ticket, or was answered so before."""
        if not answer.ticket.startswith(TICKET) or self._last.get(answer.ticket) == answer:
            return
        self._last[answer.ticket] = answer
        self._last.move_to_end(answer.ticket)
        if len(self._last) > _KEPT:
            self._last.popitem(last=False)
        self._publisher.publish(answer_message(answer))
