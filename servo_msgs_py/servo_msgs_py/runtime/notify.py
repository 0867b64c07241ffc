"""State of a program for the process that has started it: the protocol of ``sd_notify`` (systemd)."""

from __future__ import annotations

import contextlib
import os
import socket
from typing import Final

SOCKET: Final = "NOTIFY_SOCKET"
"""Environment variable with the address of a datagram socket; ``@``: in the abstract namespace of Linux."""


def notify(status: str, *, ready: bool = False) -> None:
    """Send one line of text, and whether the start is complete; without `SOCKET` nothing is sent.

    Parameters
    ----------
    status : str
        For people.
    ready : bool
        True when the program does what it has been started for.
    """
    address = os.environ.get(SOCKET)
    if not address:
        return
    lines = [f"STATUS={' '.join(status.splitlines())}", *(["READY=1"] if ready else [])]
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        sender.sendto("\n".join(lines).encode(), "\0" + address[1:] if address[0] == "@" else address)
