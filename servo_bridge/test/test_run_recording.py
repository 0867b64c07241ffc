"""Recording of a run by the bridge."""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from bridge_rig import SPIN, Rig
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from servo_bridge.outcome import Outcome
from servo_bridge.runs.recorder import RunRecorder
from servo_msgs_py.convert import applied_from_message
from servo_msgs_py.run_file.reader import RunReader
from servo_msgs_py.run_file.run_info import run_info
from servo_msgs_py.run_file.series import Limits
from servo_msgs_py.run_file.topic import Topic
from servo_msgs_py.runtime.qos import latched_qos
from std_msgs.msg import Float64, Float64MultiArray, Int64MultiArray, String
from std_srvs.srv import SetBool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

RATE = Topic("/servo/var/u_dc", "std_msgs/msg/Float64")
STATE = Topic("/servo/state", "std_msgs/msg/String", depth=1, latched=True)
LOST = Topic("/servo/run_lost", "std_msgs/msg/UInt64")


class Recording:
    """A recorder without a node."""

    def __init__(self, path: Path, queue_max: int = 1_000_000) -> None:
        self.path = path
        self.begun: Future[Outcome] = Future()
        self.ended: Future[Outcome] = Future()
        latched = {STATE: serialize_message(String(data="before"))}
        self.recorder = RunRecorder(
            path, Limits(), latched, LOST, self.begun.set_result, self.ended.set_result, queue_max
        )

    def add(self, count: int) -> None:
        for k in range(count):
            self.recorder.add(RATE, serialize_message(Float64(data=float(k))), 1000 + k)

    def end(self) -> Outcome:
        self.recorder.end()
        return self.ended.result(10.0)


def test_everything_added_is_recorded_after_the_latched_messages(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "run.mcap")
    recording.add(500)
    assert recording.begun.result(10.0) == (True, f"recording to {recording.path}")
    assert recording.end()[0]
    reader = RunReader(recording.path)
    first, *others = reader.records()
    assert (first.topic, deserialize_message(first.data, String).data) == (STATE.name, "before")
    assert [(each.time_ns, deserialize_message(each.data, Float64).data) for each in others] == [
        (1000 + k, float(k)) for k in range(500)
    ]
    assert reader.troubles == []


