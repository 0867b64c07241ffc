"""The first contact with a board: its axes are stopped, and keep-alives are sent for as long as it is identified."""

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
"""Longest time between two keep-alives [s]; an exchange that is longer than that is not interrupted."""

_NAME: Final = b"servo"
"""Name of a servo board; another device gets no command."""


@contextmanager
def stopped_at_connection(client: Client, catalogue: Catalogue) -> Iterator[None]:
    """Stop the axes of a board, and keep it from counting the host as silent during what follows.

    The program that set its axes in motion may be gone, and to identify the board takes seconds on a slow line.
    Application commands need no addresses. Another device gets no command.

    Raises
    ------
    FreemasterError
        If nothing answers, not in this protocol, or not to the stop.
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
        # Firmware without application commands: the comparison with the catalogue says so.
        if error.code != Status.UNKNOWN_COMMAND:
            raise
    with kept_alive(client, catalogue):
        yield


@contextmanager
def kept_alive(client: Client, catalogue: Catalogue) -> Iterator[Callable[[], None]]:
    """Send keep-alives before the exchanges of a client, one when `KEEP_ALIVE_PERIOD` is over.

    Yields
    ------
    callable
        Sends one if it is due; for a time without exchanges.
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
        client.before_exchange = None  # the keep-alive consists of exchanges itself
        try:
            # The next one will do; if the line is lost, the request that waits tells.
            with suppress(AnswerTimeoutError, CommandUnfinishedError, DamagedAnswerError, StatusError):
                client.run_command(code)
        finally:
            client.before_exchange = when_due

    return when_due
