"""Passes function calls from the thread of the link to the thread of the executor."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable


class Inbox:
    """Calls functions in order in the thread of the executor.

    All waiting functions are called in one batch, so that a fast link does not wake the executor for every sample.

    Parameters
    ----------
    call_soon : callable
        Schedules a function in the executor; may be called from any thread.
    """

    def __init__(self, call_soon: Callable[[Callable[[], None]], object]) -> None:
        self._call_soon = call_soon
        self._waiting: deque[Callable[[], None]] = deque()
        self._lock = threading.Lock()
        self._scheduled = False
        self._closed = False

    def post(self, function: Callable[[], None]) -> None:
        """Queue a function; from any thread."""
        with self._lock:
            if self._closed:
                return
            self._waiting.append(function)
            if self._scheduled:
                return
            self._scheduled = True
        self._call_soon(self.drain)

    def drain(self) -> None:
        """Call all waiting functions; in the thread of the executor."""
        with self._lock:
            batch = list(self._waiting)
            self._waiting.clear()
            self._scheduled = False
        for function in batch:
            function()

    def close(self) -> None:
        """Refuse further functions and discard the waiting ones."""
        with self._lock:
            self._closed = True
            self._waiting.clear()