def test_messages_beyond_the_queue_are_counted(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "run.mcap", queue_max=50_000)
    recording.add(2000)
    success, text = recording.end()
    report = recording.recorder.report
    assert success, text
    assert report.lost > 1000
    assert report.lost + report.written == 2001  # one is latched
    reader = RunReader(recording.path)
    list(reader.records())
    assert reader.troubles == [f"the recorder has lost {report.lost} messages because the computer was too slow"]


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """Files do not grow beyond a size [bytes], as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_start_that_fails_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.mcap").touch()
    success, reason = Recording(tmp_path / "run.mcap").begun.result(10.0)
    assert not success
    assert reason == f"{tmp_path}/run.mcap cannot be written (File exists); choose another path or name"
    monkeypatch.setitem(sys.modules, "servo_msgs_py.run_file.series_writer", None)
    assert "servo_msgs_py[record]" in Recording(tmp_path / "other.mcap").begun.result(10.0)[1]


def recorded(path: Path, topic: str, kind: type) -> list[Any]:
    """Messages of a topic in a recording."""
    return [deserialize_message(record.data, kind) for record in RunReader(path).records([topic])]


def test_a_run_is_recorded_whole(tmp_path: Path) -> None:
    """What was published and received, also before the start if it is latched, and what other nodes publish."""
    path = tmp_path / "run.mcap"
    with Rig(run_file_duration=600.0) as rig:
        twin = Node("twin", namespace="twin", context=rig.context)
        twin.create_publisher(String, topics.STATE, latched_qos()).publish(String(data="following"))
        client = rig.user.create_client(SetBool, topics.RECORD_RUN)
        rig.until(client.service_is_ready)
        assert rig.call(client, SetBool.Request(data=True)) == (
            False,
            "the parameter run_file is empty; set it to the path of a .mcap file first",
        )
        assert rig.set_parameter("run_file", str(path)) == (True, "")
        rig.enable_axes()
        assert rig.call(client, SetBool.Request(data=True)) == (True, f"recording to {path}")
        command = JointState(name=["axis1"], velocity=[1.0])
        rig.joint_commands.publish(command)
        rig.until(rig.accepted)

        def applied() -> bool:
            rig.link.sample()
            return any(one.variable == "cmd.speed" for one in rig.applied())

        rig.until(applied)
        assert rig.enable(False)[0]
        rig.diagnosis("run recording")
        rig.until(lambda: twin.count_subscribers(topics.STATE) > 0)
        time.sleep(0.3)
        rig.wait_for_pending()
        status = rig.diagnosis("run recording")
        assert (status.level, status.message) == (DiagnosticStatus.OK, f"to {path}")
        success, text = rig.call(client, SetBool.Request(data=False))
        assert success, text
        twin.destroy_node()
    for topic, kind in ((topics.COMMANDS_APPLIED, Int64MultiArray), (topics.SNAPSHOT, Float64MultiArray)):
        found = recorded(path, f"/servo/{topic}", kind)
        first = rig.messages[topic].index(found[0])
        assert found == rig.messages[topic][first : first + len(found)]
    commands = map(applied_from_message, recorded(path, "/servo/commands_applied", Int64MultiArray))
    assert {"cmd.mode", "cmd.speed", "cmd.enable"} <= {each.variable for each in commands}
    assert recorded(path, "/servo/joint_commands", JointState)[0] == command
    assert recorded(path, "/servo/state", String)[0].data == "axis1=RUN/SPIN axis2=RUN/SPIN"
    assert recorded(path, "/twin/state", String)[0].data == "following"
    calls = [json.loads(message.data) for message in recorded(path, "/servo/calls", String)]
    disabling = calls.index({"service": "/servo/enable", "request": {"data": False}})
    assert {"service", "response"} == set(calls[disabling + 1])
    assert calls[disabling + 1]["response"]["success"] is True
    assert calls[-1] == {"service": "/servo/record_run", "request": {"data": False}}
    info = run_info(recorded(path, "/servo/run_info", String)[-1].data)
    assert info.board["name"] == "fake"
    assert len(info.parameters) > 10
    assert RunReader(path).troubles == []


def test_a_full_disk_ends_the_recording_and_not_the_drive(tmp_path: Path) -> None:
    path = tmp_path / "%Y" / "run.mcap"
    with Rig(run_file=str(path)) as rig:
        rig.connect(SPIN, SPIN)
        recording = rig.bridge.supervisor
        assert recording is not None
        rig.until(lambda: recording.parts.run.report and recording.parts.run.report.size > 0)
        with disk_of(2000):
            while not rig.warnings("recorded"):
                rig.link.sample()
                rig.executor.spin_once(timeout_sec=0.01)
        assert "File too large" in rig.warnings("recorded")[0]
        status = rig.diagnosis("run recording")
        assert status.level == DiagnosticStatus.ERROR
        assert rig.enable(True)[0]
    (file,) = tmp_path.rglob("*.mcap")
    assert file.parent.name == time.strftime("%Y")
    assert "/servo/run_info" in {each.topic for each in RunReader(file).records()}


def test_the_end_of_the_bridge_completes_the_recording_which_leaves_topics_out(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Rig(run_file=str(path), run_left_out=["joint_states", "var/", "/servo/state"]) as rig:
        rig.enable_axes()
        rig.link.sample()
    names = {record.topic for record in RunReader(path).records()}
    assert {"/servo/snapshot", "/servo/armed", "/servo/link"} <= names
    assert not {name for name in names if name in ("/servo/joint_states", "/servo/state") or "/var/" in name}
    assert recorded(path, "/servo/link", DiagnosticStatus)[-1].message == "the bridge was stopped"
    reader = RunReader(path)
    assert list(reader.records())
    assert reader.troubles == []
