"""Files for the rerun viewer; rerun is imported when one is written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from servo_msgs_py.output_file import write_file


class RecordingError(ValueError):
    """A recording cannot be written or read; the message contains reason and remedy."""


def import_rerun() -> ModuleType:
    """Import rerun.

    Raises
    ------
    RecordingError
        If rerun is not installed.
    """
    # No usage statistics: privacy, and delays on a machine without network.
    os.environ.setdefault("RERUN_ANALYTICS", "false")
    try:
        import rerun
    except ImportError as error:
        raise RecordingError(
            f"rerun cannot be imported ({error}); "
            "install it with `pip install 'rerun-sdk==0.41.*'` (Python 3.11 or newer)"
        ) from None
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
    RecordingError
        If rerun is not installed.
    OSError
        If the file cannot be written.
    """
    stream = import_rerun().RecordingStream(application, send_properties=False)
    data = stream.binary_stream()
    yield stream
    write_file(path, data.read() or b"")
