"""Waits of a program for the bridge: the timeout follows the progress of the discovery."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
import rclpy
from bridge_rig import DOMAIN
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from servo_bridge.client import Client, ros_session
from servo_msgs_py.runtime.node_name import claim
from std_msgs.msg import Bool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

TIMEOUT = 0.8  # s


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    with ros_session(["test"]) as session, Client("test", session, "/waiting") as client:
        yield client


@pytest.fixture
def bridge() -> Iterator[Node]:
    """A node whose topics are discovered one by one."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    yield Node("servo_bridge", namespace="waiting", context=context, enable_rosout=False)
    rclpy.shutdown(context=context)


def timeouts(client: Client) -> float:
    """Number of timeouts that a wait takes for what does not happen."""
    begin = time.monotonic()
    assert not client.holds(lambda: False, TIMEOUT)
    return (time.monotonic() - begin) / TIMEOUT


def test_without_a_bridge_the_timeout_is_not_extended(client: Client) -> None:
    assert timeouts(client) < 2.0


def test_a_bridge_that_runs_here_is_waited_for_longer(client: Client) -> None:
    own = claim("waiting/servo_bridge", DOMAIN)
    assert own is not None
    with own:
        assert client.undiscovered
        assert timeouts(client) > 2.9
    assert not client.undiscovered


def test_a_wait_for_a_discovered_bridge_is_not_extended(client: Client, bridge: Node) -> None:
    own = claim("waiting/servo_bridge", DOMAIN)
    assert own is not None
    with own:
        bridge.create_publisher(DiagnosticStatus, topics.LINK, 1)
        assert client.holds(lambda: not client.undiscovered, 10.0)
        assert timeouts(client) < 2.0


def test_progress_extends_a_wait(client: Client, bridge: Node) -> None:
    """Each topic is discovered within a timeout of the one before, the last one after more than two."""
    names = [f"t{k}" for k in range(4)]
    bridge.create_publisher(Bool, "first", 1)
    assert client.holds(lambda: client.count_publishers(client.of("first")), 10.0)

    def appear() -> None:
        for name in names:
            bridge.create_publisher(Bool, name, 1)
            time.sleep(0.6 * TIMEOUT)

    thread = threading.Thread(target=appear)
    thread.start()
    assert client.holds(lambda: client.count_publishers(client.of(names[-1])), TIMEOUT)
    thread.join()


def test_time_in_which_the_program_does_not_run_does_not_count(client: Client) -> None:
    """A condition that takes long: as if the computer had other work."""
    steps = [0]

    def work() -> None:
        time.sleep(TIMEOUT / 2.0)
        steps[0] += 1

    client.create_timer(1e-3, work)
    assert client.holds(lambda: steps[0] > 3, TIMEOUT)
