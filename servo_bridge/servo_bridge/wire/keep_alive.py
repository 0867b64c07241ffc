"""Keep-alives: without them and without commands the board stops its axes.

They are sent by the thread that owns the line, so that no other work of the program delays them, and only while the
owner of the line is alive: a program whose commanding thread hangs must not keep a shaft turning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    CommandUnfinishedError,
    DamagedAnswerError,
    StatusError,
)

KEEP_ALIVE_PERIOD: Final = 0.1
"""Period of keep-alives [s]; a longer exchange is not interrupted."""

_TIMEOUT: Final = "param.host_timeout"
_PER_TIMEOUT: Final = 4  # keep-alives per param.host_timeout


def keep_alive_period(catalogue: Catalogue, *parameters: RawParameters) -> float:
    """Period of keep-alives [s] for the shortest timeout of these parameters; entries may omit it."""
    lsb = catalogue[_TIMEOUT].lsb
    timeouts = [raw[_TIMEOUT][0] * lsb for raw in parameters if _TIMEOUT in raw]
    return min([KEEP_ALIVE_PERIOD, *(timeout / _PER_TIMEOUT for timeout in timeouts)])


class KeepAlive:
    """Keep-alives of one client; a call sends one if it is due.

    Parameters
    ----------
    client : Client
        Client of the board.
    code : int
        Code of the application command.
    withheld : callable
        True while no keep-alive may be sent.
    fed : callable
        Called with the time [ns] of every acknowledged keep-alive or command.
    """

    def __init__(
        self,
        client: Client,
        code: int,
        withheld: Callable[[], bool] = lambda: False,
        fed: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.period = KEEP_ALIVE_PERIOD  # [s]; any thread may change it
        self._client = client
        self._code = code
        self._withheld = withheld
        self._fed = fed
        self._clock = client.line.clock
        self._last = self._clock()  # attempt of a keep-alive, or acknowledged command [ns]

    def commanded(self) -> None:
        """Note a command that the board has acknowledged; it has the effect of a keep-alive."""
        self._last = self._clock()
        self._fed(self._last)

    @property
    def remaining(self) -> float:
        """Time until the next keep-alive [s]; not above 0 if it is due."""
        return self.period - (self._clock() - self._last) * 1e-9

    def __call__(self) -> None:
        """Send a keep-alive if it is due."""
        if self.remaining > 0.0 or self._withheld():
            return
        self._last = self._clock()
        before, self._client.before_exchange = self._client.before_exchange, None  # it is an exchange itself
        try:
            # The next keep-alive follows; the loss of the line is reported by the pending request.
            with suppress(AnswerTimeoutError, CommandUnfinishedError, DamagedAnswerError, StatusError):
                self._client.run_command(self._code, repeatable=True)
                self._fed(self._clock())
        finally:
            self._client.before_exchange = before


@contextmanager
def kept_alive(
    client: Client,
    catalogue: Catalogue,
    withheld: Callable[[], bool] = lambda: False,
    fed: Callable[[int], None] = lambda _: None,
) -> Iterator[KeepAlive]:
    """Send a keep-alive before an exchange of a client whenever one is due, until the end of the block.

    Parameters as for `KeepAlive`.

    Yields
    ------
    KeepAlive
        To be called in times without exchanges.
    """
    keep_alive = KeepAlive(client, catalogue.bits["command"]["KEEP_ALIVE"], withheld, fed)
    client.before_exchange = keep_alive
    try:
        yield keep_alive
    finally:
        client.before_exchange = None
