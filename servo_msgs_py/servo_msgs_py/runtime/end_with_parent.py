"""Child processes that receive a signal when their parent process ends, even if it is killed (Linux).

The child process has to request the signal before it executes its program. Code between fork and exec is unsafe if the
parent has threads (ROS, rerun): a lock held by another thread at the fork is never released in the child. Therefore the
child first runs this file, which requests the signal and then executes the program.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Sequence


def with_parent_death_signal(command: Sequence[str]) -> list[str]:
    """Command line of a process that gets SIGTERM when the calling thread ends; unchanged if not on Linux.

    Raises
    ------
    FileNotFoundError
        If the program does not exist or is not executable.
    """
    if shutil.which(command[0]) is None:
        raise FileNotFoundError(f"{command[0]} is not an executable program")
    if not sys.platform.startswith("linux"):
        return list(command)
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]


def _execute(parent: int, command: list[str]) -> None:
    import ctypes  # needed here only

    pr_set_pdeathsig = 1  # linux/prctl.h
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGTERM)
    if os.getppid() != parent:  # the parent ended before the request
        sys.exit(128 + signal.SIGTERM)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        signal.signal(number, signal.SIG_DFL)  # Python ignores these signals, and the program would inherit that
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"{command[0]} cannot be started: {error.strerror}")


if __name__ == "__main__":
    _execute(int(sys.argv[1]), sys.argv[2:])
