"""Positions over the whole chain: set, restored after a restart of the board as assumed, else unknown."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chain import Chain, User
from servo_msgs_py.runtime.qos import latched_qos
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

FEATURES = [
    f"param.features[{axis}]=ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION+DEAD_TIME+POSITION_LIMITS+HOMING"
    for axis in range(2)
]


@pytest.fixture
def chain(tmp_path: Path) -> Iterator[Chain]:
    chain = Chain(tmp_path, level="ideal")
    yield chain
    chain.end()


@pytest.fixture
def user() -> Iterator[User]:
    user = User()
    user.listen("/servo/axis1/position_known", Bool, latched_qos())
    yield user
    user.close()


def command(chain: Chain, user: User, *arguments: str, fails: bool = False) -> str:
    """Output of servo-command."""
    process = chain.script("servo-command", *arguments)
    user.until(lambda: not process.running, 20.0, process.text())
    assert (process.stop() != 0) == fails, process.text()
    return process.text()


def known(user: User) -> bool:
    messages = user.messages["/servo/axis1/position_known"]
    return bool(messages and messages[-1].data)


def positions(user: User) -> list[float]:
    return [float(message.position[0]) for message in user.messages["/servo/joint_states"]]


def home_state(user: User, axis: int) -> str:
    """Home state of an axis in the last diagnostics."""
    found: list[Any] = [
        pair.value
        for message in user.messages["/diagnostics"]
        for status in message.status
        if status.name.endswith(f": axis{axis}")
        for pair in status.values
        if pair.key == "home state"
    ]
    return str(found[-1]) if found else ""


def test_position_is_set_restored_and_limits_apply(chain: Chain, user: User) -> None:
    board = chain.board()
    chain.bridge(board_parameters=[*FEATURES, "param.position_max=1.0,1.0"])
    user.until(user.connected)
    user.until(lambda: user.messages["/servo/axis1/position_known"])
    assert not known(user)
    assert "is homed" in command(chain, user, "zero", "axis1", "0.5")
    user.until(lambda: known(user) and abs(positions(user)[-1] - 0.5) < 0.01)
    assert "home state known" in command(chain, user, "state")

    user.messages["/servo/joint_states"].clear()
    board.stop(signal.SIGTERM)
    chain.port.unlink(missing_ok=True)
    chain.board()
    user.until(lambda: "DISCONNECTED" not in user.last("/servo/state") and len(positions(user)) > 50, 20.0)
    user.messages["/diagnostics"].clear()
    user.until(lambda: home_state(user, 1) == "assumed", 10.0)
    assert not known(user)
    assert max(abs(position - 0.5) for position in positions(user)) < 0.01, "the position does not jump"

    assert user.enable()[0]
    user.until(lambda: user.messages["/servo/armed"][-1].data)
    home = user.node.create_client(Trigger, f"/servo/axis2/{topics.HOME}/stop_positive")
    user.until(home.service_is_ready)
    future = home.call_async(Trigger.Request())
    user.until(lambda: home_state(user, 2) == "homing" or future.done(), 5.0)
    assert user.quick_stop()[0]
    user.until(future.done, 5.0)
    assert not future.result().success
    assert "another command" in future.result().message
    assert "joint axis3 does not exist" in command(chain, user, "zero", "axis3", fails=True)
