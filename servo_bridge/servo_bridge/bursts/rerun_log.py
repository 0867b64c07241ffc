"""Curves for the rerun viewer, used by recording files of bursts and by ``scope``.

rerun is imported at its first use: other functions work without it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.output_file import write_file

from servo_bridge.tool_values import UsageError

if TYPE_CHECKING:
    from types import ModuleType


class RerunMissingError(UsageError):
    """Rerun is not installed."""


def import_rerun(user: str) -> ModuleType:
    """Import rerun.

    Parameters
    ----------
    user : str
        Function that needs rerun, for the message.

    Raises
    ------
    RerunMissingError
        If it is not installed.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "false")  # prevents delays on a computer without a network
    try:
        import rerun
    except ImportError as error:
        raise RerunMissingError(f"{user} needs rerun ({error}): pip install 'rerun-sdk==0.41.*'") from None
    return rerun


@contextmanager
def recording_file(application: str, path: Path) -> Iterator[Any]:
    """Stream of a recording that is written to a file at the end.

    rerun would write it itself, but on a full disk its `flush` and the end of the program wait for ever.

    Parameters
    ----------
    application : str
        Name of the application in the file.
    path : Path
        File; an existing one is replaced.

    Raises
    ------
    RerunMissingError
        If rerun is not installed.
    OSError
        If the file cannot be written.
    """
    rr = import_rerun(f"{path.name}: a recording")
    stream = rr.RecordingStream(application, send_properties=False)
    data = stream.binary_stream()
    yield stream
    write_file(path, data.read() or b"")


def entity_of(parts: Sequence[str]) -> str:
    """Path of an entity; names of variables may contain any character."""
    import rerun

    return rerun.new_entity_path(list(parts))


def send_curve(stream: Any, entity: str, index: Any, values: NDArray[Any]) -> None:
    """Append points to a curve; NaN is a gap.

    Parameters
    ----------
    stream : rerun.RecordingStream
        Destination.
    entity : str
        Path of the curve.
    index : rerun.TimeColumn
        Times of the points.
    values : array, shape (n,)
        One per time.
    """
    import rerun

    columns = rerun.Scalars.columns(scalars=values.astype(np.float64))
    stream.send_columns(entity, indexes=[index], columns=columns)
