"""The service ``tune`` and the topic ``tuning`` with a virtual board: gains in motion, refusals, and the twin."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from chain import FAST_BAUD, User, followed_board
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from servo_msgs_py.blocks_message import blocks_from_message
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.qos import latched_qos
from servo_tuning.reading import loads
from servo_twin.servo_config import blocks_of_configuration
from std_msgs.msg import Int64MultiArray
from std_srvs.srv import SetBool
from test_tune_on_board import CONFIG, edited

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

BOTH = ["axis1", "axis2"]
FAR = 20_000.0  # [rad], longer than any test


class TuningClient:
    """ROS client of the tuning service."""

    def __init__(self, user: User) -> None:
        self.user = user
        self.blocks: list[dict[int, tuple[int, ...]]] = []
        self._tune = user.node.create_client(SetBool, "/servo/tune")
        self._parameters = user.node.create_client(SetParameters, "/servo/servo_bridge/set_parameters")
        user.node.create_subscription(
            Int64MultiArray,
            "/servo/tuning",
            lambda message: self.blocks.append(blocks_from_message(message)),
            latched_qos(),
        )

    def call(self, file: Path, *, send: bool) -> tuple[bool, str]:
        """Set the parameter `tuning` to a file and call the service."""
        for client, request in (
            (
                self._parameters,
                SetParameters.Request(parameters=[Parameter("tuning", value=str(file)).to_parameter_msg()]),
            ),
            (self._tune, SetBool.Request(data=send)),
        ):
            self.user.until(client.service_is_ready, 20.0)
            future = client.call_async(request)
            self.user.until(future.done, 30.0, "no answer")
        return bool(future.result().success), str(future.result().message)

    def until_published(self, count: int) -> dict[int, tuple[int, ...]]:
        self.user.until(lambda: len(self.blocks) >= count, 30.0, "no configuration")
        return self.blocks[-1]


@pytest.fixture
def tuner(tmp_path: Path) -> Iterator[TuningClient]:
    with followed_board(tmp_path, FAST_BAUD, "ideal", telemetry_rate=130.0) as user:
        yield TuningClient(user)


def test_gains_are_sent_in_motion_and_read_back(tuner: TuningClient, tmp_path: Path) -> None:
    user, catalogue = tuner.user, Catalogue.load()
    own = tuner.until_published(1)
    built_in = blocks_of_configuration(loads(CONFIG.read_text(encoding="utf-8"), catalogue))
    assert own == built_in
    gains = edited(tmp_path, "gains.toml", control={"position_gain": 50.0, "speed_bandwidth": 60.0})
    motor = edited(tmp_path, "motor.toml", axis1__motor={"psi_m": 0.012})
    bad = edited(tmp_path, "bad.toml", control={"speed_bandwidth": 4000.0})
    user.enable_axes()
    user.until(lambda: user.last("/twin/healthy") is True, 30.0, "the twin is not healthy")
    user.joint_commands.publish(JointState(name=BOTH, position=[FAR, -FAR]))
    user.until(lambda: user.position_of(0) > 1.0)

    success, message = tuner.call(bad, send=True)
    assert not success
    assert message.startswith(f"{bad}: ")
    assert "speed_bandwidth" in message
    success, message = tuner.call(gains, send=False)
    assert success
    assert "in motion" in message
    assert "taken" not in message
    success, message = tuner.call(motor, send=True)
    assert not success
    assert message.splitlines()[-1].startswith("rotor_search.follow.flux_min can only be changed at standstill")
    assert tuner.blocks == [own]
    assert not any(command.variable == "config.take" for command in user.applied())

    success, message = tuner.call(gains, send=True)
    assert success, message
    assert "axis1 and axis2 applied at tick" in message
    new = tuner.until_published(2)
    assert new == blocks_of_configuration(loads(gains.read_text(encoding="utf-8"), catalogue)) != built_in
    assert user.position_of(0) < FAR - 1000.0, "still moving"
    (take,) = [command for command in user.applied() if command.variable == "config.take"]
    assert message.endswith(f"tick {take.tick}")
    assert take.raw == (*new[0], *new[1])
    success, message = tuner.call(gains, send=True)
    assert success
    assert message.splitlines()[-1] == f"the board already has the configuration of {gains}; no change"
    start = len(user.messages["/diagnostics"])
    user.until(lambda: len(user.messages["/diagnostics"]) > start + 6)
    comparison = user.status("twin/servo_twin: comparison")
    assert comparison.message == "healthy"
    figures = {value.key: value.value for value in comparison.values}
    assert figures["synchronisations"] == "1", "the twin has applied the blocks at their tick"
