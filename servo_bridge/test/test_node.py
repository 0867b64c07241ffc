"""The node under real rclpy with a fake link: topics, services, failures."""

from __future__ import annotations

import gc
import itertools
import math
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest
from bridge_rig import SPIN, STOP, FakeLink, Rig
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_bridge.parameters import ParameterError
from servo_bridge.wire.link_state import LinkState
from servo_bridge.wire.link_statistics import LinkStatistics
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand, from_stamp, snapshot_table
from servo_msgs_py.joints import Joint, JointLimits
from servo_msgs_py.robot_description import joints_of
from servo_msgs_py.runtime.qos import command_qos, latched_qos
from std_msgs.msg import Float64, Float64MultiArray

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CATALOGUE = Catalogue.load()
COUNT = CATALOGUE["axis1.position"].lsb
TURN = 2.0 * math.pi


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as result:
        yield result


def writes(rig: Rig, count: int) -> list[Any]:
    """Deliver samples until `count` writes have been sent."""

    def sent() -> bool:
        rig.link.sample()
        return len(rig.link.written) >= count

    rig.until(sent)
    return rig.link.written


# ---- telemetry
def test_joint_states_are_si_and_stamped_with_board_time(rig: Rig) -> None:
    rig.connect()
    rig.until(lambda: rig.messages[topics.PARAMETERS])
    rig.link.values.update({"axis1.position": 4000, "axis2.speed": CATALOGUE["axis2.speed"].to_raw(100.0)})
    rig.link.values["axis2.i_q"] = CATALOGUE["axis2.i_q"].to_raw(2.0)
    for _ in range(5):
        rig.link.sample()
    rig.until(lambda: len(rig.messages[topics.JOINT_STATES]) >= 6)
    messages = rig.messages[topics.JOINT_STATES][-5:]
    newest = messages[-1]
    assert list(newest.name) == ["axis1", "axis2"]
    assert list(newest.position) == pytest.approx([TURN, 0.0])
    assert list(newest.velocity) == pytest.approx([0.0, 100.0])
    assert list(newest.effort) == pytest.approx([0.0, 0.1], rel=1e-3)
    stamps = [from_stamp(m.header.stamp) for m in messages]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    assert abs(stamps[-1] - time.time_ns()) < 5e9


def test_backlog_is_few_snapshots_without_a_loss(rig: Rig) -> None:
    rig.link.connect()
    first = rig.link.tick + 16
    for k in range(2400):  # the executor is blocked for 2.4 s
        rig.link.sample(age=1e-3 * (2400 - k))
    rig.link.disconnect()  # publishes the rest
    rig.until(lambda: rig.snapshots() and rig.snapshots()[-1]["tick"] == rig.link.tick)
    assert [row["tick"] for row in rig.snapshots()] == [first + 16 * k for k in range(2400)]
    assert len(rig.messages[topics.SNAPSHOT]) < 20
    rig.until(lambda: len(rig.messages[topics.JOINT_STATES]) >= 90)
    assert len(rig.messages[topics.JOINT_STATES]) <= 110  # of the last 0.1 s


def test_diagnostics_come_with_the_samples_when_the_timers_stand_still(rig: Rig) -> None:
    """As after the system clock was set back, with a ROS built for an old C library."""
    rig.connect()
    for timer in rig.bridge.timers:
        timer.cancel()
    before = len(rig.messages[topics.DIAGNOSTICS])

    def renewed() -> bool:
        rig.link.sample()
        return len(rig.messages[topics.DIAGNOSTICS]) > before + 1

    rig.until(renewed)


def test_every_sample_is_in_the_snapshots_exactly_once(rig: Rig) -> None:
    rig.connect()
    for _ in range(100):
        rig.link.sample()
    last = rig.link.tick
    rig.link.disconnect()  # publishes the rest of the last batch
    rig.until(lambda: rig.snapshots() and rig.snapshots()[-1]["tick"] == last)
    ticks = [row["tick"] for row in rig.snapshots()]
    assert ticks == [last - 16 * k for k in range(len(ticks))][::-1]
    assert len(ticks) >= 100 > len(rig.messages[topics.SNAPSHOT])
    assert {"axis1.position_ref", "axis2.speed", "u_dc", "applied_count"} <= rig.snapshots()[0].keys()
    stamps = [(int(row["stamp.sec"]), int(row["stamp.nanosec"])) for row in rig.snapshots()]
    rig.until(lambda: len(rig.messages[topics.JOINT_STATES]) == len(stamps))
    headers = (message.header.stamp for message in rig.messages[topics.JOINT_STATES])
    assert stamps == [(stamp.sec, stamp.nanosec) for stamp in headers]


