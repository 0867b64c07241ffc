"""A real pty with a fake device at its other end, and failures of a serial line."""

from __future__ import annotations

import os
import select
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol


class Device(Protocol):
    """Device at the other end of the line."""

    def feed(self, data: bytes) -> bytes: ...


class NoiseDevice:
    """Device that sends text and ignores its input."""

    noise = b"T=23.4 C ok\r\n"

    def feed(self, data: bytes) -> bytes:
        return b""


class FakePort:
    """Serves a device on a pty that a symbolic link points to.

    Parameters
    ----------
    link : Path
        Name of the port; removed by `unplug` and created by `plug`.
    baud : int, optional
        Line speed that delays the answers [bit/s]; default: no delay.
    """

    def __init__(self, link: Path, device: Device, baud: int | None = None) -> None:
        self.link = link
        self.device = device
        self.silent = False
        self.mangle: Callable[[bytes], bytes] = lambda answer: answer
        self._byte_time = 10.0 / baud if baud else 0.0
        self._wake_read, self._wake_write = os.pipe()
        self._master = self._slave = -1
        self._thread: threading.Thread | None = None

    @property
    def path(self) -> str:
        return str(self.link)

    def __enter__(self) -> FakePort:
        self.plug()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()
        os.close(self._wake_read)
        os.close(self._wake_write)

    def plug(self) -> None:
        """Create the port."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        fresh = self.link.with_suffix(".new")
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.rename(self.link)
        self._thread = threading.Thread(target=self._serve, name="fake port", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Remove the port; programs that have it open receive a hang-up."""
        if self._thread is None:
            return
        os.write(self._wake_write, b"x")
        self._thread.join(5.0)
        assert not self._thread.is_alive()
        os.read(self._wake_read, 1)
        self._thread = None
        self.link.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)

    def _serve(self) -> None:
        noise = getattr(self.device, "noise", b"")
        while True:
            ready, _, _ = select.select([self._master, self._wake_read], [], [], 0.02 if noise else None)
            if self._wake_read in ready:
                return
            if noise:
                os.write(self._master, noise)
            if self._master not in ready:
                continue
            data = os.read(self._master, 4096)
            start = time.monotonic()
            answer = self.device.feed(data)
            if self.silent:
                continue
            answer = self.mangle(answer)
            if self._byte_time:
                due = start + (len(data) + len(answer)) * self._byte_time
                time.sleep(max(0.0, due - time.monotonic()))
            if answer:
                os.write(self._master, answer)
