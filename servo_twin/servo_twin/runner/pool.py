"""Runs trials on processes of this machine. The trials of a worker that ends unexpectedly are repeated."""

from __future__ import annotations

import contextlib
import signal
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Final, TypeVar

from servo_twin.runner.work import ATTEMPTS, Answer, RunError, Work, WorkerLostError, attempt

Result = TypeVar("Result")

ASSIGNED_MAX: Final = 2
"""Assigned trials per worker: the current and the next one, so that it never waits."""

_CONTEXT: Final = get_context("spawn")  # a fork would copy locks of other threads


def _serve(pipe: Connection, work: Work[Result]) -> None:
    """Main loop of a worker: receives numbers and sends results until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is sent to the whole group; the parent stops its workers
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send(None)  # ready
        while True:
            pipe.send(attempt(work, pipe.recv()))


class _Worker:
    """A process and its assigned trial numbers, the current one first."""

    def __init__(self, work: Work[Result]) -> None:
        self.pipe, child_end = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_serve, args=(child_end, work), daemon=True)
        self.process.start()
        child_end.close()
        self.ready = False
        self.assigned: deque[int] = deque()

    def assign(self, number: int) -> None:
        self.assigned.append(number)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send(number)  # an ended worker is detected at its pipe

    def stop(self) -> None:
        self.pipe.close()
        self.process.kill()
        self.process.join()


class _Pool:
    def __init__(self, work: Work[Result], numbers: Iterable[int], workers: int) -> None:
        self._work = work
        self._numbers = iter(numbers)
        self._repeated: deque[int] = deque()
        self._deaths: Counter[int] = Counter()
        self.workers = [_Worker(work) for _ in range(workers)]

    def _next(self) -> int | None:
        return self._repeated.popleft() if self._repeated else next(self._numbers, None)

    def fill(self) -> bool:
        """Distribute numbers evenly; False if no trials remain."""
        for _ in range(ASSIGNED_MAX):
            for worker in self.workers:
                if len(worker.assigned) < ASSIGNED_MAX and (number := self._next()) is not None:
                    worker.assign(number)
        return any(worker.assigned for worker in self.workers)

    def replace(self, worker: _Worker) -> None:
        """Replace a worker that has ended."""
        worker.stop()
        if not worker.ready:
            raise RunError(f"a worker ended with exit status {worker.process.exitcode} before its first trial")
        if worker.assigned:
            suspect = worker.assigned[0]
            self._deaths[suspect] += 1
            if self._deaths[suspect] >= ATTEMPTS:
                raise WorkerLostError(
                    f"trial {suspect} has ended {ATTEMPTS} workers, the last one with exit status "
                    f"{worker.process.exitcode}; possible cause: not enough memory"
                )
            self._repeated.extend(worker.assigned)
        self.workers[self.workers.index(worker)] = _Worker(self._work)


def run_on_processes(work: Work[Result], numbers: Iterable[int], workers: int) -> Iterator[tuple[int, Result]]:
    """Yield numbers and results in the order of completion.

    Parameters
    ----------
    work : Work
        Trials to run.
    numbers : iterable of int
        Numbers of the trials, consumed one by one.
    workers : int
        Number of processes.

    Raises
    ------
    TrialError
        If a trial raises an exception.
    WorkerLostError
        If one trial ends `ATTEMPTS` workers.
    """
    pool = _Pool(work, numbers, workers)
    try:
        while pool.fill():
            by_pipe = {worker.pipe: worker for worker in pool.workers}
            for pipe in wait(list(by_pipe)):
                assert isinstance(pipe, Connection)
                worker = by_pipe[pipe]
                try:
                    answer: Answer | None = pipe.recv()
                except (EOFError, ConnectionResetError):
                    pool.replace(worker)
                    continue
                if answer is None:
                    worker.ready = True
                    continue
                worker.assigned.remove(answer.number)
                yield answer.number, answer.result()
    finally:
        for worker in pool.workers:
            worker.stop()