def test_joint_states_rate_is_the_maximum_rate() -> None:
    with Rig(joint_states_rate=100.0, snapshot_period=0.0) as rig:
        rig.connect()
        for _ in range(100):
            rig.link.sample(periods=32)  # 500 samples per second of board time
        rig.until(lambda: len(rig.messages[topics.SNAPSHOT]) >= 101)
        assert 19 <= len(rig.messages[topics.JOINT_STATES]) <= 22


def test_variables_come_from_the_sample_or_are_read() -> None:
    with Rig(variables=["axis1.i_q", "param.host_timeout", "cmd.position"], variable_rate=50.0) as rig:
        values: list[float] = []
        rig.link.parameters["param.host_timeout"] = [3000]
        rig.user.create_subscription(Float64, "var/param/host_timeout", lambda m: values.append(m.data), 10)
        rig.until(lambda: rig.user.count_publishers("var/param/host_timeout"))
        assert rig.user.count_publishers("var/cmd/position/axis2") == 1
        rig.link.values["axis1.i_q"] = CATALOGUE["axis1.i_q"].to_raw(1.0)
        rig.connect()
        rig.until(lambda: values and rig.messages["var/axis1/i_q"])
        assert rig.messages["var/axis1/i_q"][-1].data == pytest.approx(1.0, abs=1e-3)
        assert values[-1] == 1.5
        assert "axis1.i_q" not in rig.link.reads


def test_state_and_armed_follow_the_board(rig: Rig) -> None:
    assert rig.state().startswith("DISCONNECTED ")
    assert not rig.armed()
    rig.connect(STOP, SPIN)
    assert rig.state() == "axis1=STOP axis2=RUN/SPIN"
    assert rig.enable(True)[0]
    assert not rig.armed()
    rig.link.set_states(SPIN, SPIN)
    rig.link.sample()
    rig.until(lambda: rig.armed() and rig.state() == "axis1=RUN/SPIN axis2=RUN/SPIN")
    for _ in range(5):
        rig.link.sample()
    rig.wait_for_pending()
    assert [m.data for m in rig.messages[topics.ARMED]] == [False, True]
    assert len(rig.messages[topics.STATE]) == len({m.data for m in rig.messages[topics.STATE]})


# ---- set-points
def test_joint_command_is_one_write_to_both_axes_and_reports_its_tick(rig: Rig) -> None:
    rig.enable_axes()
    rig.joint_commands.publish(JointState(name=["axis2", "axis1"], position=[TURN, -TURN]))
    assert writes(rig, 2) == [("cmd.mode", 0, (0, 0)), ("cmd.position", 0, (-4000, 4000))]
    rig.link.sample()
    rig.until(lambda: len(rig.applied()) >= 4)
    tick = rig.link.values["applied_tick"]
    assert rig.applied()[-1] == AppliedCommand("cmd.position", tick, (-4000, 4000), 3)
    assert [a.variable for a in rig.applied()] == ["cmd.quick_stop", "cmd.enable", "cmd.mode", "cmd.position"]


def test_commands_array_and_single_position(rig: Rig) -> None:
    rig.enable_axes()
    rig.commands.publish(Float64MultiArray(data=[TURN, TURN]))
    writes(rig, 2)
    rig.position.publish(Float64(data=2 * TURN))
    assert writes(rig, 3)[1:] == [("cmd.position", 0, (4000, 4000)), ("cmd.position", 1, (8000,))]


