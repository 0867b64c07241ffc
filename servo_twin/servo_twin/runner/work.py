"""What a runner runs, and how it may fail."""

from __future__ import annotations

from typing import Protocol, TypeVar

from servo_twin.board import SimulationError

__all__ = ["ATTEMPTS", "RunError", "TrialError", "Work", "WorkerLostError"]

ATTEMPTS = 3
"""A trial that was running when so many workers died is not tried again."""

Result_co = TypeVar("Result_co", covariant=True)


class Work(Protocol[Result_co]):
    """Numbered trials. The object itself and its results travel between processes and must be picklable."""

    def run(self, number: int) -> Result_co:
        """Result of a trial; follows from the work and the number alone."""


class RunError(SimulationError):
    """A run cannot go on; the results that have been handed out stay valid."""


class TrialError(RunError):
    """A trial raised an exception that is not one of its results; the text has its number and the traceback."""


class WorkerLostError(RunError):
    """A trial has ended every worker that tried it."""
