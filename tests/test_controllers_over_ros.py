"""The model of ros2_control over real ROS topics, at a bridge with a board on a pty."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from chain import FAST_BAUD, Chain, User, ros_user
from command_sequences import joint_state
from controllers.controllers import SUCCESSFUL, Constraints, JointTrajectoryController
from controllers.hardware import POSITION, VELOCITY, StateMessage, TopicHardware
from controllers.manager import ControllerManager
from controllers.trajectory import Point
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

JOINTS = ("axis1", "axis2")
RATE = 100.0
AT_REST = 0.08
"""Largest motion of a shaft without a command [rad]."""


class Controllers:
    """A controller_manager on the topics of the bridge, in the executor of the user."""

    def __init__(self, user: User) -> None:
        self._user = user
        self.hardware = TopicHardware(JOINTS, dict.fromkeys(JOINTS, (POSITION, VELOCITY)))
        self.trajectory = JointTrajectoryController(JOINTS, RATE, constraints=Constraints(0.0, 0.02, 2.0, 0.5))
        self.manager = ControllerManager(self.hardware, [self.trajectory], RATE)
        self.sent = 0  # messages
        node = user.node
        self._publisher = node.create_publisher(JointState, "/servo/joint_commands", QoSProfile(depth=1))
        node.create_subscription(JointState, "/servo/joint_states", self._on_states, qos_profile_sensor_data)
        node.create_timer(1.0 / RATE, self._cycle, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_states(self, message: JointState) -> None:
        self.hardware.receive(StateMessage(tuple(message.name), tuple(message.position), tuple(message.velocity)))

    def _cycle(self) -> None:
        message = self.manager.cycle(time.monotonic())
        if message is not None:
            self.sent += 1
            self._publisher.publish(joint_state(message, self._user.node.get_clock().now().nanoseconds))

    def until_sent(self, count: int) -> None:
        """Wait for a number of messages."""
        end = self.sent + count
        self._user.until(lambda: self.sent >= end)

    def go(self, *targets: float) -> None:
        """Send a goal and wait until it is reached."""
        self.trajectory.results.clear()
        assert self.trajectory.goal([Point(targets, (0.0, 0.0), (), 0.5)])
        self._user.until(lambda: self.trajectory.results)
        assert self.trajectory.results == [SUCCESSFUL]


@pytest.fixture
def user(tmp_path: Path) -> Iterator[User]:
    chain = Chain(tmp_path, FAST_BAUD, level="ideal")
    with ros_user() as user:
        try:
            chain.board()
            chain.bridge(telemetry_rate=200.0)
            user.until(user.connected, 30.0, "the bridge is not connected")
            yield user
        finally:
            chain.end()
            print(chain.logs())


def test_hardware_activated_again_moves_nothing_before_a_goal(user: User) -> None:
    controllers = Controllers(user)
    controllers.until_sent(10)  # NaN
    controllers.manager.switch(start=controllers.trajectory)
    user.enable_axes()
    controllers.go(1.0, -1.0)

    controllers.manager.switch(stop=controllers.trajectory)
    controllers.manager.set_hardware_active(False)
    user.wait_board_time(0.5)
    for publisher in user.position:
        publisher.publish(Float64(data=3.0))
    user.until(lambda: all(abs(user.position_of(axis) - 3.0) < 0.01 for axis in (0, 1)), what="not moved")

    controllers.manager.set_hardware_active(True)  # repeats the old command
    controllers.until_sent(200)  # for 2 s
    states = user.messages["/servo/joint_states"]
    assert max(abs(position - 3.0) for state in states[-200:] for position in state.position) < AT_REST
    assert "axis1" in user.rejections()[-1]
    controllers.manager.switch(start=controllers.trajectory)
    controllers.until_sent(20)
    controllers.go(3.5, 2.5)
