"""Serial port as the byte transport of the FreeMASTER client.

All pyserial URLs are supported: ``/dev/ttyUSB0``, a pty, ``socket://host:port``, ``loop://``. File descriptors are read
with poll(2) and absolute deadlines; pyserial would configure the terminal again for every other timeout.
"""

from __future__ import annotations

import contextlib
import errno
import grp
import os
import pwd
import select
import stat
import termios
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import serial
from serial.tools import list_ports

from servo_bridge.freemaster.errors import TransportError

_CHUNK: Final = 4096
_WRITE_LIMIT_NS: Final = 1_000_000_000
_SYS_TTY: Final = Path("/sys/class/tty")
_PSEUDO_TERMINALS: Final = "/dev/pts/"
_LINK_TOLERANCE: Final = 2.0  # tolerance of the time stamps of two file systems [s]


class PortError(TransportError):
    """The port cannot be opened."""

    def __init__(self, reason: str, remedy: str, *, missing: bool = False) -> None:
        super().__init__(f"{reason}; {remedy}")
        self.reason = reason  # one line
        self.remedy = remedy  # action of the user
        self.missing = missing  # no device yet; it may appear later


@dataclass(frozen=True)
class LowLatency:
    """Whether the adapter passes bytes on immediately."""

    enabled: bool | None  # None: not supported by the port
    text: str  # description


class SerialPort:
    """Open serial port.

    Parameters
    ----------
    url : str
        Device path or pyserial URL.
    baud : int
        Line speed [bit/s].

    Raises
    ------
    PortError
        If the port cannot be opened.
    """

    def __init__(self, url: str, baud: int) -> None:
        self.url = url
        _refuse_stale_link(url)
        try:
            self._serial: Any = serial.serial_for_url(
                url, baudrate=baud, timeout=0, write_timeout=_WRITE_LIMIT_NS * 1e-9, exclusive=True
            )
        except (OSError, ValueError, termios.error) as error:
            raise _explain(url, baud, error) from error
        self.low_latency = _set_low_latency(self._serial, url)
        self._fd = _descriptor(self._serial, url)
        self._poll = select.poll()
        if self._fd is not None:
            os.set_blocking(self._fd, False)
            self._poll.register(self._fd, select.POLLIN)

    def __enter__(self) -> SerialPort:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the port; repeated calls are permitted."""
        self._fd = None
        with contextlib.suppress(OSError, termios.error):  # the device is already removed
            self._serial.close()

    def write(self, data: bytes) -> None:
        """Write all bytes to the port.

        Raises
        ------
        TransportError
            If the port is lost or accepts no bytes for a second.
        """
        if self._fd is None:
            self._call(self._serial.write, data)
            return
        deadline = time.monotonic_ns() + _WRITE_LIMIT_NS
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._fd, view) :]
            except BlockingIOError:
                if time.monotonic_ns() >= deadline:
                    raise TransportError(f"{self.url} accepts no more bytes") from None
                self._wait_for_room(self._fd, deadline)
            except OSError as error:
                raise self._lost(error) from error

    def read(self, deadline: int) -> bytes:
        """Return received bytes as soon as possible, or nothing after `deadline` (monotonic ns).

        Raises
        ------
        TransportError
            If the port is lost.
        """
        if self._fd is None:
            return self._read_slowly(deadline)
        while True:
            remaining = max(0, deadline - time.monotonic_ns())
            ready = self._poll.poll(-(-remaining // 1_000_000))
            if not ready:
                return b""
            if ready[0][1] & select.POLLIN:
                try:
                    data = os.read(self._fd, _CHUNK)
                except BlockingIOError:
                    continue
                except OSError as error:
                    raise self._lost(error) from error
                if data:
                    return data
            raise self._lost(None)

    def _wait_for_room(self, descriptor: int, deadline: int) -> None:
        room = select.poll()
        room.register(descriptor, select.POLLOUT)
        room.poll(max(0, deadline - time.monotonic_ns()) // 1_000_000 + 1)

    def _read_slowly(self, deadline: int) -> bytes:
        """Read from a port without a file descriptor."""
        remaining = max(0, deadline - time.monotonic_ns()) * 1e-9

        def read() -> bytes:
            self._serial.timeout = remaining
            data: bytes = self._serial.read(max(1, min(self._serial.in_waiting, _CHUNK)))
            return data

        result: bytes = self._call(read)
        return result

    def _call(self, function: Any, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except (OSError, termios.error) as error:
            raise self._lost(error) from error

    def _lost(self, error: BaseException | None) -> TransportError:
        detail = f" ({error})" if error is not None else ""
        return TransportError(f"the port {self.url} is lost{detail}")


def _refuse_stale_link(url: str) -> None:
    """Refuse a stale symbolic link to a pseudo terminal, whose number may have been reused by another program.

    A virtual board that was killed leaves its link. All time stamps of a pseudo terminal start at its creation;
    reading, writing and changes of its mode advance them. A link that is older than all of them is stale; in a chain of
    links the last one is checked.
    """
    try:
        link = _last_link(url)
        if link is None or not os.path.realpath(link).startswith(_PSEUDO_TERMINALS):
            return
        terminal, made = os.stat(link), os.lstat(link).st_mtime
    except (OSError, ValueError):
        return  # reported when the port is opened
    if min(terminal.st_atime, terminal.st_mtime, terminal.st_ctime) > made + _LINK_TOLERANCE:
        raise PortError(
            f"the link {link} is older than its terminal: the program that created it has ended",
            f"start the virtual board again, create the link again, or use {os.path.realpath(link)}",
            missing=True,
        )


def _last_link(path: str) -> str | None:
    """Last link of a chain of links; None if the path is not a link."""
    os.stat(path)  # OSError for circular links
    link = None
    while os.path.islink(path):
        link = path
        path = os.path.join(os.path.dirname(path), os.readlink(path))
    return link


def _descriptor(port: Any, url: str) -> int | None:
    """File descriptor of the port; None if pyserial must process the bytes of this URL."""
    if type(port) is serial.Serial or url.startswith("socket://"):
        return int(port.fileno())
    return None


def _set_low_latency(port: Any, url: str) -> LowLatency:
    """Set driver and adapter to low latency; FTDI adapters wait 16 ms otherwise."""
    if type(port) is not serial.Serial:
        return LowLatency(None, "not a local serial port")
    try:
        port.set_low_latency_mode(True)
        flag = True
    except (ValueError, NotImplementedError):  # of the driver, of the system
        flag = False
    timer = _SYS_TTY / Path(os.path.realpath(url)).name / "device" / "latency_timer"
    try:
        if int(timer.read_text()) > 1:
            timer.write_text("1")
        milliseconds = int(timer.read_text())
    except PermissionError:
        return LowLatency(
            False, f"the latency timer of the adapter is above 1 ms and not writable; as root: echo 1 > {timer}"
        )
    except (OSError, ValueError):
        return LowLatency(True, "on") if flag else LowLatency(None, "this port has no low-latency mode")
    return LowLatency(milliseconds <= 1, f"latency timer {milliseconds} ms")


def _explain(url: str, baud: int, error: BaseException) -> PortError:
    """Reason and remedy for an error of the operating system."""
    code, text = _code(error), str(error)
    if isinstance(error, ValueError):
        if "://" in url and baud > 0:  # the protocol is checked after the rate
            return PortError(
                f"{url!r} is not a port",
                "use a device such as /dev/ttyUSB0, or a pyserial URL such as socket://host:port",
            )
        return PortError(f"{url} cannot run at {baud} baud", "choose a rate that the adapter supports, such as 115200")
    if "://" in url:
        return PortError(
            f"{url} cannot be opened ({text})", "check host and port, and that something listens there", missing=True
        )
    if code == errno.ENOENT:
        return PortError(f"the port {url} does not exist", _known_ports(), missing=True)
    if code in (errno.EACCES, errno.EPERM):
        return PortError(f"no permission for {url}", _permission_remedy(url))
    if code in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return PortError(f"another program uses {url}", "stop it, or use another port")
    if not _is_character_device(url):
        return PortError(f"{url} is not a serial port", _known_ports())
    if code in (errno.ENXIO, errno.ENODEV, errno.EIO):
        return PortError(f"no device at {url}", "plug the adapter in again, or use another port", missing=True)
    if code in (errno.ENOTTY, errno.EINVAL):
        return PortError(f"{url} is not a serial port", _known_ports())
    return PortError(f"{url} cannot be opened ({text})", "plug the adapter in again, or use another port")


def _code(error: BaseException) -> int | None:
    """Number of an error of the operating system; pyserial raises errors of termios anew, without their number."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    source = error if isinstance(error, termios.error) else error.__context__
    return int(source.args[0]) if isinstance(source, termios.error) else None


