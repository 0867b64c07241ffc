"""The web page of the live viewer: on the loopback interface only, and ended with its owner."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from servo_twin.view.recording import Recording
from servo_twin.view.web_page import LOOPBACK, WebPage, WebPageError, free_port

pytestmark = pytest.mark.realtime

pytest.importorskip("rerun")

_OWNER = """
import sys, time
from servo_twin.view.web_page import WebPage
page = WebPage(int(sys.argv[1]), "rerun+http://127.0.0.1:9876/proxy")
print(page.pid, flush=True)
time.sleep(60)
"""


@pytest.fixture
def listener() -> Iterator[int]:
    """A port that is in use."""
    with socket.socket() as server:
        server.bind((LOOPBACK, 0))
        server.listen()
        yield server.getsockname()[1]


def _ports(count: int) -> list[int]:
    """Ports that were free just before, outside the range that users choose."""
    return [free_port(10_000 + os.getpid() % 20_000 + 40 * k) for k in range(count)]


def _listening(port: int) -> list[str]:
    """Local addresses that listen on a port, hexadecimal as in /proc."""
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
            address, number = line.split()[1].split(":")
            if int(number, 16) == port and line.split()[3] == "0A":
                found.append(address)
    return found


def _wait(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def _gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_a_port_in_use_is_skipped(listener: int) -> None:
    assert free_port(listener) > listener
    free = free_port(listener)
    assert free_port(free, exclude=free) > free


def test_missing_free_port_is_reported_with_the_range(monkeypatch: pytest.MonkeyPatch, listener: int) -> None:
    monkeypatch.setattr("servo_twin.view.web_page._PORTS_TRIED", 1)
    with pytest.raises(WebPageError, match=f"ports {listener} .. {listener} are all in use"):
        free_port(listener)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_page_and_data_are_on_the_loopback_interface_only() -> None:
    data, web = _ports(2)
    recording = Recording(grpc_port=data)
    try:
        page = WebPage(web, recording.uri)
        try:
            assert f":{data}" in recording.uri
            assert page.url.startswith(f"http://{LOOPBACK}:{web}/")
            # 127.0.0.1 in the byte order of the machine.
            loopback = "0100007F" if sys.byteorder == "little" else "7F000001"
            assert _wait(lambda: _listening(data) != [])
            assert _listening(data) == [loopback]
            assert _listening(web) == [loopback]
            with urllib.request.urlopen(page.url, timeout=10.0) as answer:
                assert b"rerun" in answer.read().lower()
        finally:
            page.close()
    finally:
        recording.close()
    assert _gone(page.pid)
    assert _listening(web) == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel ends the child on Linux only")
def test_the_page_ends_with_an_owner_that_is_killed() -> None:
    (web,) = _ports(1)
    with subprocess.Popen([sys.executable, "-c", _OWNER, str(web)], stdout=subprocess.PIPE, text=True) as owner:
        try:
            assert owner.stdout is not None
            child = int(owner.stdout.readline())
            assert not _gone(child)
        finally:
            owner.kill()
    assert _wait(lambda: _gone(child))


def test_a_command_that_ends_at_once_is_reported() -> None:
    with pytest.raises(WebPageError, match="rerun command ended with status 2"):
        WebPage(_ports(1)[0], "--no-such-option")
