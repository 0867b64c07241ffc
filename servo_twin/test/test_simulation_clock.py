"""ROS time by a simulation: clock, pause, step, speed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from servo_msgs_py.runtime.node_shell import NameTakenError
from servo_twin.simulation_clock import SimulationClock
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.realtime


@pytest.fixture
def user() -> Iterator[Node]:
    context = rclpy.Context()
    context.init(args=None)
    node = Node("user", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


def test_time_is_published_paused_stepped_and_its_speed_changed(user: Node) -> None:
    calls: list[object] = []
    clocks: list[Clock] = []
    executor = rclpy.executors.SingleThreadedExecutor(context=user.context)
    executor.add_node(user)
    user.create_subscription(Clock, "/clock", clocks.append, 10)
    time_ns = 0
    with SimulationClock(calls.append, lambda: calls.append("step"), 1.0) as clock:

        def until(condition: Any) -> None:
            nonlocal time_ns
            deadline = time.monotonic() + 45.0
            while not condition():
                assert time.monotonic() < deadline
                time_ns += 500_000
                clock.serve(time_ns)
                executor.spin_once(timeout_sec=0.001)

        def call(kind: Any, name: str, request: Any) -> Any:
            client = user.create_client(kind, name)
            until(client.service_is_ready)
            future = client.call_async(request)
            until(future.done)
            return future.result()

        until(lambda: len(clocks) > 5)
        stamps = [message.clock.sec * 10**9 + message.clock.nanosec for message in clocks]
        assert all((stamp % 1_000_000) == stamps[0] % 1_000_000 for stamp in stamps)
        refused = call(Trigger, "/simulation/step", Trigger.Request())
        assert not refused.success
        assert "call /simulation/pause first" in refused.message
        assert call(SetBool, "/simulation/pause", SetBool.Request(data=True)).success
        assert call(Trigger, "/simulation/step", Trigger.Request()).success
        for speed, accepted in ((0.5, True), (-1.0, False)):
            request = SetParameters.Request(parameters=[Parameter("speed", value=speed).to_parameter_msg()])
            assert call(SetParameters, "/simulation/set_parameters", request).results[0].successful == accepted
        assert call(SetBool, "/simulation/pause", SetBool.Request(data=False)).success
        assert calls == [0.0, "step", 0.0, 0.5]
        with pytest.raises(NameTakenError):
            SimulationClock(calls.append, lambda: None, 1.0)