def _is_character_device(path: str) -> bool:
    try:
        return stat.S_ISCHR(os.stat(path).st_mode)
    except OSError:
        return False


def _known_ports() -> str:
    names = sorted(port.device for port in list_ports.comports())
    if names:
        return f"ports of this computer: {', '.join(names)}"
    return "this computer has no serial port; plug in the adapter, or start a virtual board"


def _permission_remedy(path: str) -> str:
    """Command that gives this user access to a port, from its owner, group and mode."""
    try:
        status = os.stat(path)
    except OSError:
        return f"check the permissions with ls -lL {path} and of its directories"
    mode = stat.S_IMODE(status.st_mode)
    group, group_may = _group_name(status.st_gid), mode & 0o060 == 0o060
    facts = f"it has mode {mode:04o}, owner {_user_name(status.st_uid)}, group {group}"
    if status.st_uid == os.geteuid():
        return f"{facts}, and the mode denies access to the owner: chmod u+rw {path}"
    if not group_may:
        return f"{facts}, and the mode denies access to the group: sudo chmod g+rw {path}, permanently by a udev rule"
    if status.st_gid == 0:
        return f"{facts}: sudo chgrp dialout {path}, permanently by a udev rule, and join the group dialout"
    return f"{facts}; join its group and log in again: sudo usermod -aG {group} $USER"


def _group_name(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _user_name(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)
