"""Results of services, and errors of futures."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

Outcome = tuple[bool, str]
"""Success and message, the two fields of SetBool and Trigger responses."""


def answered(success: bool, message: str) -> Future[Outcome]:
    """Future with a result."""
    future: Future[Outcome] = Future()
    future.set_result((success, message))
    return future


def error_of(job: Future[Any]) -> str | None:
    """Reason why a job has no result, None if it has one; does not wait."""
    if not job.done():
        return "it is not done yet"
    if job.cancelled():
        return "it was cancelled"
    error = job.exception()
    return None if error is None else str(error) or type(error).__name__
