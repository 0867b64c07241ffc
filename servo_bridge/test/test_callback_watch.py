"""Durations of callbacks, and hanging executors."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from bridge_rig import SPIN, Rig
from builtin_interfaces.msg import Duration
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import JointState
from servo_bridge.callback_watch import HANG, CallbackWatch
from servo_bridge.set_point_sources import Source
from servo_bridge.trajectory.follower import QUICK
from servo_msgs_py.runtime.qos import command_qos
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from servo_bridge import callback_watch
from servo_msgs_py import topics


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
    monkeypatch.setattr(supervisor.parts.storage, "connected", lambda: time.sleep(0.15))
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
def test_every_kind_of_callback_is_short(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most 20 ms of processor time, in the same thread as all commands, without the garbage of other tests."""
    monkeypatch.setattr(callback_watch, "_wall", lambda taken: taken.cpu)
    gc.disable()
    try:
        use_everything(rig)
    finally:
        gc.enable()
    longest = rig.bridge.watch.longest()
    assert {"timer Supervisor._every_second", "Supervisor._on_sample", "topic joint_commands"} <= longest.keys()
    assert max(taken.cpu for taken in longest.values()) < 0.02, "\n".join(map(str, longest.values()))


def use_everything(rig: Rig) -> None:
    """Longest path that is planned at once, two sources in conflict, a refused stream, a new description."""
    rig.link.set_states(SPIN, SPIN)
    for name, value in (("speed", 300.0), ("acceleration", 4000.0), ("i_q", 2.0)):
        variable = rig.link.catalogue[f"param.{name}_limit"]
        rig.link.parameters[variable.name] = [variable.to_raw(value)] * 2
    rig.enable_axes()
    supervisor = rig.bridge.supervisor
    assert supervisor is not None
    rig.until(lambda: supervisor.parts.path_limits() is not None)
    times = np.arange(1, QUICK + 1) / 25.0
    paths = rig.user.create_publisher(JointTrajectory, topics.JOINT_TRAJECTORY, command_qos())
    rig.until(paths.get_subscription_count)
    points = [
        JointTrajectoryPoint(
            positions=[1.0 - math.cos(t), math.cos(t) - 1.0],
            time_from_start=Duration(sec=int(t), nanosec=round(t % 1.0 * 1e9) % 1_000_000_000),
        )
        for t in times.tolist()
    ]
    paths.publish(JointTrajectory(joint_names=["axis1", "axis2"], points=points))

    def sampled(condition: Callable[[], object]) -> Callable[[], object]:
        def met() -> object:
            rig.link.sample(160)
            return condition()

        return met

    rig.until(sampled(lambda: supervisor.parts.follower.moving))
    for _ in range(4):
        rig.position.publish(Float64(data=0.0))
        rig.until(sampled(lambda: supervisor.parts.arbiter.sources.holder(1) == Source("axis2/position", "position")))
        rig.joint_commands.publish(JointState(name=["axis2"], velocity=[1.0]))
        rig.until(sampled(lambda: supervisor.parts.arbiter.sources.holder(1) == Source("joint_commands", "velocity")))
    for _ in range(20):
        rig.joint_commands.publish(JointState(name=["axis1"], position=[0.0], velocity=[0.0]))
        rig.link.sample(160)
        rig.executor.spin_once(timeout_sec=0.01)
    assert rig.set_parameter("position_max", [100.0, 100.0])[0]
    rig.until(lambda: "timer Supervisor._every_second" in rig.bridge.watch.longest())
    rig.link.disconnect()
    rig.until(lambda: "DISCONNECTED" in rig.state())


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
