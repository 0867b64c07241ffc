"""Durations of the callbacks of an executor, and whether it still runs them."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

HANG: Final = 1.0
"""An executor without a sign of life for this time counts as hanging [s]."""


@dataclass(frozen=True)
class CallbackTime:
    """Duration of one call."""

    name: str = "none"  # of the callback
    wall: float = 0.0  # duration [s]
    cpu: float = 0.0  # processor time of the thread [s]

    def __str__(self) -> str:
        return f"{self.name}: {self.wall * 1e3:.1f} ms ({self.cpu * 1e3:.1f} ms of the processor)"


@dataclass(frozen=True)
class CallbackReport:
    """Longest callbacks and pauses."""

    last: CallbackTime  # longest since the previous report
    ever: CallbackTime  # longest since the start
    pause_last: float  # longest time without a sign of life since the previous report [s]
    pause_ever: float  # the same since the start [s]


class CallbackWatch:
    """Measures the callbacks of one executor; `hang` may be called by any thread, all else by that of the executor.

    Parameters
    ----------
    clock, cpu_clock : callable
        Time of the host, and processor time of the thread [s].
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, cpu_clock: Callable[[], float] = time.thread_time
    ) -> None:
        self._clock, self._cpu_clock = clock, cpu_clock
        self._lock = threading.Lock()
        self._running: tuple[str, float] | None = None  # name and begin [s] of the outermost callback
        self._sign = clock()  # last sign of life [s]
        self._last = CallbackTime()
        self._longest: dict[str, CallbackTime] = {}  # since the start, by name
        self._pause_last = self._pause_ever = 0.0

    def begin(self) -> None:
        """Expect signs of life from now on, and measure their pauses."""
        self._sign = self._clock()
        self._pause_last = self._pause_ever = 0.0

    def timed(self, name: str, function: Callable[P, T]) -> Callable[P, T]:
        """Return the function with its durations measured under a name."""

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            return self.call(name, function, *args, **kwargs)

        return call

    def call(self, name: str, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a function and measure its duration."""
        begin, cpu = self._clock(), self._cpu_clock()
        outermost = self._running is None
        if outermost:
            self._live(begin)
            self._running = name, begin
        try:
            return function(*args, **kwargs)
        finally:
            end = self._clock()
            taken = CallbackTime(name, end - begin, self._cpu_clock() - cpu)
            with self._lock:
                self._last = max(self._last, taken, key=_wall)
                self._longest[name] = max(self._longest.get(name, taken), taken, key=_wall)
            if outermost:
                self._running = None
                self._live(end)

    def sign_of_life(self) -> None:
        """Note that the executor runs; called periodically by a timer."""
        self._live(self._clock())

    def hang(self) -> str:
        """What the executor hangs in, if it has given no sign of life for `HANG`; else empty."""
        silent = self._clock() - self._sign
        if silent <= HANG:
            return ""
        running = self._running
        what = "no callback has begun" if running is None else f"{running[0]} has been running"
        return f"{what} for {silent:.1f} s in the thread of the executor"

    def report(self) -> CallbackReport:
        """Return the longest times and begin a new period."""
        with self._lock:
            ever = max(self._longest.values(), default=CallbackTime(), key=_wall)
            report = CallbackReport(self._last, ever, self._pause_last, self._pause_ever)
            self._last, self._pause_last = CallbackTime(), 0.0
        return report

    def longest(self) -> dict[str, CallbackTime]:
        """Return the longest call of every callback since the start, by name."""
        with self._lock:
            return dict(self._longest)

    def _live(self, now: float) -> None:
        pause, self._sign = now - self._sign, now
        self._pause_last, self._pause_ever = max(self._pause_last, pause), max(self._pause_ever, pause)


def _wall(taken: CallbackTime) -> float:
    return taken.wall
