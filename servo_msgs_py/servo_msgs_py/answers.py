"""Answers of the bridge to single commands on ``joint_trajectory`` and ``joint_commands``.

A program that wants to know what becomes of its command writes a ticket into ``header.frame_id``: `TICKET` and a text
that no other command has. Every change of the phase of this command is published on the topic ``answers``. A trajectory
with a ticket has a lease: its sender publishes the ticket on the topic ``leases`` more often than every
`LEASE_TIMEOUT`, or the joints stop and hold. Commands without a ticket are not answered and have no lease.
"""

from __future__ import annotations

import os
import uuid
from dataclasses import dataclass
from enum import Enum
from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

TICKET: Final = "ticket/"
"""Beginning of a ticket."""

LEASE_TIMEOUT: Final = 2.0
"""Time without a renewal after which the joints of a trajectory stop [s]: a program on a busy computer renews in time,
and a shaft does not move long for a program that has ended."""

LEASE_PERIOD: Final = 0.2
"""Period of the renewals [s]."""


class Phase(Enum):
    """Phase of a command; the values are those of the key ``phase`` of a message."""

    ACCEPTED = "accepted"  # set-points: sent to the board; trajectory: waits for its start
    RUNNING = "running"  # the trajectory has begun
    SUCCEEDED = "succeeded"  # the trajectory has ended within the goal tolerances, or the joints have stopped
    ABORTED = "aborted"  # the trajectory has begun, and was not followed to its end within the tolerances
    REFUSED = "refused"  # without effect

    @property
    def final(self) -> bool:
        """Whether no other phase of a trajectory follows."""
        return self not in (Phase.ACCEPTED, Phase.RUNNING)


_LEVELS: Final = {Phase.ABORTED: DiagnosticStatus.ERROR, Phase.REFUSED: DiagnosticStatus.ERROR}


@dataclass(frozen=True)
class Answer:
    """Phase of one command."""

    ticket: str  # ``header.frame_id`` of the command
    source: str  # relative name of its topic
    phase: Phase  # present phase
    text: str = ""  # reason of a refusal or an abort, for people
    code: int = 0  # of a trajectory: ``error_code`` of control_msgs/action/FollowJointTrajectory


def new_ticket(program: str) -> str:
    """Ticket of a new command of a program."""
    return f"{TICKET}{program}-{os.getpid()}-{uuid.uuid4().hex[:12]}"


def answer_message(answer: Answer) -> DiagnosticStatus:
    """Convert an answer to its message."""
    values = {"ticket": answer.ticket, "phase": answer.phase.value, "code": str(answer.code)}
    return DiagnosticStatus(
        level=_LEVELS.get(answer.phase, DiagnosticStatus.OK),
        name=answer.source,
        message=answer.text,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def answer_from_message(message: DiagnosticStatus) -> Answer:
    """Convert a message to an answer.

    Raises
    ------
    ValueError
        If a field is missing or unknown.
    """
    values = {pair.key: pair.value for pair in message.values}
    try:
        ticket, phase, code = values["ticket"], Phase(values["phase"]), int(values["code"])
    except KeyError as error:
        raise ValueError(f"an answer has no key {error}") from None
    return Answer(ticket, message.name, phase, message.message, code)
