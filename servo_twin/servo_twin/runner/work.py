"""Interface of trials for a runner, and its errors."""

from __future__ import annotations

import traceback
from typing import Any, NamedTuple, Protocol, TypeVar

from servo_twin.board import SimulationError

ATTEMPTS = 3
"""Runs of a trial that end their worker before the trial is given up."""

Result_co = TypeVar("Result_co", covariant=True)


class Work(Protocol[Result_co]):
    """Numbered trials. The object and its results must be picklable."""

    def run(self, number: int) -> Result_co:
        """Result of a trial; depends on the work and the number only."""


class Answer(NamedTuple):
    """Answer of a worker."""

    number: int  # number of the trial
    value: Any  # result of the trial
    problem: str | None  # message of a `SimulationError`, or traceback of another exception; None: success

    def result(self) -> Any:
        """The result; raises `TrialError` if the trial failed."""
        if self.problem is not None:
            raise TrialError(f"trial {self.number}:\n{self.problem}")
        return self.value


def attempt(work: Work[Any], number: int) -> Answer:
    """Run a trial; exceptions are returned as text, because tracebacks cannot be pickled."""
    try:
        return Answer(number, work.run(number), None)
    except SimulationError as error:
        return Answer(number, None, str(error))
    except Exception:
        return Answer(number, None, traceback.format_exc())


class RunError(SimulationError):
    """A run cannot be continued; the results so far are valid."""


class TrialError(RunError):
    """A trial raised an exception; the message contains its number and the reason or traceback."""


class WorkerLostError(RunError):
    """A trial has repeatedly ended its worker."""