@pytest.mark.parametrize(("field", "variable"), [("velocity", "cmd.speed"), ("effort", "cmd.i_q")])
def test_repeated_message_renews_the_set_point_and_nothing_is_written_without_messages(
    rig: Rig, field: str, variable: str
) -> None:
    rig.enable_axes()
    message = JointState(name=["axis1", "axis2"])
    setattr(message, field, [0.05, 0.05])
    for count in (2, 3, 4):  # the mode is written first
        rig.joint_commands.publish(message)
        assert writes(rig, count)[-1] == rig.link.written[1]
    assert [name for name, _, _ in rig.link.written] == ["cmd.mode"] + 3 * [variable]
    end = time.monotonic() + 0.7
    rig.until(lambda: time.monotonic() > end)
    rig.wait_for_pending()
    assert len(rig.link.written) == 4


WRONG = [  # all invalid forms: test_set_points.py
    (JointState(name=["elbow"], position=[1.0]), "joint 'elbow' does not exist; the joints are axis1, axis2"),
    (JointState(name=["axis1"], effort=[1.0], velocity=[1.0]), "a velocity and an effort, but no position"),
    (JointState(name=["axis1"], position=[1e9]), "outside -1.68663e+06 .. 1.68663e+06 rad"),
    (JointState(name=["axis1"], velocity=[-1000.0]), "outside -419 .. 419 rad/s"),
    (JointState(name=["axis1"], effort=[9.0]), "effort of axis1 is 9 N m, outside"),
]


def test_invalid_joint_commands_are_refused_with_their_reason(rig: Rig) -> None:
    rig.enable_axes()
    for message, sentence in WRONG:
        seen = len(rig.rejections())
        rig.joint_commands.publish(message)
        rig.until_rejected(seen)
        assert "rejected, no motion: joint_commands: " in rig.rejections()[-1]
        assert sentence in rig.rejections()[-1]
    rig.wait_for_pending()
    assert rig.link.written == []


def test_invalid_arrays_are_refused(rig: Rig) -> None:
    rig.enable_axes()
    for data in ([], [1.0], [math.nan, 0.0], [1e9, 0.0]):
        seen = len(rig.rejections())
        rig.commands.publish(Float64MultiArray(data=data))
        rig.until_rejected(seen)
        assert "commands: " in rig.rejections()[-1]
    rig.wait_for_pending()
    assert rig.link.written == []


def test_set_points_before_enable_are_refused(rig: Rig) -> None:
    rig.connect(SPIN, SPIN)
    rig.position.publish(Float64(data=1.0))
    rig.until(rig.rejections)
    assert "axis2/position: the outputs have not been enabled" in rig.rejections()[0]
    rig.wait_for_pending()
    assert rig.link.written == []


def test_a_stream_of_wrong_commands_does_not_flood_the_log(rig: Rig) -> None:
    rig.enable_axes()
    for k in range(60):
        name = f"joint{k}"
        rig.joint_commands.publish(JointState(name=[name], position=[0.0]))
        rig.until(partial(rig.was_rejected, name))  # depth of the topic
    status = rig.diagnosis("commands")
    assert status.level == b"\x01"
    assert "rejected: joint_commands: joint 'joint59'" in status.message
    rig.commands.publish(Float64MultiArray(data=[0.0] * 9))  # has its own throttle, logged after all others
    rig.until(lambda: any("commands: 9 values" in text for text in rig.rejections()))
    assert 20 <= sum("'joint" in text for text in rig.rejections()) <= 30


# ---- services
def test_enable_writes_and_answers_when_it_took_effect(rig: Rig) -> None:
    rig.connect()
    success, text = rig.enable(True)
    assert success
    assert "axis1 is in STOP, axis2 is in STOP; set-points are accepted when armed is true" in text
    assert rig.link.written == [("cmd.enable", 0, (1, 1))]
    success, _ = rig.enable(False)
    assert success
    assert rig.link.written[1:] == [("cmd.enable", 0, (0, 0))]


def test_services_report_the_reason_of_a_missing_link(rig: Rig) -> None:
    rig.link.disconnect(reason="nothing answers", remedy="check the cable")
    rig.until(lambda: "nothing answers" in rig.state())
    for answer in (rig.enable(True), rig.enable(False), rig.quick_stop(), rig.clear_faults()):
        assert not answer[0]
        assert "not connected: nothing answers" in answer[1]


