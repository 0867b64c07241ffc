"""What a runner runs, and how it may fail."""

from __future__ import annotations

import traceback
from typing import Any, NamedTuple, Protocol, TypeVar

from servo_twin.board import SimulationError

ATTEMPTS = 3
"""A trial that was running when so many workers died is not tried again."""

Result_co = TypeVar("Result_co", covariant=True)


class Work(Protocol[Result_co]):
    """Numbered trials. The object itself and its results travel between processes and must be picklable."""

    def run(self, number: int) -> Result_co:
        """Result of a trial; follows from the work and the number alone."""


class Answer(NamedTuple):
    """What a worker answers."""

    number: int  # of the trial
    value: Any  # its result
    problem: str | None  # why there is none: the message of a `SimulationError`, the traceback of another exception

    def result(self) -> Any:
        """The result; raises `TrialError` where there is none."""
        if self.problem is not None:
            raise TrialError(f"trial {self.number}:\n{self.problem}")
        return self.value


def attempt(work: Work[Any], number: int) -> Answer:
    """Run a trial; its exception travels as text, as tracebacks cannot be pickled. The reason of a board is enough."""
    try:
        return Answer(number, work.run(number), None)
    except SimulationError as error:
        return Answer(number, None, str(error))
    except Exception:
        return Answer(number, None, traceback.format_exc())


class RunError(SimulationError):
    """A run cannot go on; the results that have been handed out stay valid."""


class TrialError(RunError):
    """A trial raised an exception that is not one of its results; the text has its number and the traceback."""


class WorkerLostError(RunError):
    """A trial has ended every worker that tried it."""
