"""Keep-alives: the board stops its axes when there is neither a command nor one of these. Pure.

A timer of the executor sends them. The thread of the link must not: with an executor that hangs the node can no longer
stop an axis, so the board has to do it.
"""

from __future__ import annotations

from concurrent.futures import Future
from typing import Final, Protocol

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.wire.take_over import KEEP_ALIVE_PERIOD

_TIMEOUT: Final = "param.host_timeout"
_PER_TIMEOUT: Final = 4  # keep-alives within the time after which the board misses its host


class _RunCommand(Protocol):
    def __call__(self, code: int, *, urgent: bool) -> Future[int]: ...


class KeepAlive:
    """Keep-alives of one node.

    Parameters
    ----------
    catalogue : Catalogue
        For the code of the command and the scale of the time-out.
    run_command : callable
        Starts an application command; see `Link.run_command`.
    """

    def __init__(self, catalogue: Catalogue, run_command: _RunCommand) -> None:
        self._code = catalogue.bits["command"]["KEEP_ALIVE"]
        self._lsb = catalogue[_TIMEOUT].lsb
        self._run_command = run_command
        self._last: Future[int] | None = None

    def send(self) -> None:
        """Send one, unless the last one still waits. One without an answer is no error: the next one follows."""
        if self._last is None or self._last.done():
            # Before everything else: a queue of parameters on a slow line takes longer than the board waits.
            self._last = self._run_command(self._code, urgent=True)

    def period(self, *parameters: RawParameters) -> float:
        """Time between two [s] for a board with the shortest of these time-outs; some may not name it."""
        timeouts = [raw[_TIMEOUT][0] * self._lsb for raw in parameters if _TIMEOUT in raw]
        return min([KEEP_ALIVE_PERIOD, *(timeout / _PER_TIMEOUT for timeout in timeouts)])
