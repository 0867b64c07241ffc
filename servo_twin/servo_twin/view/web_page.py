"""Web page of the rerun viewer, served on the loopback interface only, by the ``rerun`` command as a child process."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Final
from urllib.parse import quote

from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal

LOOPBACK: Final = "127.0.0.1"
_PORTS_TRIED: Final = 32
_START_TIMEOUT: Final = 15.0  # [s]
_STOP_TIMEOUT: Final = 1.0
_POLL: Final = 0.05


class WebPageError(RuntimeError):
    """The page cannot be served; the message contains the reason."""


def free_port(first: int, exclude: int | None = None) -> int:
    """First free port from `first` on.

    Parameters
    ----------
    first : int
        First candidate.
    exclude : int, optional
        Port to skip.

    Raises
    ------
    WebPageError
        If the next ports are all in use.
    """
    for port in range(first, min(first + _PORTS_TRIED, 65536)):
        if port == exclude:
            continue
        with socket.socket() as probe, contextlib.suppress(OSError):
            # As servers do: ignore connections of the last run in TIME_WAIT.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((LOOPBACK, port))
            return port
    raise WebPageError(f"ports {first} .. {first + _PORTS_TRIED - 1} are all in use; choose others")


class WebPage:
    """Child process that serves the page; it ends with this process, even if that is killed.

    Parameters
    ----------
    port : int
        Free port for the page.
    data : str
        URI of the data server.

    Raises
    ------
    WebPageError
        If the server does not start.
    """

    def __init__(self, port: int, data: str) -> None:
        self.url = f"http://{LOOPBACK}:{port}/?url={quote(data, safe='')}"
        command = [str(rerun_binary()), "--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(port), data]
        environment = {**os.environ, "RERUN_ANALYTICS": "false"}
        self._process = subprocess.Popen(
            with_parent_death_signal(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # no SIGINT by Ctrl-C: `close` ends it after the data have been flushed
        )
        try:
            self._wait(port)
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def _wait(self, port: int) -> None:
        end = time.monotonic() + _START_TIMEOUT
        while True:
            if self._process.poll() is not None:
                raise WebPageError(f"the rerun command ended with status {self._process.returncode}")
            with socket.socket() as probe:
                probe.settimeout(_POLL)
                if probe.connect_ex((LOOPBACK, port)) == 0:
                    return
            if time.monotonic() > end:
                raise WebPageError(f"the rerun command did not serve port {port} within {_START_TIMEOUT:g} s")
            time.sleep(_POLL)

    def close(self) -> None:
        """Stop the child process."""
        if self._process.poll() is None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_TIMEOUT)
            self._process.kill()
        self._process.wait()


def rerun_binary() -> Path:
    """Path of the ``rerun`` binary.

    The script of that name is a wrapper with an additional process, which pip writes without quotes for its folder.
    """
    spec = importlib.util.find_spec("rerun_cli")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []
    folders.append(Path(sys.executable).parent)
    for folder in folders:
        if (path := folder / "rerun").is_file():
            return path
    if found := shutil.which("rerun"):
        return Path(found)
    raise WebPageError("no rerun command found; install it with `pip install 'rerun-sdk==0.41.*'`")