def test_quick_stop_blocks_set_points_until_enable(rig: Rig) -> None:
    rig.enable_axes()
    assert rig.quick_stop()[0]
    assert rig.link.written == [("cmd.quick_stop", 0, (1, 1))]
    rig.until(lambda: not rig.armed())
    rig.commands.publish(Float64MultiArray(data=[1.0, 1.0]))
    rig.until(rig.rejections)
    assert "stopped by the service quick_stop; call the service enable" in rig.rejections()[0]
    assert rig.enable(True)[0]
    rig.until(rig.armed)
    rig.commands.publish(Float64MultiArray(data=[1.0, 1.0]))
    assert [w[0] for w in writes(rig, 4)] == ["cmd.quick_stop", "cmd.enable", "cmd.mode", "cmd.position"]


# ---- a lost link
def test_link_loss_discards_set_points_and_needs_a_new_enable(rig: Rig) -> None:
    rig.enable_axes()
    rig.link.ignores_writes = True
    rig.commands.publish(Float64MultiArray(data=[1.0, 1.0]))
    rig.until(lambda: rig.link.written)
    rig.link.written.clear()
    rig.link.disconnect(reason="port vanished")
    rig.until(lambda: rig.state() == "DISCONNECTED port vanished; plug it in" and not rig.armed())
    rig.until(lambda: rig.messages[topics.LINK][-1].level == DiagnosticStatus.ERROR)
    assert [(m.level, m.message) for m in rig.messages[topics.LINK]][-2:] == [
        (DiagnosticStatus.OK, "connected"),
        (DiagnosticStatus.ERROR, "port vanished; plug it in"),
    ]
    rig.commands.publish(Float64MultiArray(data=[2.0, 2.0]))
    rig.until(rig.rejections)
    assert "not connected (port vanished)" in rig.rejections()[0]
    rig.link.ignores_writes = False
    rig.connect(SPIN, SPIN)
    for _ in range(10):
        rig.link.sample()
    rig.commands.publish(Float64MultiArray(data=[3.0, 3.0]))
    rig.until(lambda: len(rig.rejections()) >= 2)
    assert "the link to the board was lost; call the service enable" in rig.rejections()[1]
    assert rig.link.written == []
    assert not rig.armed()
    assert rig.enable(True)[0]
    rig.until(rig.armed)


def test_every_change_of_the_link_is_one_line_and_an_error_in_diagnostics(rig: Rig) -> None:
    rig.connect()
    rig.link.link_statistics = LinkStatistics(sample_rate=128.0)
    assert (rig.diagnosis("link").level, rig.diagnosis("link").message) == (b"\x00", "128 samples/s")
    rig.link.link_statistics = LinkStatistics(sample_rate=128.0, crc_errors=3)
    assert rig.diagnosis("link").message == "in the last second: 3 crc errors"
    rig.link.disconnect(LinkState.FAILED, "another table of variables", "flash the firmware of this release")
    rig.until(lambda: rig.state().startswith("DISCONNECTED"))
    link = rig.diagnosis("link")
    assert (link.level, link.message) == (b"\x02", "another table of variables; flash the firmware of this release")
    assert link.hardware_id == f"fake table {CATALOGUE.hash:08X}", "independent of the port"
    for part in ("board", "axis1", "axis2"):
        assert rig.diagnosis(part).level == b"\x02"
    rig.until(lambda: rig.logs(40))
    assert rig.logs(40) == ["another table of variables; flash the firmware of this release"]


def test_a_hot_winding_is_a_warning_and_its_temperature_a_topic(rig: Rig) -> None:
    """Both are read in addition to the telemetry."""
    found: list[list[float]] = []
    rig.user.create_subscription(
        Float64MultiArray,
        topics.WINDING_TEMPERATURES,
        lambda message: found.append(list(message.data)),
        latched_qos(),
    )
    rig.link.parameters["param.i_q_limit"] = [CATALOGUE["param.i_q_limit"].to_raw(4.0)] * 2
    for axis, celsius, current in (("axis1", 115.0, 3.0), ("axis2", 80.0, 8.25)):
        rig.link.values |= {f"{axis}.winding_temperature": celsius, f"{axis}.winding_current": current}  # type: ignore[dict-item]
    rig.connect()
    rig.until(lambda: rig.diagnosis("axis1").level == b"\x01")
    assert "hot winding: current limit derated to 75 %" in rig.diagnosis("axis1").message
    assert rig.diagnosis("axis2").level == b"\x00"
    rig.until(lambda: bool(found))
    assert found[-1] == [115.0, 80.0]


