from __future__ import annotations

import grp
import os
import select
import socket
import stat
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial
from servo_bridge.freemaster.errors import TransportError
from servo_bridge.wire import serial_port
from servo_bridge.wire.serial_port import PortError, SerialPort

pytestmark = pytest.mark.realtime


def soon(seconds: float = 5.0) -> int:
    return time.monotonic_ns() + round(seconds * 1e9)


class Pty:
    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        self.path = os.ttyname(self.slave)

    def hang_up(self) -> None:
        for fd in (self.slave, self.master):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1


@pytest.fixture
def pty() -> Iterator[Pty]:
    pair = Pty()
    yield pair
    pair.hang_up()


def test_bytes_pass_in_both_directions(pty: Pty) -> None:
    with SerialPort(pty.path, 115_200) as port:
        port.write(b"+\x20\x00\x0d\x0a\x11\x13\x7f\xff")
        assert os.read(pty.master, 100) == b"+\x20\x00\x0d\x0a\x11\x13\x7f\xff"
        os.write(pty.master, b"\x03\x04\x0d\x0a+\x11\x13\x1a")
        assert port.read(soon()) == b"\x03\x04\x0d\x0a+\x11\x13\x1a"
        assert port.low_latency.enabled is None
        assert "no low-latency mode" in port.low_latency.text


def test_reading_ends_at_the_deadline(pty: Pty) -> None:
    with SerialPort(pty.path, 115_200) as port:
        start = time.monotonic()
        assert port.read(soon(0.05)) == b""
        assert 0.05 <= time.monotonic() - start < 1.0
        start = time.monotonic()
        assert port.read(0) == b""
        assert time.monotonic() - start < 0.05


def test_buffered_bytes_are_read_after_the_deadline(pty: Pty) -> None:
    with SerialPort(pty.path, 115_200) as port:
        os.write(pty.master, b"late")
        assert port.read(0) == b"late"


def test_removed_port_is_reported(pty: Pty) -> None:
    with SerialPort(pty.path, 115_200) as port:
        pty.hang_up()
        with pytest.raises(TransportError, match=r"the port /dev/pts/\d+ is lost"):
            port.read(soon())
        with pytest.raises(TransportError, match="is lost"):
            port.write(b"x")


def test_port_removed_during_a_read_is_reported(pty: Pty) -> None:
    with SerialPort(pty.path, 115_200) as port:
        caught: list[BaseException] = []

        def read() -> None:
            try:
                port.read(soon(10))
            except TransportError as error:
                caught.append(error)

        thread = threading.Thread(target=read)
        thread.start()
        pty.hang_up()
        thread.join(5.0)
        assert caught


def test_port_that_accepts_no_bytes_times_out(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_port, "_WRITE_LIMIT_NS", 50_000_000)
    with SerialPort(pty.path, 115_200) as port, pytest.raises(TransportError, match="accepts no more bytes"):
        port.write(bytes(1 << 20))


def test_old_input_is_discarded_when_opening(pty: Pty) -> None:
    os.write(pty.master, b"old\n")
    with SerialPort(pty.path, 115_200) as port:
        assert port.read(soon(0.05)) == b""


def age(link: Path) -> None:
    """Set the age of a link to one minute."""
    then = time.time() - 60.0
    os.utime(link, (then, then), follow_symlinks=False)


def test_mode_change_does_not_look_like_a_new_terminal(pty: Pty, tmp_path: Path) -> None:
    link = tmp_path / "board"
    link.symlink_to(pty.path)
    created = os.stat(pty.path).st_mtime
    os.utime(pty.path, (created - 60.0, created - 60.0))  # simulates an older terminal; also sets the change time
    then = created - 59.0
    os.utime(link, (then, then), follow_symlinks=False)
    os.chmod(pty.path, 0o620)
    with SerialPort(str(link), 115_200):
        pass


def test_a_link_that_is_older_than_its_terminal_is_not_followed(pty: Pty, tmp_path: Path) -> None:
    link = tmp_path / "board"
    link.symlink_to(pty.path)
    with SerialPort(str(link), 115_200) as port:
        port.write(b"to the board")
    assert os.read(pty.master, 100) == b"to the board"
    outer = tmp_path / "servo"
    outer.symlink_to("board")
    age(outer)
    with SerialPort(str(outer), 115_200):  # created once
        pass
    age(link)
    for path in (link, outer):
        with pytest.raises(PortError, match=f"{link} is older than its terminal") as caught:
            SerialPort(str(path), 115_200)
        assert caught.value.missing
        assert pty.path in caught.value.remedy
    assert not select.select([pty.master], [], [], 0.0)[0]
    with SerialPort(pty.path, 115_200):
        pass


def test_a_port_may_be_closed_twice(pty: Pty) -> None:
    port = SerialPort(pty.path, 115_200)
    port.close()
    port.close()
    with pytest.raises(TransportError):
        port.write(b"x")


def test_a_port_used_by_another_program_is_refused(pty: Pty) -> None:
    with SerialPort(pty.path, 115_200), pytest.raises(PortError, match="another program uses") as caught:
        SerialPort(pty.path, 115_200)
    assert not caught.value.missing
    SerialPort(pty.path, 115_200).close()


