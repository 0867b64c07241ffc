"""Trials on processes of this machine. A worker that dies costs the trials that it had in hand; they are run again."""

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

IN_HAND: Final = 2
"""Numbers that a worker has got: the one that it is at, and the next one, so that it never waits."""

_CONTEXT: Final = get_context("spawn")  # a fork would copy locks of other threads


def _serve(pipe: Connection, work: Work[Result]) -> None:
    """Body of a worker: numbers in, results out, until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends its workers
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send(None)  # it has come so far
        while True:
            pipe.send(attempt(work, pipe.recv()))


class _Worker:
    """A process and the numbers that it has in hand, the one that it is at first."""

    def __init__(self, work: Work[Result]) -> None:
        self.pipe, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_serve, args=(theirs, work), daemon=True)
        self.process.start()
        theirs.close()
        self.ready = False
        self.in_hand: deque[int] = deque()

    def give(self, number: int) -> None:
        self.in_hand.append(number)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send(number)  # if it has died, the end of its pipe says so

    def stop(self) -> None:
        self.pipe.close()
        self.process.kill()
        self.process.join()


class _Pool:
    def __init__(self, work: Work[Result], numbers: Iterable[int], workers: int) -> None:
        self._work = work
        self._numbers = iter(numbers)
        self._again: deque[int] = deque()
        self._deaths: Counter[int] = Counter()
        self.workers = [_Worker(work) for _ in range(workers)]

    def _next(self) -> int | None:
        return self._again.popleft() if self._again else next(self._numbers, None)

    def fill(self) -> bool:
        """Hand out numbers evenly; False when nothing is left to wait for."""
        for _ in range(IN_HAND):
            for worker in self.workers:
                if len(worker.in_hand) < IN_HAND and (number := self._next()) is not None:
                    worker.give(number)
        return any(worker.in_hand for worker in self.workers)

    def replace(self, worker: _Worker) -> None:
        """Another worker for one that has died."""
        worker.stop()
        if not worker.ready:
            raise RunError(f"a worker ended with exit status {worker.process.exitcode} before its first trial")
        if worker.in_hand:
            suspect = worker.in_hand[0]
            self._deaths[suspect] += 1
            if self._deaths[suspect] >= ATTEMPTS:
                raise WorkerLostError(
                    f"trial {suspect} has ended {ATTEMPTS} workers, the last one with exit status "
                    f"{worker.process.exitcode}: does it need more memory than there is?"
                )
            self._again.extend(worker.in_hand)
        self.workers[self.workers.index(worker)] = _Worker(self._work)


def run_on_processes(work: Work[Result], numbers: Iterable[int], workers: int) -> Iterator[tuple[int, Result]]:
    """Results as they come, each with its number.

    Parameters
    ----------
    work : Work
        What to run.
    numbers : iterable of int
        Which trials; taken one by one, so there may be any number of them.
    workers : int
        Processes.

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
                worker.in_hand.remove(answer.number)
                yield answer.number, answer.result()
    finally:
        for worker in pool.workers:
            worker.stop()
