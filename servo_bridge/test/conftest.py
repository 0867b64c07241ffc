"""Shared fixtures: a fake board on a pty, and links to it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import common_rig  # noqa: F401
import pytest

sys.path.insert(0, str(Path(__file__).parent))  # the helper modules of this folder

from fake_port import FakePort
from fake_servo import FakeServo
from link_watcher import StartLink, Watcher
from servo_bridge.wire.link import LinkState


@pytest.fixture
def fake_board() -> FakeServo:
    return FakeServo()


@pytest.fixture
def fake_port(tmp_path: Path, fake_board: FakeServo) -> Iterator[FakePort]:
    """The fake board on the port ``tmp_path/ttyFAKE``."""
    with FakePort(tmp_path / "ttyFAKE", fake_board) as port:
        yield port


@pytest.fixture
def start_link(tmp_path: Path) -> Iterator[StartLink]:
    """Starts links at the port ``tmp_path/ttyFAKE``, which need not exist, and closes them at the end."""
    watchers: list[Watcher] = []

    def start(**options: object) -> Watcher:
        watcher = Watcher(str(tmp_path / "ttyFAKE"), **options)
        watchers.append(watcher)
        watcher.link.start()
        return watcher

    yield start
    for watcher in watchers:
        watcher.link.close()


@pytest.fixture
def connected(fake_port: FakePort, start_link: StartLink) -> Watcher:
    """A connected link."""
    watcher = start_link()
    watcher.wait_state(LinkState.CONNECTED)
    return watcher