def test_missing_port_is_reported(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="does not exist") as caught:
        SerialPort(str(tmp_path / "ttyUSB9"), 115_200)
    assert caught.value.missing
    assert caught.value.remedy


def test_a_file_that_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("no port")
    for path in (file, tmp_path, Path("/dev/null")):
        with pytest.raises(PortError, match="is not a serial port"):
            SerialPort(str(path), 115_200)


USER = 4321


@pytest.mark.parametrize(
    ("mode", "owner", "group", "remedy"),
    [
        (0o660, 0, 20, r"mode 0660, owner root, group dialout; join its group .*usermod -aG dialout \$USER"),
        (
            0o600,
            0,
            20,
            r"mode 0600, owner root, group dialout, and the mode denies access to the group: sudo chmod g\+rw ",
        ),
        (0o660, 0, 0, r"mode 0660, owner root, group root: sudo chgrp dialout "),
        (
            0o060,
            USER,
            20,
            r"mode 0060, owner \S+, group dialout, and the mode denies access to the owner: chmod u",
        ),
    ],
)
def test_a_port_without_permission_is_reported_with_its_remedy(
    pty: Pty, monkeypatch: pytest.MonkeyPatch, mode: int, owner: int, group: int, remedy: str
) -> None:
    """With a simulated system error, as tests may run as root."""

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    def fake_stat(_: str) -> os.stat_result:
        return os.stat_result((stat.S_IFCHR | mode, 0, 0, 1, owner, group, 0, 0, 0, 0))

    names = {0: "root", 20: "dialout"}
    with monkeypatch.context() as patched:
        patched.setattr(serial, "serial_for_url", refuse)
        patched.setattr(serial_port, "_refuse_stale_link", lambda _: None)
        patched.setattr(os, "stat", fake_stat)
        patched.setattr(os, "geteuid", lambda: USER)
        patched.setattr(grp, "getgrgid", lambda number: SimpleNamespace(gr_name=names[number]))
        with pytest.raises(PortError, match=rf"no permission for .*{remedy}"):
            SerialPort(pty.path, 115_200)


@pytest.mark.parametrize("url", ["nonsense://x", "socket://"])
def test_invalid_urls_are_refused(url: str) -> None:
    with pytest.raises(PortError):
        SerialPort(url, 115_200)


def test_impossible_baud_rate_is_refused(pty: Pty) -> None:
    with pytest.raises(PortError, match="cannot run at -5 baud"):
        SerialPort(pty.path, -5)


def test_a_url_opens_a_network_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with SerialPort(url, 115_200) as port:
            peer, _ = server.accept()
            with peer:
                port.write(b"ping")
                assert peer.recv(10) == b"ping"
                peer.sendall(b"pong")
                assert port.read(soon()) == b"pong"
            with pytest.raises(TransportError, match="is lost"):
                port.read(soon())
    with pytest.raises(PortError, match="something listens"):
        SerialPort(url, 115_200)


def test_loop_port_without_descriptor_works() -> None:
    with SerialPort("loop://", 115_200) as port:
        port.write(b"abc")
        data = b""
        while len(data) < 3:
            data += port.read(soon())
        assert data == b"abc"
        assert port.read(soon(0.02)) == b""


# ---- low latency --------------------------------------------------------------------------------------------------
class FakeSerial(serial.Serial):
    """Fake port with a low-latency mode; it is not opened."""

    flag = True

    def __init__(self) -> None:
        pass

    def set_low_latency_mode(self, _: bool) -> None:
        if not self.flag:
            raise ValueError

    def __del__(self) -> None:
        pass


@pytest.fixture
def sys_tty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(serial_port, "_SYS_TTY", tmp_path)
    monkeypatch.setattr(serial, "Serial", FakeSerial)
    timer = tmp_path / "ttyUSB0" / "device" / "latency_timer"
    timer.parent.mkdir(parents=True)
    return timer


def test_the_latency_timer_of_an_adapter_is_set(sys_tty: Path) -> None:
    sys_tty.write_text("16\n")
    result = serial_port._set_low_latency(FakeSerial(), "/dev/ttyUSB0")
    assert result.enabled is True
    assert sys_tty.read_text() == "1"


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write everywhere")
def test_a_latency_timer_that_cannot_be_set_is_reported(sys_tty: Path) -> None:
    sys_tty.write_text("16\n")
    sys_tty.chmod(stat.S_IRUSR)
    result = serial_port._set_low_latency(FakeSerial(), "/dev/ttyUSB0")
    assert result.enabled is False
    assert f"echo 1 > {sys_tty}" in result.text


def test_a_port_with_low_latency_mode_and_without_timer_is_used(sys_tty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert serial_port._set_low_latency(FakeSerial(), "/dev/ttyS0").enabled is True
    monkeypatch.setattr(FakeSerial, "flag", False)
    assert serial_port._set_low_latency(FakeSerial(), "/dev/ttyS0").enabled is None
