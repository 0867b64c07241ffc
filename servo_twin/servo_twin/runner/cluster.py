"""Trials on a Dask cluster, whose workers have servo_twin installed."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, Final, TypeVar

from servo_twin.runner.work import Answer, RunError, Work, WorkerLostError, attempt

Result = TypeVar("Result")

CHUNK_TIME: Final = 0.5  # of the trials that a worker gets at once, as far as that is known before [s]
CHUNK_MAX: Final = 1000
AHEAD: Final = 3  # chunks per thread of the cluster that have been handed out
CONNECT_TIME: Final = 10.0  # [s]


def _run_chunk(work: Work[Any], numbers: Sequence[int]) -> tuple[float, list[Answer]]:
    """Runs on a worker: seconds that it took, and the answers."""
    begin = time.perf_counter()
    answers = [attempt(work, number) for number in numbers]
    return time.perf_counter() - begin, answers


def run_on_cluster(work: Work[Result], numbers: Iterable[int], address: str) -> Iterator[tuple[int, Result]]:
    """Results as they come, each with its number.

    A worker that dies costs what it had in hand: the scheduler gives that to another one.

    Parameters
    ----------
    work : Work
        What to run.
    numbers : iterable of int
        Which trials.
    address : str
        Of the scheduler, as ``tcp://host:8786``.

    Raises
    ------
    RunError
        If there is no such scheduler, or Dask is not installed.
    TrialError
        If a trial raises an exception.
    WorkerLostError
        If some trials end one worker after the other.
    """
    try:
        distributed: Any = importlib.import_module("distributed")  # its types are not complete
    except ImportError:
        raise RunError("a cluster needs Dask: pip install 'servo_twin[cluster]'") from None
    try:
        client = distributed.Client(address, timeout=CONNECT_TIME, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise RunError(f"no Dask scheduler answers at {address}: {error}") from None
    waiting = iter(numbers)
    size = 1
    with client:

        def submit() -> Any:
            chunk = list(islice(waiting, size))
            return client.submit(_run_chunk, work, chunk, pure=False) if chunk else None

        futures = distributed.as_completed([], loop=client.loop)
        threads = max(sum(client.nthreads().values()), 1)
        for future in filter(None, [submit() for _ in range(AHEAD * threads)]):
            futures.add(future)
        for future in futures:
            try:
                seconds, answers = future.result()
            except distributed.KilledWorker as error:
                raise WorkerLostError(f"trials end the workers that try them: {error}") from None
            if (following := submit()) is not None:
                futures.add(following)
            size = min(max(round(len(answers) * CHUNK_TIME / max(seconds, 1e-6)), 1), CHUNK_MAX)
            for answer in answers:
                yield answer.number, answer.result()
