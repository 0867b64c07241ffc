"""Arbiter: accepted set-points, refusals with their reasons, effect of a lost link."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from servo_bridge.admission import Place
from servo_bridge.arbiter import Arbiter
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.set_point_sources import Conflict, Source, Sources
from servo_bridge.set_points import Mode, Rejected, SetPointRequest
from servo_bridge.telemetry import AxisStatus
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.follower import AxisReport
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint, JointLimits, joint_names
from servo_msgs_py.timed_points import TimedPoint, encode_points

CATALOGUE = Catalogue.load()
JOINTS = joint_names(DEFAULT_JOINTS)
KT = [0.0462, 0.0414]
LSB = CATALOGUE["cmd.position"].lsb
REACH = CATALOGUE.bits["position"]["REACH"]
TURN = 2.0 * math.pi
SPINNING = AxisStatus("RUN/SPIN", accepts_set_points=True)
STOPPED = AxisStatus("STOP", accepts_set_points=False)
FAULTED = AxisStatus("FAULT", accepts_set_points=False, faulted=True)


def arbiter(*axes: AxisStatus, limits: JointLimits | None = None) -> Arbiter:
    """Connected and released arbiter; both axes spin unless `axes` is given."""
    result = Arbiter(CATALOGUE, [Joint(name, limits=limits or JointLimits()) for name in JOINTS])
    result.set_torque_constants(KT)
    result.release()
    result.update_axes(axes or (SPINNING, SPINNING))
    return result


def request(values: Mapping[int, float], mode: Mode = Mode.POSITION, source: str = "joint_commands") -> SetPointRequest:
    return SetPointRequest(source, mode, values)


def drain(subject: Arbiter) -> list[CommandWrite]:
    """Take all writes like the dispatcher: one at a time, each accepted."""
    writes = []
    while (write := subject.queue.next_write()) is not None:
        subject.queue.accepted(write)
        writes.append(write)
        assert len(writes) < 10
    return writes


# ---- writes to the board
def test_first_command_sets_the_mode_and_then_both_axes_in_one_write() -> None:
    subject = arbiter()
    subject.submit(request({0: TURN, 1: -2 * TURN}))
    assert drain(subject) == [CommandWrite("cmd.mode", 0, (0, 0)), CommandWrite("cmd.position", 0, (4000, -8000))]


def test_the_mode_is_not_written_again() -> None:
    subject = arbiter()
    subject.submit(request({0: TURN, 1: TURN}))
    drain(subject)
    subject.submit(request({0: 0.0, 1: 0.0}))
    assert drain(subject) == [CommandWrite("cmd.position", 0, (0, 0))]


def test_a_joint_that_wraps_moves_by_the_shorter_way() -> None:
    wheel = Joint("axis1", gear_ratio=2.0, wraps=True)
    subject = Arbiter(CATALOGUE, [wheel, Joint("axis2")])
    subject.release()
    at = replace(SPINNING, position=round(wheel.motor_position(3 * TURN + 3.0) / LSB))
    subject.update_axes((at, at))
    subject.submit(request({0: -3.0, 1: -3.0}))
    _, write = drain(subject)
    assert [raw * LSB for raw in write.raw] == pytest.approx([2.0 * (4 * TURN - 3.0), -3.0], abs=LSB)


@pytest.mark.parametrize("mode", [Mode.SPEED, Mode.TORQUE])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_velocity_or_an_effort_does_not_turn_a_joint_out_of_its_range(mode: Mode, way: float) -> None:
    """At 20 rad/s a stop takes 0.05 rad, and 1 rad until it takes effect; from outside the way back is permitted."""
    limits = [Limits(acceleration_max=4000.0)] * 2
    joints = [Joint(name, limits=JointLimits(-5.0, 5.0)) for name in JOINTS]
    subject = Arbiter(CATALOGUE, joints, limits=lambda: limits, delay=0.04)
    subject.set_torque_constants(KT)
    subject.release()

    def axis1_at(position: float, speed: float) -> None:
        moving = replace(SPINNING, position=round(way * position / LSB), speed=way * speed)
        subject.update_axes((moving, SPINNING))

    axis1_at(0.0, 0.0)
    subject.submit(request({0: way * 0.01}, mode))
    drain(subject)
    axis1_at(0.0, 20.0)
    axis1_at(3.9, 20.0)
    assert not subject.stop_at_limits(0.01)
    axis1_at(4.0, 20.0)
    assert len(subject.stop_at_limits(0.01)) == 1
    assert drain(subject) == [CommandWrite("cmd.mode", 0, (Mode.POSITION.value,))]
    axis1_at(4.5, 0.0)
    with pytest.raises(Rejected, match="at the end of its range"):
        subject.submit(request({0: way * 0.01}, mode))
    axis1_at(5.1, 0.0)
    subject.submit(request({0: -way * 0.01}, mode))
    axis1_at(5.0, -20.0)
    assert not subject.stop_at_limits(0.01)
    axis1_at(5.1, 0.0)
    with pytest.raises(Rejected, match="at the end of its range"):
        subject.submit(request({0: way * 0.01}, mode))


@pytest.mark.parametrize(("mode", "stops"), [(Mode.TORQUE, 1), (Mode.SPEED, 0)])
def test_an_effort_that_accelerates_a_joint_is_stopped_earlier(mode: Mode, stops: int) -> None:
    """From 10 rad/s at 0 rad, with 10 rad/s more in each sample: 60 rad/s at the effect of the stop."""
    joints = [Joint(name, limits=JointLimits(-2.1, 2.1)) for name in JOINTS]
    limits = [Limits(acceleration_max=4000.0)] * 2
    subject = Arbiter(CATALOGUE, joints, limits=lambda: limits, delay=0.04)
    subject.set_torque_constants(KT)
    subject.release()
    subject.update_axes((SPINNING, SPINNING))
    subject.submit(request({0: 0.01}, mode))
    subject.update_axes((replace(SPINNING, speed=10.0), SPINNING))
    assert len(subject.stop_at_limits(0.01)) == stops


@pytest.mark.parametrize("axis", [0, 1])
def test_a_partial_command_writes_only_its_own_element(axis: int) -> None:
    subject = arbiter()
    subject.submit(request({axis: TURN}))
    assert drain(subject) == [CommandWrite("cmd.mode", axis, (0,)), CommandWrite("cmd.position", axis, (4000,))]


def test_velocity_and_effort_are_scaled() -> None:
    subject = arbiter()
    subject.submit(request({0: 100.0}, Mode.SPEED))
    assert drain(subject)[1] == CommandWrite("cmd.speed", 0, (CATALOGUE["cmd.speed"].to_raw(100.0),))
    subject.submit(request({0: KT[0], 1: 2 * KT[1]}, Mode.TORQUE))
    amperes = CATALOGUE["cmd.i_q"]
    assert drain(subject)[1] == CommandWrite("cmd.i_q", 0, (amperes.to_raw(1.0), amperes.to_raw(2.0)))


def test_newest_set_point_replaces_a_pending_one() -> None:
    subject = arbiter()
    for turns in (1, 2, 3):
        subject.submit(request({0: turns * TURN}))
    assert [w.raw for w in drain(subject) if w.variable == "cmd.position"] == [(12000,)]


def test_axes_in_different_modes_get_their_own_writes() -> None:
    subject = arbiter()
    subject.submit(request({0: TURN}))
    subject.submit(request({1: 10.0}, Mode.SPEED))
    variables = [(w.variable, w.first, len(w.raw)) for w in drain(subject)]
    assert variables == [("cmd.mode", 0, 2), ("cmd.position", 0, 1), ("cmd.speed", 1, 1)]


def at(counts: int) -> AxisStatus:
    """Status of an axis at a position [counts], which may exceed the range of the counter."""
    return AxisStatus("RUN/SPIN", accepts_set_points=True, position=counts)


def wrapped(counts: int) -> int:
    return (counts + 2**31) % 2**32 - 2**31


def written_position(subject: Arbiter, counts: int) -> int:
    """Raw value that is written for a position set-point of axis 1."""
    subject.submit(request({0: counts * LSB}))
    (raw,) = drain(subject)[-1].raw
    return raw


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("turns_of_the_counter", [2**31, 2**32, 3 * 2**32])
def test_positions_are_exact_beyond_the_counter_of_the_board(turns_of_the_counter: int, direction: int) -> None:
    shaft = direction * turns_of_the_counter
    subject = arbiter(at(shaft), at(0))
    for step in (0, 123_457, -123_457):
        assert written_position(subject, shaft + step) == wrapped(shaft + step)
    assert "outside" in refused(subject, request({0: 0.0}))


@pytest.mark.parametrize("direction", [1, -1])
def test_a_set_point_may_cross_the_wrap_of_the_counter(direction: int) -> None:
    subject = arbiter(at(direction * (2**31 - 10)), at(0))
    assert written_position(subject, direction * (2**31 + 10)) == -direction * (2**31 - 10)


@given(st.integers(-(2**42), 2**42), st.integers(-REACH, REACH))
@example(2**31 - 1, 1)
@example(-(2**31), -1)
@example(2**42, REACH)
@example(-(2**42), -REACH)
def test_distance_is_independent_of_counter_wraps(shaft: int, distance: int) -> None:
    raw = written_position(arbiter(at(shaft), at(0)), shaft + distance)
    assert -(2**31) <= raw < 2**31
    assert wrapped(raw - wrapped(shaft)) == distance


@pytest.mark.parametrize("shaft", [0, 2**33, -(2**33)])
@pytest.mark.parametrize("distance", [REACH + 1, -REACH - 1])
def test_too_distant_set_point_is_refused_with_the_maximum(shaft: int, distance: int) -> None:
    subject = arbiter(at(shaft), at(0))
    value = (shaft + distance) * LSB
    text = refused(subject, request({0: value}))
    low, high = (shaft - REACH) * LSB, (shaft + REACH) * LSB
    assert f"position of axis1 is {value:g} rad, outside {low:g} .. {high:g} rad" in text
    assert "in steps" in text
    assert subject.queue.next_write() is None


@pytest.mark.parametrize("value", [1.7e308, -1.7e308])
def test_largest_numbers_are_refused_as_too_distant(value: float) -> None:
    assert "outside" in refused(arbiter(), request({0: value}))


@given(st.dictionaries(st.integers(0, 1), st.floats(-5e3, 5e3), min_size=1), st.sampled_from([Mode.SPEED, Mode.TORQUE]))
def test_accepted_set_points_are_within_the_limits_of_the_board(values: dict[int, float], mode: Mode) -> None:
    subject = arbiter()
    rejection = None
    try:
        subject.submit(request(values, mode))
    except Rejected as error:
        rejection = str(error)
    if rejection is not None:
        assert "outside" in rejection
        assert subject.queue.next_write() is None
        return
    target = drain(subject)[-1]
    variable = CATALOGUE[target.variable]
    assert target.mask == sum(1 << axis for axis in values)
    for raw in target.raw:
        assert variable.to_raw(variable.minimum) <= raw <= variable.to_raw(variable.maximum)


# ---- refused
def refused(subject: Arbiter, what: SetPointRequest) -> str:
    with pytest.raises(Rejected) as caught:
        subject.submit(what)
    return str(caught.value)


def test_an_axis_whose_points_are_refused_stops() -> None:
    """The board may still follow the points that it has."""
    subject = arbiter()
    words = encode_points(CATALOGUE, [TimedPoint(1, 800, 1.0, 0.0, 0.0)])
    subject.queue.failed(CommandWrite("cmd.points", 0, tuple(words)))
    assert drain(subject) == [CommandWrite("cmd.mode", 1, (Mode.POSITION.value,))]
    subject.queue.failed(CommandWrite("cmd.points", 0, tuple(words)))
    subject.lost("gone")
    assert drain(subject) == []


def geared(limits: JointLimits | None = None) -> Arbiter:
    """Arbiter with a reversed joint on axis 1 with a gear ratio of 50."""
    subject = Arbiter(CATALOGUE, [Joint("lift", 50.0, -1, 0.3, limits or JointLimits()), Joint("pan")])
    subject.set_torque_constants(KT)
    subject.release()
    subject.update_axes((SPINNING, SPINNING))
    return subject


@pytest.mark.parametrize(
    ("mode", "value", "motor"),
    [(Mode.POSITION, 1.3, -50.0), (Mode.SPEED, -2.0, 100.0), (Mode.TORQUE, 2.0, -0.04 / KT[0])],
)
def test_a_geared_joint_reaches_the_board_in_units_of_its_motor(mode: Mode, value: float, motor: float) -> None:
    subject = geared()
    subject.submit(request({0: value}, mode))
    write = drain(subject)[-1]
    variable = CATALOGUE[write.variable]
    assert write.raw[0] * variable.lsb == pytest.approx(motor, abs=variable.lsb)


def test_limits_of_a_reversed_joint_are_reported_in_joint_units() -> None:
    subject = geared(JointLimits(-1.0, 2.0, 5.0, 20.0))
    text = refused(subject, request({0: 2.5}))
    assert "position of lift is 2.5 rad, outside -1 .. 2 rad" in text
    board = CATALOGUE["cmd.speed"].maximum / 50.0
    text = refused(geared(), request({0: 1000.0}, Mode.SPEED))
    assert f"outside {-board:g} .. {board:g} rad/s; this is the range of the board" in text


def test_set_points_are_refused_before_the_first_sample() -> None:
    subject = Arbiter(CATALOGUE, DEFAULT_JOINTS)
    assert "not connected (no board since the start)" in refused(subject, request({0: 1.0}))


def test_set_points_are_refused_before_enable_even_in_spin() -> None:
    subject = Arbiter(CATALOGUE, DEFAULT_JOINTS)
    subject.update_axes([SPINNING, SPINNING])
    assert not subject.armed
    assert "call the service enable with data: true first" in refused(subject, request({0: 1.0}))


def test_refusal_names_the_axis_that_is_not_ready() -> None:
    text = refused(arbiter(SPINNING, AxisStatus("RUN/ALIGN", False)), request({0: 1.0, 1: 1.0}))
    assert "axis2 is in RUN/ALIGN" in text
    assert "wait until armed is true" in text


def test_other_axis_may_move_if_one_is_not_ready() -> None:
    subject = arbiter(SPINNING, STOPPED)
    subject.submit(request({0: 1.0}))
    assert drain(subject)


def test_refusal_in_fault_names_the_remedy() -> None:
    text = refused(arbiter(SPINNING, FAULTED), request({1: 1.0}))
    assert "axis2 is in FAULT" in text
    assert "clear_faults" in text


@pytest.mark.parametrize(
    ("mode", "value", "text"),
    [
        (Mode.POSITION, 1.7e6, "position of axis1 is 1.7e+06 rad, outside -1.68663e+06 .. 1.68663e+06 rad"),
        (Mode.SPEED, -500.0, "velocity of axis1 is -500 rad/s, outside -419 .. 419 rad/s"),
        (Mode.TORQUE, 0.2, "effort of axis1 is 0.2 N m, outside -0.1848 .. 0.1848 N m"),
    ],
)
def test_set_points_beyond_the_limits_of_the_board_are_refused(mode: Mode, value: float, text: str) -> None:
    assert text in refused(arbiter(), request({0: value}, mode))


def test_configured_limits_are_inclusive() -> None:
    subject = arbiter(limits=JointLimits(-1.0, 2.0, 10.0, 0.01))
    for mode, edges in ((Mode.POSITION, (-1.0, 2.0)), (Mode.SPEED, (-10.0, 10.0)), (Mode.TORQUE, (-0.01, 0.01))):
        for edge in edges:
            subject.submit(request({0: edge}, mode))
            assert "outside" in refused(subject, request({0: edge * 1.001}, mode))


def test_the_largest_effort_of_the_board_is_accepted() -> None:
    subject = arbiter()
    subject.submit(request({0: 4.0 * KT[0], 1: -4.0 * KT[1]}, Mode.TORQUE))
    limit = CATALOGUE["cmd.i_q"].to_raw(4.0)
    assert drain(subject)[1].raw == (limit, -limit)


def test_effort_without_a_torque_constant_is_refused() -> None:
    subject = Arbiter(CATALOGUE, DEFAULT_JOINTS)
    subject.release()
    subject.update_axes([SPINNING, SPINNING])
    assert "torque constant of axis2" in refused(subject, request({1: 0.01}, Mode.TORQUE))


def test_one_invalid_value_refuses_the_set_points_of_both_axes() -> None:
    subject = arbiter()
    subject.submit(request({0: 1.0, 1: 1.0}))
    drain(subject)
    refused(subject, request({0: 2.0, 1: 1e9}))
    assert subject.queue.next_write() is None


# ---- renewing
@pytest.mark.parametrize(("mode", "variable"), [(Mode.SPEED, "cmd.speed"), (Mode.TORQUE, "cmd.i_q")])
def test_the_same_velocity_or_effort_is_written_again_every_time(mode: Mode, variable: str) -> None:
    subject = arbiter()
    written = []
    for _ in range(3):
        subject.submit(request({0: 0.05, 1: 0.05}, mode))
        written.append([w for w in drain(subject) if w.variable == variable])
    assert len(written[0]) == 1
    assert written == [written[0]] * 3


def test_a_set_point_is_written_once() -> None:
    """The bridge does not repeat it, so that it expires on the board."""
    subject = arbiter()
    subject.submit(request({0: 5.0}, Mode.SPEED))
    drain(subject)
    subject.update_axes([SPINNING, SPINNING])
    assert subject.queue.next_write() is None


# ---- states and the gate
def test_leaving_spin_discards_pending_set_points() -> None:
    subject = arbiter()
    subject.submit(request({0: 5.0, 1: 5.0}, Mode.SPEED))
    subject.update_axes([SPINNING, FAULTED])
    assert drain(subject) == [CommandWrite("cmd.mode", 0, (1,)), CommandWrite("cmd.speed", 0, (drain_raw(5.0),))]
    assert subject.queue.next_write() is None


def drain_raw(speed: float) -> int:
    return CATALOGUE["cmd.speed"].to_raw(speed)


def test_block_discards_set_points_and_gives_its_reason_until_release() -> None:
    subject = arbiter()
    subject.submit(request({0: 0.0}))
    drain(subject)
    subject.submit(request({0: 1.0}))
    subject.block("stopped by quick_stop")
    assert (subject.queue.next_write(), subject.armed) == (None, False)
    assert "stopped by quick_stop; call the service enable" in refused(subject, request({0: 1.0}))
    subject.release()
    assert subject.armed
    subject.submit(request({0: 1.0}))
    assert [w.variable for w in drain(subject)] == ["cmd.mode", "cmd.position"]


def test_link_loss_discards_set_points_and_needs_a_new_enable() -> None:
    subject = arbiter()
    subject.submit(request({0: 1.0}))
    subject.lost("port gone")
    assert subject.queue.next_write() is None
    assert not subject.armed
    assert "not connected (port gone)" in refused(subject, request({0: 1.0}))
    subject.update_axes([SPINNING, SPINNING])
    assert not subject.armed
    assert "the link to the board was lost; call the service enable" in refused(subject, request({0: 1.0}))
    assert subject.queue.next_write() is None


def test_failed_write_discards_the_set_point_and_the_known_mode() -> None:
    subject = arbiter()
    subject.submit(request({0: 1.0}))
    drain(subject)
    subject.submit(request({0: 2.0}))
    write = subject.queue.next_write()
    assert write is not None
    subject.queue.failed(write)
    assert subject.queue.next_write() is None
    subject.submit(request({0: 3.0}))
    assert [w.variable for w in drain(subject)] == ["cmd.mode", "cmd.position"]


def test_armed_if_all_joints_accept_set_points() -> None:
    assert arbiter().armed
    assert not arbiter(SPINNING, STOPPED).armed


def test_command_write_has_mask_and_numbers_per_axis() -> None:
    assert (CommandWrite("cmd.mode", 0, (1, 2)).mask, CommandWrite("cmd.mode", 0, (1, 2)).numbers()) == (3, (1, 2))
    assert (CommandWrite("cmd.mode", 1, (2,)).mask, CommandWrite("cmd.mode", 1, (2,)).numbers()) == (2, (0, 2))


# ---- sources
class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def watched() -> tuple[Arbiter, Sources, Clock]:
    clock = Clock()
    sources = Sources(clock)
    subject = Arbiter(CATALOGUE, DEFAULT_JOINTS, sources)
    subject.set_torque_constants(KT)
    subject.release()
    subject.update_axes((SPINNING, SPINNING))
    return subject, sources, clock


def test_alternating_sources_are_a_conflict_but_one_change_is_not() -> None:
    subject, sources, clock = watched()
    subject.submit(request({0: 1.0}))
    subject.submit(request({1: 1.0}, Mode.SPEED))
    subject.submit(request({0: 1.0}, Mode.SPEED))
    assert sources.conflict() is None, "another axis, then one change of the source"
    clock.now += 0.9
    subject.submit(request({0: 1.0}))
    expected = Conflict("axis1", Source("joint_commands", "position"), Source("joint_commands", "velocity"))
    assert sources.conflict() == expected
    clock.now += 1.0
    assert sources.conflict() is None
    subject.submit(request({0: 1.0}, source="commands"))
    clock.now += 1.0
    subject.submit(request({0: 1.0}))
    assert sources.conflict() is None, "slow changes may be intended"


def test_refused_set_point_does_not_count_as_a_source() -> None:
    subject, sources, _ = watched()
    subject.submit(request({0: 1.0}))
    with pytest.raises(Rejected):
        subject.submit(request({0: 1e9}, Mode.SPEED))
    subject.submit(request({0: 1.0}))
    with pytest.raises(Rejected):
        subject.submit(request({0: 1e9}, Mode.SPEED))
    assert sources.conflict() is None


def test_other_sources_are_refused_while_the_preferred_source_is_active() -> None:
    subject, sources, clock = watched()
    sources.preferred = "joint_commands"
    subject.submit(request({0: 1.0}, source="commands"))
    subject.submit(request({0: 1.0}))
    drain(subject)
    with pytest.raises(Rejected, match=r"^commands: joint_commands commands axis1 .* make the hardware inactive"):
        subject.submit(request({0: 2.0, 1: 2.0}, source="commands"))
    with pytest.raises(Rejected, match=r"^joint_trajectory: joint_commands commands axis1"):
        subject.check_source("joint_trajectory", [0, 1])
    assert drain(subject) == []
    subject.submit(request({1: 2.0}, source="commands"))
    clock.now += 1.0
    subject.submit(request({0: 2.0}, source="commands"))
    assert len(drain(subject)) == 2


class Following:
    """Path source with active axes."""

    def __init__(self, *axes: int) -> None:
        self.axes = self.claimed = set(axes)

    def on_sample(self, tick: int, reports: Sequence[AxisReport]) -> None:
        pass

    def next_points(self) -> None:
        return None

    def points_accepted(self, axes: Iterable[int]) -> None:
        pass

    def postpone(self, axes: Collection[int]) -> bool:
        return False

    def end(self, axis: int, reason: str) -> None:
        self.axes.discard(axis)

    cancel = end


def test_a_preferred_trajectory_is_not_interrupted_before_its_end() -> None:
    subject, sources, clock = watched()
    paths = Following()
    subject.queue.follow(paths)
    sources.preferred = "joint_trajectory"
    subject.admit_path("joint_trajectory", [0])
    paths.axes = {0}
    clock.now += 60.0
    with pytest.raises(Rejected, match="has precedence"):
        subject.submit(request({0: 2.0}))
    paths.axes = set()
    subject.submit(request({0: 2.0}))


@pytest.mark.parametrize(
    ("limit", "value", "remedy"),
    [
        (1.0, 0.5, "this is the range of the board"),
        (1.0, -2.0, "this is the range of the board"),
        (0.1, 0.15, "change the limits in the parameters of the bridge"),
    ],
)
def test_the_remedy_for_an_effort_names_the_limit_that_binds(limit: float, value: float, remedy: str) -> None:
    subject = arbiter(limits=JointLimits(effort_max=limit))
    assert remedy in refused(subject, request({0: value}, Mode.TORQUE))


# ---- state of a joint for a source that wants to join it
def test_place_names_the_source_that_moves_the_joint() -> None:
    subject, _, clock = watched()
    moving = AxisStatus("RUN/SPIN", accepts_set_points=True, position=4000, speed=30.0)
    assert subject.place("joint_commands", 0, streaming=False) == Place("axis1", 0.0, 0.0, None, "", streaming=False)
    subject.submit(request({0: 1.0}, source="commands"))
    assert subject.place("joint_commands", 0, streaming=False).moved_by == "commands"
    assert subject.place("commands", 0, streaming=False).moved_by == ""
    clock.now += 1.0
    place = subject.place("joint_commands", 0, streaming=False)
    assert (place.holder, place.moved_by) == (Source("commands", "position"), "")
    subject.update_axes((moving, SPINNING))
    place = subject.place("joint_commands", 0, streaming=False)
    assert place.position == pytest.approx(math.tau)
    assert (place.velocity, place.moved_by) == (30.0, "commands")


@pytest.mark.parametrize("event", ["block", "link_lost", "not_ready"])
def test_joints_are_released_by_stops_faults_and_a_lost_link(event: str) -> None:
    subject, sources, _ = watched()
    subject.submit(request({0: 1.0, 1: 1.0}))
    if event == "block":
        subject.block("stopped")
    elif event == "link_lost":
        subject.lost("gone")
    else:
        subject.update_axes((FAULTED, SPINNING))
    assert sources.holder(0) is None
    assert (sources.holder(1) is None) is (event != "not_ready")
