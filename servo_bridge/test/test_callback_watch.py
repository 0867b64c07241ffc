"""Durations of callbacks, and hanging executors."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from bridge_rig import Rig
from lifecycle_msgs.srv import GetState
from servo_bridge.callback_watch import HANG, CallbackWatch


class HostTime:
    """A clock that the test advances [s]; half of the time is processor time."""

    def __init__(self) -> None:
        self.now = 5.0
        self.watch = CallbackWatch(lambda: self.now, lambda: self.now / 2.0)

    def take(self, seconds: float) -> None:
        self.now += seconds


def test_longest_callback_is_named_in_its_period_and_since_the_start() -> None:
    host = HostTime()
    slow, quick = (host.watch.timed(name, host.take) for name in ("topic slow", "timer quick"))
    slow(0.05)
    quick(0.01)
    first = host.watch.report()
    assert first.last.name == "topic slow"
    assert [first.last.wall, first.last.cpu] == pytest.approx([0.05, 0.025])
    quick(0.02)
    second = host.watch.report()
    assert second.last.name == "timer quick"
    assert second.last.wall == pytest.approx(0.02)
    assert second.ever == first.last
    assert host.watch.report().last.wall == 0.0


def test_hang_names_the_outermost_running_callback_and_ends_with_it() -> None:
    host = HostTime()
    found: list[str] = []

    def outer() -> None:
        host.watch.call("inner", host.take, HANG)
        found.append(host.watch.hang())
        host.take(0.5)
        found.append(host.watch.hang())

    host.watch.call("service outer", outer)
    assert found[0] == ""
    assert found[1].startswith("service outer has been running for 1.5 s")
    assert host.watch.hang() == ""
    assert host.watch.report().pause_ever == pytest.approx(1.5)


def test_executor_that_begins_no_callback_hangs_until_a_sign_of_life() -> None:
    host = HostTime()
    host.take(HANG + 0.1)
    assert host.watch.hang().startswith("no callback has begun")
    host.watch.sign_of_life()
    assert host.watch.hang() == ""


def test_callback_that_fails_is_measured() -> None:
    host = HostTime()

    def fail() -> None:
        host.take(0.3)
        raise RuntimeError("planted")

    with pytest.raises(RuntimeError):
        host.watch.call("timer fail", fail)
    assert host.watch.report().last.name == "timer fail"
    assert host.watch.hang() == ""


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        rig.connect()
        yield rig


@pytest.mark.realtime
def test_slow_callback_is_named_in_the_diagnostics(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    supervisor = rig.bridge.supervisor
    assert supervisor is not None
    monkeypatch.setattr(supervisor._storage, "connected", lambda: time.sleep(0.15))
    rig.diagnosis("executor")  # begins a new period
    rig.link.connect()
    rig.link.sample()
    rig.until(lambda: supervisor._watch._last.wall > 0.1)
    status = rig.diagnosis("executor")
    values = {value.key: value.value for value in status.values}
    assert values["longest callback"].endswith("_on_link")
    assert float(values["longest callback [ms]"]) >= 150.0
    assert float(values["longest callback, processor time [ms]"]) < 100.0
    assert values["longest callback since the start"] == values["longest callback"] or float(
        values["longest callback since the start [ms]"]
    ) >= float(values["longest callback [ms]"])
    assert status.level == status.WARN


@pytest.mark.realtime
def test_services_that_rclpy_creates_are_measured(rig: Rig) -> None:
    client = rig.user.create_client(GetState, "servo_bridge/get_state")
    rig.until(client.service_is_ready)
    future = client.call_async(GetState.Request())
    rig.until(future.done)
    assert "service /servo/servo_bridge/get_state" in rig.bridge.watch.longest()


@pytest.mark.realtime
def test_time_before_the_configuration_is_no_pause() -> None:
    """Without a supervisor nothing gives signs of life."""
    with Rig(autostart=False) as rig:
        watch = rig.bridge.watch
        watch._sign -= 60.0
        rig.bridge.trigger_configure()
        assert watch.hang() == ""
        watch.sign_of_life()
        assert watch.report().pause_ever < 10.0
