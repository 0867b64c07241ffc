"""Child processes that the kernel ends when their parent dies, even if it is killed (Linux).

The request has to be made in the child, before its program begins. Between fork and exec would be the place, were
it not for the threads of a parent that runs ROS or rerun: a lock that one of them holds at the fork is never released
in the child. So the child first runs this file, which asks and then becomes the program.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Sequence


def bound_to_us(command: Sequence[str]) -> list[str]:
    """Command line that gets SIGTERM when the calling thread is gone; the same line where the kernel cannot do that.

    Raises
    ------
    FileNotFoundError
        If there is no such program, or it may not be run.
    """
    if shutil.which(command[0]) is None:
        raise FileNotFoundError(f"{command[0]} is no program that can be started")
    if not sys.platform.startswith("linux"):
        return list(command)
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]


def _become(parent: int, command: list[str]) -> None:
    import ctypes  # needed here only

    pr_set_pdeathsig = 1  # linux/prctl.h
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGTERM)
    if os.getppid() != parent:  # it died before we asked
        sys.exit(128 + signal.SIGTERM)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        signal.signal(number, signal.SIG_DFL)  # Python ignores them, and the program would, too
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"{command[0]} cannot be started: {error.strerror}")


if __name__ == "__main__":
    _become(int(sys.argv[1]), sys.argv[2:])
