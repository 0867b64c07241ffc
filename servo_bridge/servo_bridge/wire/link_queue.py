"""Queue of jobs for the thread of the link: bounded, ordered, discarded at the loss of the link."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass, field
from typing import Any

from servo_bridge.wire.session import Session


class LinkDownError(ConnectionError):
    """There is no link, or it was lost before the end of the job."""


class LinkBusyError(RuntimeError):
    """The queue is full."""


@dataclass(eq=False)
class Job:
    """Work between two telemetry samples."""

    run: Callable[[Session], Any]  # the work, in the thread of the link
    write: bool = False  # writes precede reads
    done: Future[Any] = field(default_factory=Future)

    def execute(self, session: Session) -> None:
        """Run and complete the future; an exception of `run` is stored there and raised again."""
        if not self.done.set_running_or_notify_cancel():
            return
        try:
            result = self.run(session)
        except BaseException as error:
            self.fail(error)
            raise
        self.done.set_result(result)

    def fail(self, error: BaseException) -> None:
        """Complete the future with an error, unless it is done."""
        try:
            self.done.set_exception(error)
        except InvalidStateError:
            return


class JobQueue:
    """Jobs from any thread for one thread: urgent writes first, then writes, then reads.

    Parameters
    ----------
    limit : int
        Largest number of waiting jobs of each kind.
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
        """Accept jobs."""
        with self._condition:
            self._closed = None

    def close(self, reason: str) -> None:
        """Refuse jobs from now on and fail the waiting ones."""
        with self._condition:
            self._closed = reason
            waiting = [job for queue in self._queues for job in queue]
            for queue in self._queues:
                queue.clear()
        for job in waiting:
            job.fail(LinkDownError(reason))

    def put(self, job: Job, *, urgent: bool = False) -> None:
        """Queue a job; its future fails at once if the link is down or the queue is full.

        Parameters
        ----------
        job : Job
            The job.
        urgent : bool
            Executed before all jobs that are not urgent.
        """
        error: Exception | None = None
        with self._condition:
            queue = self._urgent if urgent else self._writes if job.write else self._reads
            if self._closed is not None:
                error = LinkDownError(self._closed)
            elif len(queue) >= self._limit:
                error = LinkBusyError(f"{len(queue)} jobs wait already; the line is too slow for these requests")
            else:
                queue.append(job)
                self._condition.notify()
        if error is not None:
            job.fail(error)

    def take(self, timeout: float) -> Job | None:
        """Remove the next job, waiting up to `timeout` [s]; `wake` ends the wait."""
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