def test_board_reset_restarts_time_and_positions(rig: Rig) -> None:
    rig.link.tick = 16_000 * 3600
    rig.link.values["axis1.position"] = 2**31 - 1
    rig.connect()
    rig.link.sample()  # waits for its snapshot message
    rig.link.epoch, rig.link.tick, rig.link.values["axis1.position"] = 1, 0, -(2**31)
    for _ in range(3):
        rig.link.sample()
    rig.until(lambda: len(rig.messages[topics.JOINT_STATES]) >= 5)
    newest = rig.messages[topics.JOINT_STATES][-1]
    assert newest.position[0] < 0.0
    assert abs(from_stamp(newest.header.stamp) - time.time_ns()) < 60e9
    rig.link.disconnect()
    rig.until(lambda: len(rig.snapshots()) >= 5)
    for message in rig.messages[topics.SNAPSHOT]:
        names, table = snapshot_table(message)
        assert all(later > earlier for earlier, later in itertools.pairwise(table[:, names.index("tick")]))


# ---- parameters


def test_a_bridge_that_failed_to_start_leaves_the_log_of_the_next_one_working() -> None:
    """Its objects may be garbage-collected while the next node of the same name runs."""
    with pytest.raises(ParameterError) as refused, Rig(joints=["one"]):
        pass
    with Rig() as rig:
        del refused
        gc.collect()
        rig.enable_axes()
        rig.commands.publish(Float64MultiArray(data=[1.0]))
        rig.until(rig.rejections)


def test_joint_names_reach_topics_and_messages() -> None:
    with Rig(joints=["pan", "axis2"], variables=["axis1.i_q", "cmd.position"]) as rig:
        rig.connect()
        assert rig.state() == "pan=STOP axis2=STOP"
        assert rig.user.count_subscribers("pan/position") == 1
        for name in ("var/pan/i_q", "var/cmd/position/pan", "var/cmd/position/axis2"):
            assert rig.user.count_publishers(name) == 1, name
        assert rig.user.count_publishers("var/axis1/i_q") == 0


GEARS = {
    "joints": ["arm", "axis2"],
    "gear_ratio": [10.0, 1.0],
    "direction": [-1, 1],
    "offset": [0.5, 0.0],
    "position_min": [-1.0, -1.0e15],
    "position_max": [2.0, 1.0e15],
}


def test_ros_uses_joint_units_and_the_board_motor_units() -> None:
    with Rig(**GEARS) as rig:
        counts = 800
        rig.link.values |= {"axis1.position": counts, "axis2.position": counts}
        for name, amount in (("speed", 20.0), ("i_q", 0.5)):
            rig.link.values[f"axis1.{name}"] = CATALOGUE[f"axis1.{name}"].to_raw(amount)
        rig.enable_axes()
        states = rig.messages[topics.JOINT_STATES]
        rig.until(lambda: states and len(states[-1].effort) == 2)
        arm = next(iter(zip(states[-1].position, states[-1].velocity, states[-1].effort, strict=True)))
        assert arm == pytest.approx((0.5 - counts * COUNT / 10.0, -2.0, -10.0 * 0.04 * 0.5), rel=1e-3)
        assert states[-1].position[1] == counts * COUNT
        rig.until(rig.snapshots)
        assert rig.snapshots()[-1]["axis1.position"] == counts * COUNT

        rig.joint_commands.publish(JointState(name=["arm"], position=[0.5 - 400.0 * COUNT]))

        def written() -> list[Any]:
            rig.link.sample()
            return [write for write in rig.link.written if write[0] == "cmd.position"]

        rig.until(written)
        assert written() == [("cmd.position", 0, (4000,))]
        rig.joint_commands.publish(JointState(name=["arm"], position=[2.5]))
        rig.until_rejected(0)
        assert "position of arm is 2.5 rad, outside -1 .. 2 rad" in rig.rejections()[0]


