"""Passes function calls from the thread of the link to the thread of the executor."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Final

_BATCH: Final = 0.01
"""Longest time in which one batch begins further functions [s]; timers and topics come after it."""


class Inbox:
    """Calls functions in order in the thread of the executor.

    Waiting functions are called in batches, so that a fast link does not wake the executor for every sample.

    Parameters
    ----------
    call_soon : callable
        Schedules a function in the executor; may be called from any thread.
    call : callable, optional
        Calls a function under its name, such as `CallbackWatch.call`.
    clock : callable, optional
        Time [s].
    """

    def __init__(
        self,
        call_soon: Callable[[Callable[[], None]], object],
        call: Callable[[str, Callable[[], None]], None] = lambda _, function: function(),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._call_soon = call_soon
        self._call = call
        self._clock = clock
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
        """Call the functions that wait now, as far as the time of a batch permits; in the thread of the executor."""
        until = self._clock() + _BATCH
        with self._lock:
            count = len(self._waiting)
        while count:
            with self._lock:
                if not self._waiting:
                    break  # closed by a function
                function = self._waiting.popleft()
            count -= 1
            self._call(_name(function), function)
            if self._clock() >= until:
                break
        with self._lock:
            self._scheduled = bool(self._waiting)
        if self._scheduled:
            self._call_soon(self.drain)

    def close(self) -> None:
        """Refuse further functions and discard the waiting ones."""
        with self._lock:
            self._closed = True
            self._waiting.clear()


def _name(function: Callable[..., Any]) -> str:
    """Name of a posted function; `BoardContext.when_done` posts a partial of a function and its future."""
    while isinstance(function, partial):
        function = function.func
    return getattr(function, "__qualname__", repr(function))
