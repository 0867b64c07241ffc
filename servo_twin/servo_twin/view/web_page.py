"""The page of the rerun viewer, served on the loopback interface only, by the ``rerun`` command as a child."""

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
    """The page cannot be served; the text says why."""


def free_port(wanted: int, but: int | None = None) -> int:
    """First port from `wanted` on that is free.

    Parameters
    ----------
    wanted : int
        Where to begin.
    but : int, optional
        A port that is not to be taken although it may still be free.

    Raises
    ------
    WebPageError
        If there is none near.
    """
    for port in range(wanted, min(wanted + _PORTS_TRIED, 65536)):
        if port == but:
            continue
        with socket.socket() as probe, contextlib.suppress(OSError):
            # As servers do: a connection of the last run that still lingers is no obstacle.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((LOOPBACK, port))
            return port
    raise WebPageError(f"ports {wanted} .. {wanted + _PORTS_TRIED - 1} are all in use; choose others")


class WebPage:
    """The child that serves the page; ends with us even if we are killed.

    Parameters
    ----------
    port : int
        Free port for the page.
    data : str
        URI of the server that the page gets its data from.

    Raises
    ------
    WebPageError
        If it does not come up.
    """

    def __init__(self, port: int, data: str) -> None:
        self.url = f"http://{LOOPBACK}:{port}/?url={quote(data, safe='')}"
        command = [str(_command()), "--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(port), data]
        environment = {**os.environ, "RERUN_ANALYTICS": "false"}
        self._process = subprocess.Popen(
            with_parent_death_signal(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # Ctrl-C is for us; we end it when the data has been flushed
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
        """End the child."""
        if self._process.poll() is None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_TIMEOUT)
            self._process.kill()
        self._process.wait()


def _command() -> Path:
    """The ``rerun`` program itself: the script of that name is a wrapper in Python, one process more."""
    spec = importlib.util.find_spec("rerun_cli")
    places = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    places.append(Path(sys.executable).parent)
    for place in places:
        if (path := place / "rerun").is_file():
            return path
    if found := shutil.which("rerun"):
        return Path(found)
    raise WebPageError("there is no rerun command; install it with `pip install 'rerun-sdk==0.41.*'`")
