"""The service ``tune`` under real rclpy: answers without a board that accepts blocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from bridge_rig import Rig
from fake_servo import FakeServo
from fake_transport import FakeTransport, client_on
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.set_point_queue import CommandWrite, SetPointQueue
from servo_bridge.tuning.process import ComputationError, TuningProcess
from servo_bridge.wire.session import connect
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.errors import ConfigError
from std_srvs.srv import SetBool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CONFIG = Path(__file__).resolve().parents[2] / "firmware" / "config" / "servo.toml"


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        rig.tune_client = rig.user.create_client(SetBool, topics.TUNE)  # type: ignore[attr-defined]
        rig.until(rig.tune_client.service_is_ready)  # type: ignore[attr-defined]
        rig.connect()
        yield rig


def tune(rig: Rig, send: bool) -> tuple[bool, str]:
    future = rig.tune_client.call_async(SetBool.Request(data=send))  # type: ignore[attr-defined]
    rig.until(future.done, 30.0)
    return future.result().success, future.result().message


def test_invalid_configuration_is_refused_with_a_reason(rig: Rig) -> None:
    success, message = tune(rig, True)
    assert not success
    assert "parameter tuning is empty" in message
    assert rig.set_parameter("tuning", str(CONFIG))[0]
    assert tune(rig, True) == (False, "no link")
    rig.link.session = connect(client_on(FakeTransport(FakeServo().feed)), Catalogue.load())
    success, message = tune(rig, True)
    assert not success
    assert "the layout of the block on the board is different" in message
    assert not any(name.startswith("config") for name, *_ in rig.link.written)


def test_tuning_process_gives_the_refusals_of_the_tuning_code(tmp_path: Path) -> None:
    process = TuningProcess()
    file = tmp_path / "bad.toml"
    with pytest.raises(ConfigError, match="No such file"):
        process.computed(file)
    file.write_text(CONFIG.read_text(encoding="utf-8").replace("psi_m      = 0.0154", "psi_m = -1.0"), encoding="utf-8")
    with pytest.raises(ConfigError, match="psi_m"):
        process.computed(file)
    process.close()
    with pytest.raises(ComputationError, match="ending"):
        process.computed(file)


def test_a_write_of_blocks_is_reported_with_its_members() -> None:
    sent: list[CommandWrite] = []

    dispatcher = Dispatcher(sent.append, SetPointQueue(), pytest.fail)
    dispatcher.open()
    dispatcher.confirm(800, 0, 0)
    members = tuple(range(len(AxisConfigTable.load())))
    done = dispatcher.urgent(CommandWrite("config.take", 0, (2,), members))
    dispatcher.acknowledged(sent[0], None)
    command = dispatcher.confirm(816, 808, 1)
    assert command is not None
    assert (command.mask, command.raw, command.tick, done.result()) == (2, members, 808, 808)
