"""Thread of the simulation, so that ROS callbacks are short. Does not depend on ROS."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.recorder_setup import RecorderSetup
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS

from servo_twin.lockstep.blocks import Blocks
from servo_twin.lockstep.twin import Pair, Twin

_CHUNK: Final = 16  # samples per check of the inbox
_QUEUE_MAX: Final = 1000  # waiting sample messages
_BACKLOG_MAX: Final = 3.0  # [s of board time]


@dataclass(frozen=True)
class WorkerFigures:
    """Statistics of the simulation."""

    samples: int  # processed samples of the real board
    backlog: float  # board time between the newest sample and the last one processed [s]
    load: float  # busy fraction of the thread since the last call of `TwinWorker.figures`
    overruns: int  # how often waiting samples were discarded because of the backlog


class TwinWorker:
    """Runs a twin in a separate thread; the inputs can be called from any thread.

    Parameters
    ----------
    twin : Twin
        Used exclusively by the thread after `start`.
    publish : callable
        Called by the thread with new pairs, or with an empty list if the status of the twin may have changed.
    failed : callable
        Called by the thread with an unexpected exception, which ends the thread.
    """

    def __init__(
        self,
        twin: Twin,
        publish: Callable[[list[Pair]], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._twin = twin
        self._publish = publish
        self._failed = failed
        self._inbox: deque[tuple[Callable[[], None], bool]] = deque()  # jobs; true: samples
        self._waiting_samples = 0
        self._condition = threading.Condition()
        self._stopping = False
        self._overrun = False
        self._overruns = 0
        self._samples = 0
        self._backlog = 0.0
        self._busy = 0.0
        self._last_look = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="twin", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float = 5.0) -> None:
        """Stop the thread and close the twin; waits at most `timeout` [s]."""
        with self._condition:
            self._stopping = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(timeout)

    # ---- from any thread
    def add_command(self, command: AppliedCommand) -> None:
        """Pass a command that took effect on the real board."""
        self._post(lambda: self._twin.add_command(command))

    def add_samples(self, columns: Sequence[str], table: NDArray[np.float64]) -> None:
        """Pass samples of the real board (samples, columns), SI; an invalid table sets the status of the twin."""
        self._post(lambda: self._take(columns, table), sample=True)

    def set_parameters(self, values: RawParameters) -> None:
        """Pass the parameters of the real board."""
        self._post(lambda: self._twin.set_parameters(values))

    def set_windings(self, temperatures: Sequence[float]) -> None:
        """Pass the winding temperatures of the real motors [deg C]."""
        self._post(lambda: self._twin.set_windings(temperatures))

    def set_recorder(self, setup: RecorderSetup | None) -> None:
        """Pass the set-up of the recorder of the real board; None: the recorder is idle."""
        self._post(lambda: self._twin.set_recorder(setup))

    def add_burst(self, label: str, points: Trace) -> None:
        """Pass a recording with ticks [SI]."""
        self._post(lambda: self._twin.add_burst(label, points))

    def set_blocks(self, blocks: Blocks) -> None:
        """Pass the configuration blocks of the real board."""
        self._post(lambda: self._twin.set_blocks(blocks))

    def resync(self, reason: str) -> None:
        """Request a new synchronisation."""
        self._post(lambda: self._twin.resync(reason))

    def figures(self) -> WorkerFigures:
        """Statistics; the load is the mean since the last call."""
        now = time.monotonic()
        busy, self._busy = self._busy, 0.0
        elapsed, self._last_look = now - self._last_look, now
        load = min(busy / elapsed, 1.0) if elapsed > 0.0 else 0.0
        return WorkerFigures(self._samples, self._backlog, load, self._overruns)

    def _post(self, job: Callable[[], None], *, sample: bool = False) -> None:
        """Queue a job. If too many samples wait, they are discarded; other jobs are not, as they are not repeated."""
        with self._condition:
            if sample and self._waiting_samples >= _QUEUE_MAX:
                self._inbox = deque(entry for entry in self._inbox if not entry[1])
                self._waiting_samples = 0
                self._overrun = True
            self._inbox.append((job, sample))
            self._waiting_samples += sample
            self._condition.notify()

    # ---- in the worker thread
    def _run(self) -> None:
        try:
            while True:
                with self._condition:
                    while not (self._inbox or self._stopping):
                        self._condition.wait()
                    if self._stopping:
                        break
                begun = time.monotonic()
                self._work()
                self._busy += time.monotonic() - begun
        except Exception as error:
            self._failed(error)
        finally:
            self._twin.close()

    def _work(self) -> None:
        """Process all jobs and samples; checks the inbox after every `_CHUNK` samples."""
        while not self._stopping:
            jobs, overrun = self._fetch()
            for job in jobs:
                job()
            self._measure()
            if overrun or self._backlog > _BACKLOG_MAX:
                self._overruns += 1
                self._twin.discard("the simulation is slower than the board")
            before = self._twin.tick
            pairs = self._twin.step(_CHUNK)
            self._measure()
            self._publish(pairs)
            if not jobs and self._twin.tick == before:
                return

    def _fetch(self) -> tuple[list[Callable[[], None]], bool]:
        with self._condition:
            jobs, overrun = [job for job, _ in self._inbox], self._overrun
            self._inbox.clear()
            self._waiting_samples = 0
            self._overrun = False
        return jobs, overrun

    def _measure(self) -> None:
        newest, done = self._twin.newest_tick, self._twin.tick
        behind = newest - done if newest is not None and done is not None else 0
        self._backlog = max(behind, 0) * PERIOD_NS * 1e-9

    def _take(self, columns: Sequence[str], table: NDArray[np.float64]) -> None:
        self._samples += len(table)
        try:
            self._twin.add_samples(columns, table)
        except ValueError as error:
            self._twin.resync(str(error))
