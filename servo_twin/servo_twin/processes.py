"""Child processes that end with their parent: each with a log file, stopped in order and in bounded time."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.notify import SOCKET

_POLL: Final = 0.05  # [s]
_TERM_TIMEOUT: Final = 8.0  # from SIGTERM to SIGKILL [s]
_DATAGRAM_MAX: Final = 4096  # [bytes]
_LAST_OUTPUT: Final = 1 << 14  # [bytes]


class ChildError(RuntimeError):
    """A child process could not be started or has ended unexpectedly; the message contains its last output."""


def executable(name: str) -> Path:
    """Path of a program: in a sourced workspace, next to the running Python, or on the search path.

    The order is the import order of Python, in which a sourced workspace also precedes the environment.

    Raises
    ------
    ChildError
        If the program is not installed.
    """
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    installed = (path for prefix in prefixes for path in sorted(Path(prefix).glob(f"lib/*/{name}")))
    for path in (*installed, Path(sys.executable).with_name(name)):
        if os.access(path, os.X_OK):
            return path
    on_path = shutil.which(name)
    if on_path is None:
        raise ChildError(
            f"{name} is not installed, neither in a sourced workspace nor next to {sys.executable}: run `make setup`, "
            "or source install/setup.bash of the workspace"
        )
    return Path(on_path)


class Child:
    """A process in its own process group, with its output in a log file; its notices (`notify`) are received.

    Parameters
    ----------
    name : str
        Name in messages.
    command : sequence of str
        Program and arguments.
    log : Path
        File for the output.
    environment : mapping
        Complete environment of the child.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path, environment: Mapping[str, str]) -> None:
        self.name = name
        self.log = log
        self.ready = False  # whether it has reported so
        self._notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notices.setblocking(False)
        self._notices.bind(b"")  # Linux chooses an unused abstract address
        address = "@" + self._notices.getsockname()[1:].decode()
        with log.open("wb") as output:
            try:
                self._process = subprocess.Popen(
                    with_parent_death_signal(command),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    env={**environment, SOCKET: address},
                    start_new_session=True,
                )
            except OSError as error:
                raise ChildError(f"{name} cannot be started: {error}") from error

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    @property
    def exit_status(self) -> int | None:
        return self._process.poll()

    def notices(self) -> list[str]:
        """Texts that the process has sent since the last call."""
        texts: list[str] = []
        with contextlib.suppress(BlockingIOError):
            while True:
                lines = self._notices.recv(_DATAGRAM_MAX).decode("utf-8", "replace").splitlines()
                self.ready = self.ready or "READY=1" in lines
                texts += [line.removeprefix("STATUS=") for line in lines if line.startswith("STATUS=")]
        return texts

    def text(self) -> str:
        """Complete output."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def last_output(self, lines: int = 12) -> str:
        """Last lines of the output, indented."""
        with self.log.open("rb") as file:
            file.seek(max(os.fstat(file.fileno()).st_size - _LAST_OUTPUT, 0))
            text = file.read(_LAST_OUTPUT).decode("utf-8", "replace")
        return "\n".join("    " + line for line in text.splitlines()[-lines:])

    def check(self) -> None:
        """Raise `ChildError` if the process has ended."""
        if not self.running:
            raise ChildError(
                f"{self.name} has ended with status {self.exit_status}; last output ({self.log}):\n{self.last_output()}"
            )

    def terminate(self) -> None:
        """Send SIGTERM."""
        if self.running:
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL to the process group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def stop(self, timeout: float = _TERM_TIMEOUT) -> bool:
        """Stop the process within `timeout` [s]; False if it had to be killed."""
        self.terminate()
        try:
            self._process.wait(timeout)
            orderly = True
        except subprocess.TimeoutExpired:
            orderly = False
        self.kill()
        self._process.wait()
        self._notices.close()
        return orderly


def stop_all(children: Sequence[Child]) -> list[str]:
    """Stop the children in this order, each in bounded time; returns the names of killed processes."""
    return [child.name for child in children if not child.stop()]


def wait_until(condition: Callable[[], bool], children: Sequence[Child], timeout: float) -> bool:
    """Wait for a condition while all children run; False after the timeout [s].

    Raises
    ------
    ChildError
        If a child ends during the wait.
    """
    for _ in _ticks(timeout):
        if condition():
            return True
        for child in children:
            child.check()
    return condition()


def _ticks(timeout: float) -> Iterator[None]:
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        yield
        time.sleep(_POLL)