def test_the_description_has_the_joints_and_follows_their_limits() -> None:
    with Rig(**GEARS, command_interfaces=["position", "velocity"]) as rig:
        messages = rig.messages[topics.ROBOT_DESCRIPTION]
        rig.until(lambda: messages)
        arm, other = joints_of(messages[-1].data)
        assert arm == Joint("arm", 10.0, -1, 0.5, JointLimits(-1.0, 2.0, 41.9, 1.0))
        assert other == Joint("axis2", limits=JointLimits(velocity_max=419.0, effort_max=1.0))
        for topic in ("/servo/joint_commands", "/servo/joint_states"):
            assert f">{topic}</param>" in messages[-1].data
        assert messages[-1].data.count("<command_interface ") == 2
        assert rig.set_parameter("position_max", [1.5, 1.0e15])[0]
        rig.until(lambda: joints_of(messages[-1].data)[0].limits.position_max == 1.5)
        assert rig.set_parameter("preferred_source", "commands")[0]
        assert not rig.set_parameter("gear_ratio", [20.0, 1.0])[0]
        rig.wait_for_pending()
        assert len(messages) == 2


def test_limits_change_at_run_time_and_the_port_does_not(rig: Rig) -> None:
    rig.enable_axes()
    change = rig.set_parameter
    assert change("position_max", [1.0, 1.0])[0]
    rig.commands.publish(Float64MultiArray(data=[0.0, 1.5]))
    rig.until(rig.rejections)
    assert "position of axis2 is 1.5 rad, outside -1.68663e+06 .. 1 rad" in rig.rejections()[0]
    assert not change("port", "/dev/other")[0]
    refused = change("position_min", [2.0, 2.0])
    assert not refused[0]
    assert "above position_max" in refused[1]


# ---- parameters of the board
def value(name: str, raw: int) -> float:
    return float(CATALOGUE[name].scale(raw))


def test_parameters_of_the_board_are_published_at_every_connection(rig: Rig) -> None:
    rig.connect()
    rig.until(lambda: rig.parameters() == rig.link.parameters)
    assert rig.diagnosis("parameters").message == "as requested"
    rig.link.disconnect()
    rig.link.parameters["param.features"] = [7, 8]
    rig.connect()
    rig.until(lambda: rig.parameters() == rig.link.parameters)
    values = {pair.key: pair.value for pair in rig.diagnosis("parameters").values}
    assert values["param.features"] == "7, 8 (ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION, DEAD_TIME)"
    assert not [name for name, _, _ in rig.link.written if name.startswith("param.")]


def test_requested_parameters_are_written_at_the_connection_and_when_they_change() -> None:
    with Rig(board_parameters=["param.features[1]=DEAD_TIME+FRICTION", "param.i_q_limit=1.0,1.5"]) as rig:
        before = rig.link.parameters["param.features"][0]
        rig.connect()
        rig.until_sampled(lambda: rig.parameters() and rig.parameters()["param.features"] == [before, 0b11000])
        limits = [value("param.i_q_limit", raw) for raw in rig.parameters()["param.i_q_limit"]]
        assert limits == pytest.approx([1.0, 1.5], abs=1e-3)
        assert [name for name, _, _ in rig.link.written] == ["param.i_q_limit", "param.features"]
        assert [(one.variable, one.mask) for one in rig.applied()[-2:]] == [
            ("param.i_q_limit", 3),
            ("param.features", 3),
        ]
        rig.until_sampled(lambda: any("param.features: " in t and "DEAD_TIME+FRICTION)" in t for t in rig.logs(0)))
        assert rig.set_parameter("board_parameters", ["param.features[0]=FRICTION"])[0]
        rig.until_sampled(lambda: rig.parameters()["param.features"] == [0b10000, 0b11000])
        rig.link.parameters["param.features"] = [0, 0]
        rig.link.disconnect()
        rig.connect()
        rig.until_sampled(lambda: rig.parameters()["param.features"] == [0b10000, 0])


