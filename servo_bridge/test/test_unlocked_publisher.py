"""Publishing without the lock of the interpreter."""

from __future__ import annotations

import ctypes
import threading
import time

import pytest
from bridge_rig import Rig
from diagnostic_msgs.msg import DiagnosticArray

from servo_bridge import unlocked_publisher

pytestmark = pytest.mark.realtime


def test_executor_and_link_run_while_the_middleware_is_blocked(monkeypatch: pytest.MonkeyPatch) -> None:
    sleep = ctypes.CDLL(None).usleep  # stands for a middleware that waits for a lock
    sleep.argtypes = [ctypes.c_uint]

    def blocked(*_: object) -> int:
        return int(sleep(300_000))

    with Rig() as rig:
        monkeypatch.setattr(unlocked_publisher, "_publish_function", lambda: blocked)
        publisher = rig.bridge.create_publisher(DiagnosticArray, "a_topic", 10)
        steps: list[float] = []
        publisher.publish(DiagnosticArray())
        sent = threading.Thread(target=rig.bridge._sender.flush)
        sent.start()
        while sent.is_alive():
            steps.append(time.monotonic())
            time.sleep(0.002)
        assert steps[-1] - steps[0] > 0.25
        assert len(steps) >= 10


def test_messages_arrive_unchanged() -> None:
    with Rig() as rig:
        rig.connect()
        status = rig.diagnosis("link")
        assert {value.key for value in status.values} >= {"port", "baud", "samples/s"}
        assert "publish" in vars(rig.bridge.supervisor._diagnostics)  # type: ignore[union-attr]
