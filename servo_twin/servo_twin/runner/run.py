"""Runs trials on this machine or on a cluster, with a progress bar."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from servo_msgs_py.output_file import write_file
from tqdm import tqdm

from servo_msgs_py import argument
from servo_twin.runner.cluster import run_on_cluster
from servo_twin.runner.pool import run_on_processes
from servo_twin.runner.work import Work, attempt

Result = TypeVar("Result")


@dataclass(frozen=True)
class Runner:
    """Selection of the machine for trials."""

    workers: int | None = None  # processes on this machine; None: one per usable core; 1: run in this process
    scheduler: str | None = None  # address of a Dask scheduler, used instead of processes

    @staticmethod
    def add_options(parser: argparse.ArgumentParser) -> None:
        """Add the common options of commands that run many boards."""
        group = parser.add_mutually_exclusive_group()
        group.add_argument("--workers", type=argument.count, metavar="N", help="processes (default: one per core)")
        group.add_argument(
            "--scheduler", metavar="URL", help="run on the Dask cluster of this scheduler, such as tcp://HOST:PORT"
        )

    @classmethod
    def of(cls, args: argparse.Namespace) -> Runner:
        """Create from parsed options."""
        return cls(args.workers, args.scheduler)

    def run(self, work: Work[Result], numbers: Sequence[int], label: str) -> Generator[tuple[int, Result], None, None]:
        """Yield numbers and results in the order of completion; closing the generator ends the run.

        Parameters
        ----------
        work : Work
            Trials to run.
        numbers : sequence of int
            Numbers of the trials.
        label : str
            Label of the progress bar on standard error, which is shown on a terminal only.

        Raises
        ------
        RunError
            If the run cannot be continued.
        """
        with (
            contextlib.closing(self._results(work, numbers)) as results,
            tqdm(total=len(numbers), desc=label, unit="", disable=None, smoothing=0.1) as bar,
        ):
            for result in results:
                yield result
                bar.update()

    def _results(self, work: Work[Result], numbers: Sequence[int]) -> Generator[tuple[int, Result], None, None]:
        if self.scheduler is not None:
            yield from run_on_cluster(work, numbers, self.scheduler)
            return
        workers = min(self.workers or len(os.sched_getaffinity(0)), len(numbers))
        yield from run_here(work, numbers) if workers <= 1 else run_on_processes(work, numbers, workers)


HERE: Final = Runner()
"""All cores of this machine."""


def run_here(work: Work[Result], numbers: Iterable[int]) -> Iterator[tuple[int, Result]]:
    """Run trials sequentially in this process."""
    for number in numbers:
        yield number, attempt(work, number).result()


def run_in_order(
    runner: Runner,
    work: Work[Result],
    numbers: Sequence[int],
    label: str,
    line_of: Callable[[Result], str] | None = None,
) -> list[Result]:
    """All results, in the order of the numbers.

    Parameters
    ----------
    runner, work, numbers, label
        As of `Runner.run`.
    line_of : callable, optional
        Text of a result, written to standard error as soon as there is one: a run that is ended has left these.
    """
    results = {}
    for number, result in runner.run(work, numbers, label):
        results[number] = result
        if line_of is not None:
            tqdm.write(f"{len(results)}/{len(numbers)}  {line_of(result)}", file=sys.stderr)
    return [results[number] for number in numbers]


def run_to_file(
    runner: Runner,
    work: Work[Result],
    count: int,
    label: str,
    path: Path,
    entry_of: Callable[[int, Result], Mapping[str, object]],
) -> tuple[list[tuple[int, Result]], str]:
    """Run the first trials; a JSON file has the finished ones after each of them.

    Parameters
    ----------
    runner, work, label
        As of `Runner.run`.
    count : int
        Number of trials.
    path : Path
        The file; its folder is created.
    entry_of : callable
        Entry of the file for a trial, from its number and result.

    Returns
    -------
    tuple
        Numbers and results in the order of the numbers, and the text of the file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    found: list[tuple[int, Result]] = []
    text = ""
    for one in runner.run(work, range(count), label):
        found = sorted([*found, one], key=lambda pair: pair[0])
        text = json.dumps([entry_of(*pair) for pair in found], indent=2, default=float) + "\n"
        write_file(path, text)
    return found, text
