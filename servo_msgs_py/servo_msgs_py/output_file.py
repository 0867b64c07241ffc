"""Files that programs write: whole or not at all, with their name in every error."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any


@contextlib.contextmanager
def named(path: Path) -> Iterator[None]:
    """Context of the writing to a file: an `OSError` gets its name, which that of a full disk does not have."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def open_output(path: Path, mode: str, **options: Any) -> IO[Any]:
    """Open a file that is written in parts, like `open`; its folder is created.

    Raises
    ------
    OSError
        If it cannot be opened; with its name.
    """
    with named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open(mode, **options)


def check_output(path: Path, *, folder: bool = False) -> None:
    """Check without a change that `write_file` could write a file, or files in a folder; disks may fill up later.

    Raises
    ------
    OSError
        If it could not; with the name of the file or folder that is the obstacle.
    """
    target = Path(os.path.realpath(path))
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        target.lstat()  # such as a name that is too long
    if target.is_dir() and not folder:
        raise _refusal(errno.EISDIR, target)
    direct = folder or (target.exists() and not target.is_file())  # not a file, which is replaced: a device, a pipe
    place = next(part for part in ([target] if direct else []) + [*target.parents] if part.exists())
    if not place.is_dir() and (folder or place != target):
        raise _refusal(errno.ENOTDIR, place)
    if not os.access(place, os.W_OK):
        raise _refusal(errno.EACCES, place)


def _refusal(number: int, path: Path) -> OSError:
    return OSError(number, os.strerror(number), str(path))


def write_file(path: Path, content: str | bytes | Callable[[IO[bytes]], object]) -> None:
    """Write a whole file; an existing one is replaced when the new one is complete, or stays as it is.

    Parameters
    ----------
    path : Path
        Its folder is created. What is no regular file, such as a device or a pipe, or is below ``/dev``, is written to
        directly; a link stays a link.
    content : str or bytes or callable
        A text is encoded as UTF-8. A function gets a stream in memory: libraries behave unpredictably on a full disk.

    Raises
    ------
    OSError
        If the file cannot be written; with its name.
    """
    if callable(content):
        stream = BytesIO()
        content(stream)
        content = stream.getvalue()
    data = content.encode() if isinstance(content, str) else content
    with named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        target = Path(os.path.realpath(path))
        if path.absolute().is_relative_to("/dev") or (target.exists() and not target.is_file()):
            target.write_bytes(data)
            return
        temporary = target.with_name(f".{target.name[:100]}.{os.getpid()}")
        try:
            temporary.write_bytes(data)
            if target.exists():
                temporary.chmod(target.stat().st_mode & 0o7777)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
