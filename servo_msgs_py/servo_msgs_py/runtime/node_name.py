"""Names of the nodes that run on this machine."""

from __future__ import annotations

import socket


def claim(name: str, domain: int) -> socket.socket | None:
    """Reserve the name of a node in a ROS domain on this machine; None if another process has reserved it.

    The reservation is a socket in the abstract namespace of Linux, and lasts until it is closed; the system closes it
    when the process ends for any reason.

    Parameters
    ----------
    name : str
        Namespace and name, without the leading slash.
    domain : int
        ROS domain.
    """
    result = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        result.bind(f"\0ros/{domain}/{name}")
    except OSError:
        result.close()
        return None
    return result


def taken(name: str, domain: int) -> bool:
    """True if a process has reserved a name, see `claim`."""
    own = claim(name, domain)
    if own is not None:
        own.close()
    return own is None
