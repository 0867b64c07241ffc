"""Use of a path by one program at a time."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path


class ClaimError(ValueError):
    """Another program uses the path; the message has a remedy."""


@contextlib.contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Use a path alone among the programs of this computer that claim it.

    The claim is an abstract socket address of Linux: it needs no file, and it ends with the process however that ends.

    Parameters
    ----------
    path : Path
        What it names, and whether that exists, is of no importance; a link as the last part is not followed.

    Raises
    ------
    ClaimError
        If a living program has claimed it.
    """
    whole = os.path.join(os.path.realpath(path.parent), path.name)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
        try:
            claim.bind("\0servo-" + hashlib.sha256(os.fsencode(whole)).hexdigest())
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise ClaimError(f"{path} is used by another running program; end it, or choose another name") from None
        yield
