"""Keep-alives: without them and without commands the board stops its axes.

Sent by a timer of the executor, not by the link thread: if the executor hangs, keep-alives must stop so that the board
stops the axes.
"""

from __future__ import annotations

from concurrent.futures import Future
from typing import Final, Protocol

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.wire.stop_at_connection import KEEP_ALIVE_PERIOD

_TIMEOUT: Final = "param.host_timeout"
_PER_TIMEOUT: Final = 4  # keep-alives per param.host_timeout


class _RunCommand(Protocol):
    def __call__(self, code: int, *, urgent: bool) -> Future[int]: ...


class KeepAlive:
    """Sends the keep-alives of one node.

    Parameters
    ----------
    catalogue : Catalogue
        Code of the command and scale of the timeout.
    run_command : callable
        Starts an application command; see `Link.run_command`.
    """

    def __init__(self, catalogue: Catalogue, run_command: _RunCommand) -> None:
        self._code = catalogue.bits["command"]["KEEP_ALIVE"]
        self._lsb = catalogue[_TIMEOUT].lsb
        self._run_command = run_command
        self._last: Future[int] | None = None

    def send(self) -> None:
        """Send a keep-alive, unless the last one is pending. A lost keep-alive is ignored."""
        if self._last is None or self._last.done():
            # Urgent: on a slow line a queue of parameters may take longer than the timeout of the board.
            self._last = self._run_command(self._code, urgent=True)

    def period(self, *parameters: RawParameters) -> float:
        """Period of keep-alives [s] for the shortest timeout of these parameters; entries may omit it."""
        timeouts = [raw[_TIMEOUT][0] * self._lsb for raw in parameters if _TIMEOUT in raw]
        return min([KEEP_ALIVE_PERIOD, *(timeout / _PER_TIMEOUT for timeout in timeouts)])