@pytest.mark.parametrize(
    ("texts", "reason"),
    [
        (["param.features[0]=ANTI_WINDUP+FOO"], "'FOO' is not a number or one of the names none, ANTI_WINDUP"),
        (["param.i_q_limit[0]=1", "param.i_q_limit[1]=9"], "param.i_q_limit: 9 is outside 0.1 .. 4 A"),
        (["cmd.enable[0]=1"], "cmd.enable is not a parameter"),
        (
            ["param.position_min[1]=2"],
            "param.position_min[1] 1.99962 rad exceeds param.position_max[1] 1.0006 rad",
        ),
        (["param.position_min=2,2", "param.position_max=1,3"], " exceeds "),
    ],
)
def test_parameters_that_do_not_fit_are_refused_with_the_reason(rig: Rig, texts: list[str], reason: str) -> None:
    one = CATALOGUE["param.position_max"].to_raw(1.0)
    rig.link.parameters["param.position_max"] = [one, one]
    rig.connect()
    rig.until(rig.parameters)
    done, text = rig.set_parameter("board_parameters", texts)
    assert not done
    assert text.startswith("parameter board_parameters: ")
    assert reason in text
    assert not [name for name, _, _ in rig.link.written if name.startswith("param.")]


def test_requested_parameters_that_the_board_refuses_are_an_error() -> None:
    with Rig(board_parameters=["param.position_min[0]=2"]) as rig:
        rig.link.parameters["param.position_max"] = [0, 0]
        rig.connect()
        rig.until(lambda: rig.parameters() and any("no motion would be possible" in text for text in rig.logs()))
        assert rig.parameters() == rig.link.parameters
        status = rig.diagnosis("parameters")
        assert (status.level, "no motion would be possible" in status.message) == (b"\x01", True)
        rig.link.rejected_parameter = "param.features"
        assert rig.set_parameter("board_parameters", ["param.features[0]=FRICTION"])[0]
        rig.until_sampled(lambda: any("the board has another value" in text for text in rig.logs()))


def test_invalid_board_parameters_prevent_the_start() -> None:
    with pytest.raises(ParameterError, match="FOO"):
        Rig(board_parameters=["param.features[0]=FOO"])


# ---- end
def test_shutdown_disables_the_axes_and_logs_it(rig: Rig) -> None:
    rig.enable_axes()
    link: FakeLink = rig.link
    rig.bridge.shutdown()
    assert [(name, list(values)) for name, values in link.final_writes] == [("cmd.enable", [0.0, 0.0])]
    rig.until(lambda: rig.state() == "DISCONNECTED the bridge was stopped" and not rig.armed())


# ---- two sources
def test_two_sources_are_reported_and_one_can_have_precedence(rig: Rig) -> None:
    rig.enable_axes()
    other = Node("teleop", context=rig.context)
    velocity = other.create_publisher(JointState, "/servo/joint_commands", command_qos())
    try:
        rig.until(lambda: velocity.get_subscription_count())

        def command_alternately() -> None:
            accepted = rig.accepted()
            rig.position.publish(Float64(data=1.0))
            rig.until(lambda: rig.accepted() > accepted)
            velocity.publish(JointState(name=["axis2"], velocity=[5.0]))
            rig.until(lambda: rig.accepted() > accepted + 1)

        for _ in range(5):
            command_alternately()
        warning = (
            "axis2 is commanded alternately by position on axis2/position (/servo/user) and velocity on "
            "joint_commands ("
        )
        rig.until(lambda: rig.warnings(warning))
        assert "/teleop" in rig.warnings(warning)[0]
        command_alternately()
        status = rig.diagnosis("commands")
        assert (status.level, status.message[: len(warning)]) == (b"\x01", warning)
        assert len(rig.warnings(warning)) == 1, "throttled"

        assert rig.set_parameter("preferred_source", "axis2/position")[0]

        def refused() -> bool:
            rig.position.publish(Float64(data=1.0))
            velocity.publish(JointState(name=["axis2"], velocity=[5.0]))
            return any("axis2/position commands axis2 and has precedence" in text for text in rig.rejections())

        rig.until(refused)
    finally:
        other.destroy_node()
