"""States of the link, with reason and remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from servo_bridge.freemaster.client import PASSWORD_VARIABLE
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    DamagedAnswerError,
    FreemasterError,
    Status,
    StatusError,
    TransportError,
    WrongProtocolError,
)
from servo_bridge.wire.restoration import BoardRestoringError
from servo_bridge.wire.scope_reader import BoardResetError, BoardStoppedError
from servo_bridge.wire.serial_port import PortError
from servo_bridge.wire.session import BoardMismatchError


class LinkState(Enum):
    """State of the connection to the board."""

    DISCONNECTED = "disconnected"
    """No board; the link reconnects automatically."""
    CONNECTING = "connecting"
    CONNECTED = "connected"
    FAILED = "failed"
    """A device is present, but needs an action of the user."""


@dataclass(frozen=True)
class LinkStatus:
    """State of the link."""

    state: LinkState  # of the link
    reason: str  # reason, one line
    remedy: str = ""  # action of the user; empty: none

    def __str__(self) -> str:
        return f"{self.reason}; {self.remedy}" if self.remedy else self.reason


def status_of(error: Exception, url: str, baud: int, *, connected: bool) -> LinkStatus:
    """Status for the error that ended a connection, or an attempt to connect.

    Parameters
    ----------
    error : Exception
        The error.
    url : str
        Port.
    baud : int
        Line speed [bit/s].
    connected : bool
        Whether the board was connected before.
    """
    reason = str(error)
    if isinstance(error, PortError):
        state = LinkState.DISCONNECTED if error.missing else LinkState.FAILED
        return LinkStatus(state, error.reason, error.remedy)
    if isinstance(error, BoardMismatchError):
        return LinkStatus(LinkState.FAILED, error.reason, error.remedy)
    if isinstance(error, WrongProtocolError):
        return LinkStatus(LinkState.FAILED, f"{url}: {reason}", "set port and baud rate of the servo board")
    if isinstance(error, StatusError):
        remedy = "flash the firmware of this release"
        if error.code == Status.PASSWORD_NEEDED:
            remedy = (
                f"set the environment variable {PASSWORD_VARIABLE} to a password of this level, "
                "or use servo-tool --password"
            )
        elif error.code == Status.WRONG_PASSWORD:
            remedy = "check the password"
        return LinkStatus(LinkState.FAILED, reason, remedy)
    if isinstance(error, BoardResetError):
        return LinkStatus(LinkState.DISCONNECTED, reason, "enable the axes again after the reconnection")
    if isinstance(error, BoardRestoringError):
        return LinkStatus(LinkState.DISCONNECTED, reason, "bring the shaft to rest; the link reconnects automatically")
    if isinstance(error, BoardStoppedError):
        return LinkStatus(LinkState.FAILED, reason, "reset the board")
    if isinstance(error, TransportError):
        return LinkStatus(
            LinkState.DISCONNECTED, reason, "plug the adapter in again; the link reconnects automatically"
        )
    if isinstance(error, AnswerTimeoutError):
        problem = "the board has stopped responding" if connected else f"no response at {baud} baud"
        return LinkStatus(
            LinkState.DISCONNECTED, f"{problem} on {url}", "check the supply of the board, its cable and the baud rate"
        )
    if isinstance(error, DamagedAnswerError):
        return LinkStatus(
            LinkState.DISCONNECTED,
            f"the line {url} has errors: {reason}",
            "check the cable, its ground and the baud rate",
        )
    if isinstance(error, FreemasterError):
        return LinkStatus(LinkState.FAILED, reason, "flash the firmware of this release")
    return LinkStatus(LinkState.FAILED, f"internal error: {error!r}", "see the log and report it")
