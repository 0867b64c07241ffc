"""What has become of a job of the link. Pure."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any


def error_of(job: Future[Any]) -> str | None:
    """Why a job has no result, None when it has one; never waits."""
    if not job.done():
        return "it is not done yet"
    if job.cancelled():
        return "it was cancelled"
    error = job.exception()
    return None if error is None else str(error) or type(error).__name__
