"""Fault records: over a pty to the link and ``servo-tool``, and over ROS to a topic."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bridge_rig import FAULT, STOP, Rig
from fake_port import FakePort
from fake_servo import CATALOGUE, FakeServo
from fake_target import Reader
from link_watcher import TIMEOUT, Watcher
from rcl_interfaces.msg import Log
from recorded_fault import NONE, decoded, recorded
from servo_bridge.freemaster.errors import TransportError
from servo_bridge.wire.link import LinkState
from servo_msgs_py.convert import snapshot_table
from servo_msgs_py.fault_record import UNITS
from servo_msgs_py.runtime.qos import latched_qos
from std_msgs.msg import Float64MultiArray

from servo_bridge import tool
from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

READ_MEMORY = 0x21
TOPIC = topics.fault_record_topic("axis1")
PHASE_LOST, OVER_VOLTAGE = (CATALOGUE.flag("faults", name).mask for name in ("PHASE_LOST", "OVER_VOLTAGE"))
LOST = recorded("PHASE_LOST", 8003, i_q=4000)


@pytest.fixture
def faulted(fake_board: FakeServo) -> FakeServo:
    """Fake board with a fault of the first axis."""
    fake_board.poke(fake_board.addresses["axis1.fault_record"], LOST)
    return fake_board


def stop_answers_in_the_record(board: FakeServo, port: FakePort) -> threading.Event:
    """Stop all answers after the first piece of the record; return the event that is set then."""
    start = board.addresses["axis1.fault_record"]
    reached = threading.Event()

    def mangle(answer: bytes) -> bytes:
        command, payload = board.requests[-1]
        if command == READ_MEMORY and start < Reader(payload).uleb() < start + len(LOST):
            reached.set()
        return b"" if reached.is_set() else answer

    port.mangle = mangle
    return reached


# ---- the link -------------------------------------------------------------------------------------------------------
def test_record_is_read_in_several_pieces(faulted: FakeServo, connected: Watcher) -> None:
    """The pieces are as long as the buffer of the board."""
    before = len(faulted.requests)
    assert connected.link.read("axis1.fault_record").result(TIMEOUT) == LOST
    addresses = {Reader(payload).uleb() for command, payload in faulted.requests[before:] if command == READ_MEMORY}
    assert len(addresses) >= 3


def test_record_is_read_again_after_link_loss_during_the_read(
    faulted: FakeServo, fake_port: FakePort, connected: Watcher
) -> None:
    """The read fails, and the record is read after the reconnection."""
    reached = stop_answers_in_the_record(faulted, fake_port)
    reading = connected.link.read("axis1.fault_record")
    assert reached.wait(TIMEOUT)
    fake_port.unplug()
    with pytest.raises(TransportError, match="is lost"):
        reading.result(TIMEOUT)
    connected.wait_state(LinkState.DISCONNECTED)
    fake_port.mangle = lambda answer: answer
    fake_port.plug()
    connected.wait_state(LinkState.CONNECTED)
    assert connected.link.read("axis1.fault_record").result(TIMEOUT) == LOST


# ---- servo-tool -----------------------------------------------------------------------------------------------------
Run = Callable[..., int]


@pytest.fixture
def run(fake_port: FakePort, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.delenv("SERVO_BAUD", raising=False)
    return lambda *arguments: tool.main(["--port", fake_port.path, *arguments])


def test_snapshot_prints_fault_remedy_and_samples(
    faulted: FakeServo, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("snapshot") == 0
    first, cause, heads, *rows, second = capsys.readouterr().out.splitlines()
    assert first.startswith("axis1: first fault PHASE_LOST in RUN/SPIN, 0.5002 s after reset")
    flag = CATALOGUE.flag("faults", "PHASE_LOST")
    assert flag.cause in cause
    assert flag.remedy in cause
    assert heads.split()[::2][:1] == ["time"]
    assert len(rows) == 64
    numbers = np.array([[float(word) for word in row.split()] for row in rows])
    table = decoded(LOST).samples.table() * np.array([1e3, 1, 1, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(numbers, table, atol=0.5001e-4)
    assert second == "axis2: no fault"


def test_snapshot_is_drawn_as_a_picture(faulted: FakeServo, run: Run, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "fault.png"
    assert run("snapshot", "--plot", str(picture)) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("axis", "status", "text"), [("1", 0, "PHASE_LOST"), ("2", 1, "axis2: no fault")])
def test_snapshot_prints_the_selected_axis_only(
    faulted: FakeServo, run: Run, axis: str, status: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("snapshot", axis) == status
    out = capsys.readouterr().out
    assert text in out
    assert f"axis{3 - int(axis)}" not in out


def test_snapshot_reports_link_loss_during_the_read(
    faulted: FakeServo, fake_port: FakePort, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    reached = stop_answers_in_the_record(faulted, fake_port)
    status: list[int] = []
    thread = threading.Thread(target=lambda: status.append(run("snapshot")))
    thread.start()
    assert reached.wait(TIMEOUT)
    fake_port.unplug()
    thread.join(TIMEOUT)
    assert status == [1]
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "is lost" in printed.err


# ---- the topic ------------------------------------------------------------------------------------------------------
@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as result:
        result.listen(TOPIC, Float64MultiArray, latched_qos())
        result.link.blocks = {"axis1.fault_record": LOST, "axis2.fault_record": NONE}
        result.connect()
        yield result


def fail(rig: Rig, word: int) -> None:
    """Deliver samples with faults of the first axis."""
    rig.link.set_states(FAULT if word else STOP, STOP)
    rig.link.values["axis1.faults"] = word
    rig.link.sample()
    rig.link.sample()


def published(message: Float64MultiArray) -> tuple[str, list[Any]]:
    names, table = snapshot_table(message)
    assert names == list(UNITS)
    return message.layout.dim[0].label, table.tolist()


def test_fault_is_published_with_its_record(rig: Rig) -> None:
    fail(rig, PHASE_LOST)
    rig.until(lambda: rig.messages[TOPIC])
    record = decoded(LOST)
    assert [published(message) for message in rig.messages[TOPIC]] == [
        (record.summary(), record.samples.table().tolist())
    ]
    rig.until(lambda: f"axis1: first fault {record.summary()}" in rig.logs(Log.ERROR))
    values = {pair.key: pair.value for pair in rig.diagnosis("axis1").values}
    assert values["first fault tick"] == "8003"
    assert values["first fault"] == record.summary()


def test_no_record_is_published_after_link_loss_during_the_read(rig: Rig) -> None:
    """An incomplete record is not published; it is read again after the reconnection."""
    rig.link.pending_reads = []
    fail(rig, PHASE_LOST)
    rig.until(lambda: rig.link.pending_reads)
    rig.link.disconnect()
    rig.until(lambda: rig.state().startswith("DISCONNECTED"))
    assert rig.messages[TOPIC] == []
    rig.link.pending_reads = None
    rig.connect(FAULT, STOP)
    rig.until(lambda: rig.messages[TOPIC])
    assert published(rig.messages[TOPIC][-1])[1] == decoded(LOST).samples.table().tolist()
