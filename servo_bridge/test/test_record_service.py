"""The service ``record`` and the topic ``recording``, under real rclpy, with the recorder of a fake board."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from bridge_rig import STOP, Rig
from fake_servo import CATALOGUE, FakeServo
from fake_transport import FakeTransport, client_on
from servo_bridge.bursts.recording import BurstRecording
from servo_bridge.bursts.request import Prepared
from servo_bridge.wire.session import connect
from servo_msgs_py.convert import snapshot_table
from servo_msgs_py.recorder_setup import RecorderSetup, setup_from_message, setup_message
from servo_msgs_py.runtime.qos import latched_qos
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

FIRST_TICK = 1_000_000


@pytest.fixture
def rig() -> Iterator[Rig]:
    """A bridge whose board records a sine of 2 A with a period of 100 ticks."""
    board = FakeServo(recorder_memory=2048)
    lsb = CATALOGUE["axis1.i_q"].lsb

    def tick(number: int) -> None:
        board.put("axis1.i_q", round(2.0 * math.sin(0.02 * math.pi * number) / lsb))
        board.put("tick", FIRST_TICK + number)

    board.on_tick = tick

    def fed(data: bytes) -> bytes:
        if any(recorder.state == 2 for recorder in board.recorders):
            board.advance(400)
        return board.feed(data)

    with Rig(recording="axis1.i_q --trigger 'axis1.i_q > 1.0' --before 30% --points 50") as rig:
        rig.listen(topics.RECORDING, Float64MultiArray, latched_qos())
        rig.listen(topics.RECORDER, Float64MultiArray, latched_qos())
        rig.record_client = rig.user.create_client(SetBool, topics.RECORD)  # type: ignore[attr-defined]
        rig.until(rig.record_client.service_is_ready)  # type: ignore[attr-defined]
        rig.connect(STOP, STOP)
        rig.link.session = connect(client_on(FakeTransport(fed)), CATALOGUE)
        rig.link.tick = FIRST_TICK + 100_000
        rig.link.sample()
        rig.wait_for_pending()
        yield rig


def record(rig: Rig, begin: bool) -> tuple[bool, str]:
    success, message = rig.call(rig.record_client, SetBool.Request(data=begin))  # type: ignore[attr-defined]
    return success, message


def test_a_burst_is_published_with_its_ticks_and_stamps(rig: Rig) -> None:
    assert record(rig, True) == (True, "50 points of 2 number(s) at 16000 Hz, trigger axis1.i_q > 1.0")
    rig.until(lambda: rig.messages[topics.RECORDING])
    message = rig.messages[topics.RECORDING][0]
    names, table = snapshot_table(message)
    assert names == ["tick", "axis1.i_q", "time", "stamp.sec", "stamp.nanosec"]
    assert message.layout.dim[0].label == "50 points of 2 number(s) at 16000 Hz, trigger axis1.i_q > 1.0"
    assert len(table) == 50
    assert np.diff(table[:, 0]).tolist() == [1.0] * 49
    assert table[:, 2] == pytest.approx([(k - 15) * 62.5e-6 for k in range(50)])
    assert table[14, 1] <= 1.0 < table[15, 1]
    stamps = table[:, 3] + table[:, 4] * 1e-9
    assert stamps[-1] - stamps[0] == pytest.approx(49 * 62.5e-6, abs=1e-6)
    now = rig.user.get_clock().now().nanoseconds * 1e-9
    age = (rig.link.tick - table[-1, 0]) * 62.5e-6
    assert now - stamps[-1] == pytest.approx(age, abs=5.0)


def test_recorder_set_up_is_published_before_the_start_and_withdrawn(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[object] = []
    begin = BurstRecording._begin

    def started(recording: BurstRecording, prepared: Prepared) -> None:
        done.append("started")
        begin(recording, prepared)

    def stored_message(setup: RecorderSetup | None) -> Float64MultiArray:
        done.append(setup)
        return setup_message(setup)

    monkeypatch.setattr(BurstRecording, "_begin", started)
    monkeypatch.setattr("servo_bridge.bursts.record_service.setup_message", stored_message)
    rig.until(lambda: rig.messages[topics.RECORDER])  # a latched topic keeps its last message only
    assert rig.set_parameter("recording", "axis1.i_q param.i_q_limit --rate 4000 --points 30")[0]
    assert record(rig, True)[0]
    rig.until(lambda: rig.messages[topics.RECORDING] and len(rig.messages[topics.RECORDER]) == 3)
    names = ("tick", "axis1.i_q", "param.i_q_limit[0]", "param.i_q_limit[1]")
    setup = RecorderSetup(names, recorder=0, period_ns=250_000, points=30)
    assert done == [setup, "started", None]
    assert [setup_from_message(message) for message in rig.messages[topics.RECORDER]] == [None, setup, None]


def test_recording_without_trigger_is_ended_by_the_service(rig: Rig) -> None:
    assert rig.set_parameter("recording", "axis1.i_q --trigger 'axis1.i_q > 3' --points 50")[0]
    assert record(rig, False) == (False, "no recording in progress; call record with data: true first")
    assert record(rig, True)[0]
    again = record(rig, True)
    assert again == (False, "waiting for the trigger; call record with data: false to end it first")
    assert record(rig, False)[0]
    rig.until(lambda: rig.messages[topics.RECORDING])
    assert rig.messages[topics.RECORDING][0].layout.dim[0].label.endswith("> 3, stopped before the trigger")
    assert record(rig, True)[0]


def test_a_lost_link_ends_a_recording(rig: Rig) -> None:
    assert rig.set_parameter("recording", "axis1.i_q --trigger 'axis1.i_q > 3'")[0]
    assert record(rig, True)[0]
    rig.link.disconnect()
    rig.until(lambda: rig.warnings("the recording has failed: the link to the board was lost"))
    rig.link.session = None
    assert record(rig, True) == (False, "no link")
