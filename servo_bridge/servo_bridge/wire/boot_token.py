"""Token by which a host recognises a board that has not been reset.

The board has no source of random numbers and writes no flash at a start, so the first host after a reset writes the
token. The board accepts it once, and loses it at the next reset.
"""

from __future__ import annotations

import secrets
from contextlib import suppress
from typing import Final

from servo_msgs_py.catalogue import numbers

from servo_bridge.freemaster.errors import StatusError
from servo_bridge.wire.session import Session

BOOT_TOKEN: Final = "boot_token"


def read_boot_token(session: Session) -> int:
    """Token of the board; 0 if no host has written one since its reset."""
    return int(numbers(session.read(session.variables[BOOT_TOKEN]))[0])


def agreed_boot_token(session: Session) -> int:
    """Token of the board, after writing one if there is none; 0 if this client may only read."""
    token = read_boot_token(session)
    if token:
        return token
    with suppress(StatusError):  # another client was faster, the answer was lost, or the access level is too low
        session.write(session.variables[BOOT_TOKEN], [1 + secrets.randbelow(2**31 - 1)])
    return read_boot_token(session)
