"""Quick stop at the first contact with a board, and keep-alives during its identification."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from servo_msgs_py.catalogue import Catalogue

from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    CommandUnfinishedError,
    DamagedAnswerError,
    Status,
    StatusError,
)

KEEP_ALIVE_PERIOD: Final = 0.1
"""Period of keep-alives [s]; a longer exchange is not interrupted."""

_NAME: Final = b"servo"
"""Name of a servo board; other devices receive no commands."""


@contextmanager
def stopped_at_connection(client: Client, catalogue: Catalogue) -> Iterator[None]:
    """Send a quick stop at the first contact, then keep-alives until the end of the block (identification).

    The program that enabled the axes may have ended, and the identification takes seconds on a slow line. Application
    commands need no addresses. Other devices receive no commands.

    Raises
    ------
    FreemasterError
        If there is no response, another protocol, or no response to the stop.
    """
    client.probe()
    name = client.get_config("NM") or b""
    if name.split(b"\x00", 1)[0] != _NAME:
        yield
        return
    codes = catalogue.bits["command"]
    try:
        client.run_command(codes["QUICK_STOP"])
    except StatusError as error:
        # Firmware without application commands; reported by the comparison with the catalogue.
        if error.code != Status.UNKNOWN_COMMAND:
            raise
    with kept_alive(client, catalogue):
        yield


@contextmanager
def kept_alive(client: Client, catalogue: Catalogue) -> Iterator[Callable[[], None]]:
    """Send a keep-alive before an exchange of a client whenever `KEEP_ALIVE_PERIOD` has elapsed.

    Yields
    ------
    callable
        Sends a keep-alive if it is due, for times without exchanges.
    """
    client.before_exchange = when_due = _keep_alive(client, catalogue.bits["command"]["KEEP_ALIVE"])
    try:
        yield when_due
    finally:
        client.before_exchange = None


def _keep_alive(client: Client, code: int) -> Callable[[], None]:
    clock, period = client.line.clock, round(KEEP_ALIVE_PERIOD * 1e9)
    due = clock() + period

    def when_due() -> None:
        nonlocal due
        if clock() < due:
            return
        due = clock() + period
        client.before_exchange = None  # the keep-alive is an exchange itself
        try:
            # The next keep-alive follows; the loss of the line is reported by the pending request.
            with suppress(AnswerTimeoutError, CommandUnfinishedError, DamagedAnswerError, StatusError):
                client.run_command(code)
        finally:
            client.before_exchange = when_due

    return when_due
