"""BoardAccess in which Ctrl-C interrupts waits only, so that the line is usable for restoring the board."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from servo_bridge.measurement_access import SessionAccess, measurement_access
from servo_bridge.tool_record import interrupts
from servo_bridge.wire.session import Session


@contextmanager
def interruptible_access(session: Session) -> Iterator[SessionAccess]:
    """Access to the board of a session; the first Ctrl-C raises `KeyboardInterrupt`, further ones are ignored.

    Parameters
    ----------
    session : Session
        Session with the board.

    Raises
    ------
    KeyboardInterrupt
        From a wait, after Ctrl-C.
    """
    presses = raised = 0

    def press() -> None:
        nonlocal presses
        presses += 1
        if raised:
            print("servo-tool: please wait, the axis is being stopped", file=sys.stderr, flush=True)

    def check() -> None:
        nonlocal raised
        if presses and not raised:
            raised = 1
            raise KeyboardInterrupt

    with interrupts(press), measurement_access(session, check) as access:
        yield access
