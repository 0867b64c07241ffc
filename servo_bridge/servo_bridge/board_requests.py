"""Requests to a board that take several exchanges: configuration and storage, one after the other."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from typing import Final

from servo_msgs_py.board_port import BoardPort
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.board_context import BoardContext
from servo_bridge.part import Part
from servo_bridge.wire.session_port import SessionPort

TIMEOUT: Final = 10.0
"""Timeout of one exchange [s]; the link itself reports earlier."""


class BoardRequests(Part, BoardPort):
    """Thread that executes requests in their order, and the port that they use.

    Each access is a separate job of the link, so that set-points and telemetry continue in between.

    Parameters
    ----------
    context : BoardContext
        Access to the board.
    """

    def __init__(self, context: BoardContext) -> None:
        self._context = context
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="servo requests", daemon=True).start()

    def put(self, request: Callable[[], None]) -> None:
        """Execute a request, which handles its errors, after those before it."""
        self._queue.put(request)

    def close(self) -> None:
        """The thread ends after the present request."""
        self._queue.put(None)

    def _run(self) -> None:
        while (request := self._queue.get()) is not None:
            request()

    # ---- port, in this thread only
    @property
    def catalogue(self) -> Catalogue:
        return self._context.catalogue

    def clock(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def read_words(self, name: str) -> list[int]:
        return self._context.call(lambda session: SessionPort(session).read_words(name)).result(TIMEOUT)

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        call = self._context.call
        return call(lambda session: SessionPort(session).write_words(name, words, first)).result(TIMEOUT)


def error_text(error: Exception) -> str:
    """Text of an error of a request."""
    missing = "no response of the board" if isinstance(error, futures.TimeoutError) else type(error).__name__
    return str(error) or missing
