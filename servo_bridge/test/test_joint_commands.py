"""Messages of ros2_control: streams, ignored joints, and repeated set-points across enable."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from itertools import pairwise

import pytest
from bridge_rig import SPIN, Rig
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Log
from sensor_msgs.msg import JointState
from servo_msgs_py.answers import new_ticket
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.timed_points import TimedPoint, decode_points
from servo_msgs_py.units import PERIOD_NS
from std_msgs.msg import Float64

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CATALOGUE = Catalogue.load()
PERIODS = 160
NAN = math.nan
OFF = (1, 0)


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        for name, value in (("speed", 300.0), ("acceleration", 4000.0), ("i_q", 2.0)):
            variable = CATALOGUE[f"param.{name}_limit"]
            rig.link.parameters[variable.name] = [variable.to_raw(value)] * 2
        yield rig


@pytest.fixture
def ready(rig: Rig) -> Rig:
    rig.enable_axes()
    rig.until(lambda: rig.messages[topics.PARAMETERS])
    return rig


def sample(rig: Rig) -> None:
    """Deliver a sample of a board with an exact clock."""
    now = time.monotonic_ns() // PERIOD_NS
    rig.link.sample(max(now - rig.link.tick, 1) if rig.link.tick > now // 2 else now)


def send(rig: Rig, position: list[float], velocity: list[float] | None = None, stamp: float = 0.0) -> None:
    """Send a message of all joints, and deliver a sample."""
    message = JointState(name=["axis1", "axis2"], position=position, velocity=velocity or [])
    message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), round(stamp % 1.0 * 1e9)
    rig.joint_commands.publish(message)
    until = time.monotonic() + 0.01
    while (remaining := until - time.monotonic()) > 0.0:
        rig.executor.spin_once(timeout_sec=remaining)
    sample(rig)


def points(rig: Rig) -> list[TimedPoint]:
    return [p for name, _, raw in rig.link.written if name == "cmd.points" for p in decode_points(CATALOGUE, raw)]


def written(rig: Rig, name: str) -> list[tuple[int, tuple[int, ...]]]:
    return [(first, tuple(raw)) for what, first, raw in rig.link.written if what == name]


def until_written(rig: Rig, name: str) -> list[tuple[int, int]]:
    """Deliver samples until a variable is written; return axis and length of each write."""

    def arrived() -> bool:
        sample(rig)
        rig.executor.spin_once(timeout_sec=0.005)
        return bool(written(rig, name))

    rig.until(arrived)
    return [(first, len(raw)) for first, raw in written(rig, name)]


def put(rig: Rig, *positions: float) -> None:
    """Put the shafts of the fake board at positions [rad]."""
    lsb = CATALOGUE["axis1.position"].lsb
    for axis, position in enumerate(positions, 1):
        for name in ("position", "position_ref"):
            rig.link.values[f"axis{axis}.{name}"] = round(position / lsb)


def until_at(rig: Rig, position: float) -> None:
    """Deliver samples until the bridge has a position of both joints [rad]."""

    def there() -> bool:
        sample(rig)
        states = rig.messages[topics.JOINT_STATES]
        return bool(states) and all(abs(value - position) < 0.01 for value in states[-1].position)

    rig.until(there)


def stream(rig: Rig, joints: tuple[bool, bool] = (True, True), start: float = 0.0) -> None:
    """Stream a ramp from a position [rad] until moving points have reached the link."""
    begin = time.monotonic()

    def arrived() -> bool:
        t = time.monotonic() - begin
        values = [(start + 2.0 * t, 2.0) if joint else (NAN, NAN) for joint in joints]
        last = {point.axis: point.position for point in points(rig)}
        put(rig, *(last.get(axis, start) for axis in (0, 1)))  # the shafts follow
        send(rig, [p for p, _ in values], [v for _, v in values], stamp=5000.0 + t)
        sent = points(rig)
        fastest = {point.axis: point.velocity for point in sorted(sent, key=lambda point: point.velocity)}
        return len(sent) >= 20 and all(fastest.get(axis, 0.0) > 1.0 for axis, moves in enumerate(joints) if moves)

    rig.until(arrived)


def test_positions_with_velocities_become_timed_points(ready: Rig) -> None:
    stream(ready)
    assert ready.rejections() == []
    trajectory = CATALOGUE.enums["control_mode_t"]["TRAJECTORY"]
    assert ready.link.written[0] == ("cmd.mode", 0, (trajectory, trajectory))
    for axis in (0, 1):
        mine = [point for point in points(ready) if point.axis == axis]
        ticks = [point.tick for point in mine[-5:]]
        assert [b - a for a, b in pairwise(ticks)] == [PERIODS] * 4
    ready.until(lambda: "axis1, axis2" in ready.diagnosis("stream").message)
    values = {pair.key: pair.value for pair in ready.diagnosis("stream").values}
    assert int(values["received"]) >= 5
    assert float(values["delay [ms]"]) > 20.0


@pytest.mark.parametrize(("baud", "joints", "carried"), [(19200, 1, 0), (38400, 1, 1), (57600, 2, 1), (115200, 2, 2)])
def test_a_stream_that_the_line_does_not_carry_is_refused(baud: int, joints: int, carried: int) -> None:
    with Rig(baud=baud) as rig:
        rig.enable_axes()
        rig.until(lambda: rig.messages[topics.PARAMETERS])
        for number in range(1, joints + 1):
            rig.joint_commands.publish(JointState(name=[f"axis{number}"], position=[0.01], velocity=[0.05]))
            rig.wait_for_pending()
        refusals = [text for text in rig.rejections() if "points/s" in text]
        assert len(refusals) == (carried < joints)
        assert all(f"needs {100 * joints} points/s" in text and f"at {baud} baud" in text for text in refusals)


def test_joint_with_nan_is_ignored(ready: Rig) -> None:
    stream(ready, joints=(True, False))
    assert {point.axis for point in points(ready)} == {0}
    assert ready.rejections() == []


def test_message_with_only_nan_is_no_set_point(ready: Rig) -> None:
    for _ in range(20):
        send(ready, [NAN, NAN], [NAN, NAN])
    assert ready.link.written == []
    assert ready.rejections() == []
    ready.until(lambda: ready.diagnosis("commands"))
    values = {pair.key: pair.value for pair in ready.diagnosis("commands").values}
    assert (values["accepted"], values["rejected"]) == ("0", "0")


def test_position_without_velocity_is_a_set_point(ready: Rig) -> None:
    send(ready, [1.0, NAN], [NAN, NAN])
    assert until_written(ready, "cmd.position") == [(0, 1)]


def test_a_velocity_beyond_its_limit_moves_no_joint(ready: Rig) -> None:
    send(ready, [1.0, 0.0], [0.0, 500.0])
    ready.until(ready.rejections)
    assert "velocity of axis2 is 500 rad/s, outside -300 .. 300 rad/s" in ready.rejections()[-1]
    assert ready.link.written == []


def test_set_points_repeated_from_before_enable_are_refused_until_they_change(rig: Rig) -> None:
    """Some hardware interfaces send 0 until a controller starts."""
    rig.connect(OFF, OFF)
    rig.until(lambda: rig.messages[topics.PARAMETERS])
    for _ in range(3):
        send(rig, [0.0, 0.0])
    rig.until(rig.rejections)
    assert "not been enabled" in rig.rejections()[-1]
    rig.link.set_states(SPIN, SPIN)
    rig.enable(True)
    rig.until(rig.armed)
    rig.link.written.clear()
    for _ in range(30):
        send(rig, [0.0, 0.0])
    assert written(rig, "cmd.position") == []
    assert any("repeats a set-point from before" in text for text in rig.rejections())
    rig.until(lambda: rig.diagnosis("commands").level == DiagnosticStatus.WARN)
    send(rig, [0.0, 0.5])
    assert until_written(rig, "cmd.position") == [(1, 1)]


@pytest.mark.parametrize("velocity", [None, [0.0, 0.0]])
def test_controllers_that_repeat_old_positions_move_nothing_and_are_logged_once(
    ready: Rig, velocity: list[float] | None
) -> None:
    put(ready, 5.0, 5.0)
    until_at(ready, 5.0)
    for _ in range(60):
        send(ready, [0.0, 0.0], velocity)
    assert ready.link.written == []
    ready.until(ready.rejections)
    first, *more = ready.rejections()
    assert "axis1: the joint is at 5 rad, 5 rad from the set-point 0 rad" in first
    assert not more
    end = time.monotonic() + 1.1
    ready.until(lambda: time.monotonic() > end)
    ready.diagnosis("commands")
    ready.until(lambda: any("set-points were rejected within" in text for text in ready.logs(Log.INFO)))
    # The path of a controller that begins at the joints is followed.
    stream(ready, start=5.0)
    assert min(point.position for point in points(ready)) > 4.9


@pytest.mark.parametrize("velocity", [None, [0.0, 0.0]])
def test_an_angle_that_is_repeated_does_not_change_when_the_joint_passes_the_opposite_side(
    velocity: list[float] | None,
) -> None:
    with Rig(wraps=[True, True]) as rig:
        for name, value in (("speed", 300.0), ("acceleration", 4000.0), ("i_q", 2.0)):
            variable = CATALOGUE[f"param.{name}_limit"]
            rig.link.parameters[variable.name] = [variable.to_raw(value)] * 2
        rig.enable_axes()
        rig.until(lambda: rig.messages[topics.PARAMETERS])
        for place in (0.0, -0.3, 0.0, -0.3):  # the shorter way to 3 rad is positive from 0, negative from -0.3
            put(rig, place, place)
            until_at(rig, place)
            for _ in range(15):
                send(rig, [3.0, 3.0], velocity)
        assert rig.link.written == []
        assert rig.rejections()


def test_a_single_position_is_executed_and_a_newer_one_of_another_topic_replaces_it(ready: Rig) -> None:
    send(ready, [1.0, 1.0])
    ready.position.publish(Float64(data=2.0))
    assert until_written(ready, "cmd.position") == [(1, 1)]
    ready.link.written.clear()
    assert until_written(ready, "cmd.position") == [(0, 1)]
    ready.until(lambda: any("axis2: a set-point on axis2/position was newer" in text for text in ready.rejections()))


def test_a_position_with_a_ticket_is_executed_beside_a_controller_that_is_refused(ready: Rig) -> None:
    put(ready, 5.0, 5.0)
    until_at(ready, 5.0)
    for _ in range(20):
        send(ready, [0.0, 0.0])
    assert ready.link.written == []
    command = JointState(name=["axis2"], position=[6.0])
    command.header.frame_id = new_ticket("test")
    ready.joint_commands.publish(command)
    for _ in range(40):
        send(ready, [0.0, 0.0])
    raw = (round(6.0 / CATALOGUE["cmd.position"].lsb),)
    assert written(ready, "cmd.position") == [(1, raw)]


def with_ticket(rig: Rig, ticket: str, **quantities: list[float]) -> None:
    """Send a command of axis 2 with a ticket, and let the bridge take it."""
    message = JointState(name=["axis2"], **quantities)
    message.header.frame_id = ticket
    rig.joint_commands.publish(message)
    until = time.monotonic() + 0.4  # longer than the delay of an isolated position
    while time.monotonic() < until:
        sample(rig)
        rig.executor.spin_once(timeout_sec=0.01)


def test_a_repeated_position_with_an_answered_ticket_is_ignored(ready: Rig) -> None:
    """The sender repeats it, because the answer is late; meanwhile the joint was commanded otherwise."""
    ticket = new_ticket("test")
    with_ticket(ready, ticket, position=[1.0])
    assert len(written(ready, "cmd.position")) == 1
    ready.joint_commands.publish(JointState(name=["axis2"], velocity=[0.0]))
    with_ticket(ready, ticket, position=[1.0])
    assert len(written(ready, "cmd.position")) == 1


def test_a_refused_command_is_not_executed_when_it_is_repeated(rig: Rig) -> None:
    rig.connect(OFF, OFF)
    rig.until(lambda: rig.messages[topics.PARAMETERS])
    ticket = new_ticket("test")
    with_ticket(rig, ticket, velocity=[1.0])
    rig.until(rig.rejections)
    rig.link.set_states(SPIN, SPIN)
    rig.enable(True)
    rig.until(rig.armed)
    with_ticket(rig, ticket, velocity=[1.0])
    assert written(rig, "cmd.speed") == []


def test_a_velocity_is_renewed_with_its_ticket(ready: Rig) -> None:
    ticket = new_ticket("test")
    for _ in range(3):
        with_ticket(ready, ticket, velocity=[1.0])
    assert len(written(ready, "cmd.speed")) == 3
