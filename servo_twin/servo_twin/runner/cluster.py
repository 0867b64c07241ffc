"""Runs trials on a Dask cluster; servo_twin must be installed on its workers."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, Final, TypeVar

from servo_twin.runner.work import Answer, RunError, Work, WorkerLostError, attempt

Result = TypeVar("Result")

CHUNK_TIME: Final = 0.5  # target of the computing time per chunk [s]
CHUNK_MAX: Final = 1000
AHEAD: Final = 3  # submitted chunks per thread of the cluster
CONNECT_TIME: Final = 10.0  # [s]


def _run_chunk(work: Work[Any], numbers: Sequence[int]) -> tuple[float, list[Answer]]:
    """Executed on a worker: returns the computing time [s] and the answers."""
    begin = time.perf_counter()
    answers = [attempt(work, number) for number in numbers]
    return time.perf_counter() - begin, answers


def run_on_cluster(work: Work[Result], numbers: Iterable[int], address: str) -> Iterator[tuple[int, Result]]:
    """Yield numbers and results in the order of completion.

    If a worker ends, the scheduler gives its chunks to another one.

    Parameters
    ----------
    work : Work
        Trials to run.
    numbers : iterable of int
        Numbers of the trials.
    address : str
        Address of the scheduler, such as ``tcp://host:8786``.

    Raises
    ------
    RunError
        If the scheduler cannot be reached, or Dask is not installed.
    TrialError
        If a trial raises an exception.
    WorkerLostError
        If trials repeatedly end their workers.
    """
    try:
        distributed: Any = importlib.import_module("distributed")  # incomplete type hints
    except ImportError:
        raise RunError("a cluster needs Dask: `make extras`, or pip install 'servo_twin[cluster]'") from None
    try:
        client = distributed.Client(address, timeout=CONNECT_TIME, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise RunError(f"no Dask scheduler at {address}: {error}") from None
    remaining = iter(numbers)
    size = 1
    with client:

        def submit() -> Any:
            chunk = list(islice(remaining, size))
            return client.submit(_run_chunk, work, chunk, pure=False) if chunk else None

        futures = distributed.as_completed([], loop=client.loop)
        threads = max(sum(client.nthreads().values()), 1)
        for future in filter(None, [submit() for _ in range(AHEAD * threads)]):
            futures.add(future)
        for future in futures:
            try:
                seconds, answers = future.result()
            except distributed.KilledWorker as error:
                raise WorkerLostError(f"trials repeatedly end their workers: {error}") from None
            if (following := submit()) is not None:
                futures.add(following)
            size = min(max(round(len(answers) * CHUNK_TIME / max(seconds, 1e-6)), 1), CHUNK_MAX)
            for answer in answers:
                yield answer.number, answer.result()
