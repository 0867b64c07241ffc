"""Quick stop at the first contact with a board, and keep-alives during its identification."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from servo_msgs_py.board_description import board_of
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.errors import Status, StatusError
from servo_bridge.wire.keep_alive import kept_alive


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
    if board_of(name.split(b"\x00", 1)[0].decode("utf-8", "replace")) is None:
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
