"""Jobs that wait for the link's thread: bounded, ordered, and thrown away when the link is lost. Pure."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass, field
from typing import Any

from servo_bridge.freemaster.client import Client


class LinkDownError(ConnectionError):
    """There is no link, or it was lost before the job was done."""


class LinkBusyError(RuntimeError):
    """More jobs wait than the queue takes."""


@dataclass(eq=False)
class Job:
    """Something to do between two telemetry samples."""

    run: Callable[[Client], Any]  # the work, in the thread of the link
    key: str = ""  # variable and elements that it writes; it is replaced by a later ``latest_wins`` job of the same key
    write: bool = False  # writes go before reads
    retried: bool = True  # whether its unanswered requests are repeated, so that its failure means a lost link
    done: Future[Any] = field(default_factory=Future)

    def execute(self, client: Client) -> None:
        """Run and complete the future; whatever `run` raises ends up there and is raised again."""
        if not self.done.set_running_or_notify_cancel():
            return
        try:
            result = self.run(client)
        except BaseException as error:
            self.fail(error)
            raise
        self.done.set_result(result)

    def fail(self, error: BaseException) -> None:
        """Complete the future with an error, unless it is complete."""
        try:
            self.done.set_exception(error)
        except InvalidStateError:
            return


class JobQueue:
    """Jobs for one thread from any thread: urgent writes first, then writes, then reads.

    Parameters
    ----------
    limit : int
        Most jobs of each kind that may wait.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._condition = threading.Condition()
        self._urgent: deque[Job] = deque()
        self._writes: deque[Job] = deque()
        self._reads: deque[Job] = deque()
        self._closed: str | None = "not connected"

    def __len__(self) -> int:
        with self._condition:
            return sum(map(len, self._queues))

    @property
    def _queues(self) -> tuple[deque[Job], deque[Job], deque[Job]]:
        return self._urgent, self._writes, self._reads

    def open(self) -> None:
        """Take jobs."""
        with self._condition:
            self._closed = None

    def close(self, reason: str) -> None:
        """Take no more jobs and fail those that wait."""
        with self._condition:
            self._closed = reason
            waiting = [job for queue in self._queues for job in queue]
            for queue in self._queues:
                queue.clear()
        for job in waiting:
            job.fail(LinkDownError(reason))

    def put(self, job: Job, *, urgent: bool = False, latest_wins: bool = False) -> None:
        """Queue a job; its future fails at once when the link is down or the queue is full.

        Parameters
        ----------
        job : Job
            What to do.
        urgent : bool
            Before every job that is not urgent.
        latest_wins : bool
            Cancel a waiting job of the same kind and key; the new one goes to the end, behind what was queued since.
        """
        replaced: list[Job] = []
        error: Exception | None = None
        with self._condition:
            queue = self._urgent if urgent else self._writes if job.write else self._reads
            if latest_wins:
                replaced = [old for old in queue if old.key == job.key]
                for old in replaced:
                    queue.remove(old)
            if self._closed is not None:
                error = LinkDownError(self._closed)
            elif len(queue) >= self._limit:
                error = LinkBusyError(f"{len(queue)} jobs wait already; the line is too slow for these requests")
            else:
                queue.append(job)
                self._condition.notify()
        for old in replaced:
            old.done.cancel()
        if error is not None:
            job.fail(error)

    def drop_writes(self) -> int:
        """Cancel all waiting writes that are not urgent; returns how many."""
        with self._condition:
            dropped = list(self._writes)
            self._writes.clear()
        for job in dropped:
            job.done.cancel()
        return len(dropped)

    def take(self, timeout: float) -> Job | None:
        """Take the next job, waiting up to `timeout` [s] for one; `wake` ends the wait."""
        with self._condition:
            if timeout > 0.0 and not any(self._queues):
                self._condition.wait(timeout)
            for queue in self._queues:
                if queue:
                    return queue.popleft()
            return None

    def wake(self) -> None:
        """End a waiting `take`."""
        with self._condition:
            self._condition.notify_all()
