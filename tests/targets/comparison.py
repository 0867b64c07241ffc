"""Replay expectations of the host on a target and find the first difference."""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from targets.calls import difference, parse_console
from targets.machines import Program, Target
from targets.recording import CHECK_PERIODS, Arithmetic, Recording
from targets.sources import Sources
from targets.toolchain import JOBS, TargetError

Expectation = Recording | Arithmetic


@dataclass(frozen=True)
class Report:
    """Result of a target."""

    target: Target  # the target
    digest: int | None  # digest over all expectations; None if a replay did not terminate normally
    expected: int  # digest of the host
    seconds: float  # sum of the run times [s]
    problems: tuple[str, ...]  # differences and failures; empty if the target agrees

    @property
    def agrees(self) -> bool:
        return not self.problems and self.digest == self.expected


@dataclass(frozen=True)
class _Run:
    expectation: Expectation
    digest: int | None
    seconds: float  # run time [s]
    problem: str | None


def combined(digests: Sequence[int]) -> int:
    """Digest of several digests."""
    return zlib.crc32(struct.pack(f"<{len(digests)}I", *digests))


def first_difference(program: Program, expected: Expectation) -> tuple[int, str | None]:
    """Run one expectation.

    Returns
    -------
    int
        The digest of the target.
    str or None
        The first difference in words; None if there is none.

    Raises
    ------
    TargetError
        If the program fails.
    ValueError
        If it does not terminate normally.
    """
    outcome = parse_console(program.run(expected.image))
    if (outcome.digest, outcome.checks) == (expected.digest, expected.checks):
        return outcome.digest, None
    pairs = zip(outcome.checks, expected.checks, strict=False)
    wrong = next((k for k, (here, there) in enumerate(pairs) if here != there), None)
    if isinstance(expected, Arithmetic):
        return outcome.digest, f"{expected.groups[wrong]}: other numbers" if wrong is not None else "other numbers"
    first = len(outcome.checks) * CHECK_PERIODS if wrong is None else wrong * CHECK_PERIODS
    return outcome.digest, _name_difference(program, expected, first, first + CHECK_PERIODS - 1)


def _name_difference(program: Program, recording: Recording, first: int, last: int) -> str:
    """Compare every call of the periods that contain the first difference."""
    calls = parse_console(program.run(recording.printing(first, last))).calls
    for call, recorded in zip(calls, recording.calls(first, last), strict=False):
        if (text := difference(call, recorded, recording.fields)) is not None:
            return text
    return f"between the periods {first} and {last}"


def check(
    targets: Sequence[Target], expected: Sequence[Expectation], sources: Sources, folder: Path
) -> Iterator[Report]:
    """Build and run targets, one job per processor; yield the reports in the order of the targets.

    Parameters
    ----------
    sources : Sources
        C sources of the targets and of the expectations.
    folder : Path
        Folder of the builds.
    """
    with ThreadPoolExecutor(JOBS) as pool:
        places = [folder / f"target{i}" for i in range(len(targets))]
        builds = list(pool.map(lambda target, place: _build(target, sources, place), targets, places))

        def length(job: tuple[int, int]) -> float:
            return targets[job[0]].weight * len(expected[job[1]].image)

        jobs = [(i, k) for i in range(len(targets)) for k in range(len(expected))]
        runs: dict[tuple[int, int], Future[_Run]] = {}
        for i, k in sorted(jobs, key=length, reverse=True):
            program = builds[i]
            if not isinstance(program, str):
                runs[i, k] = pool.submit(_run, program, expected[k])
        for i, target in enumerate(targets):
            problem = builds[i]
            if isinstance(problem, str):
                yield Report(target, None, combined([one.digest for one in expected]), 0.0, (problem,))
            else:
                yield _report(target, [runs[i, k].result() for k in range(len(expected))])


def _build(target: Target, sources: Sources, place: Path) -> Program | str:
    """Return the program, or the reason of a failed build."""
    place.mkdir(parents=True)
    try:
        return target.build(sources, place)
    except TargetError as error:
        return f"does not build: {error}"


def _run(program: Program, expected: Expectation) -> _Run:
    begin = time.monotonic()
    digest: int | None = None
    try:
        digest, text = first_difference(program, expected)
    except (TargetError, ValueError) as error:
        text = str(error)
    problem = None if text is None else f"{expected.name}: {text}"
    return _Run(expected, digest, time.monotonic() - begin, problem)


def _report(target: Target, runs: Sequence[_Run]) -> Report:
    digests = [run.digest for run in runs if run.digest is not None]
    return Report(
        target=target,
        digest=combined(digests) if len(digests) == len(runs) else None,
        expected=combined([run.expectation.digest for run in runs]),
        seconds=sum(run.seconds for run in runs),
        problems=tuple(run.problem for run in runs if run.problem is not None),
    )
