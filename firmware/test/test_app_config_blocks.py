"""Configuration blocks: sent in parts, applied completely or not at all, in motion only live members."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from block_bench import BlockBench
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_bench import MODE, STATE, SUBSTATE, amps, speed
from servo_msgs_py.axis_config import AxisConfigTable, Member
from servo_msgs_py.axis_config_transfer import BlockRefusedError, read_block, send_block, take_blocks
from servo_tuning.block import block_of
from tuning_tool import CATALOGUE
from tuning_tool import axis as tuned_axis

TABLE = AxisConfigTable.load()
MEMBERS = list(TABLE.members.values())
REFUSALS = CATALOGUE.bits["config_refusal"]


@pytest.fixture
def bench(core: Core) -> BlockBench:
    board = BlockBench(core)
    board.to_stop()
    return board


def signed(word: int) -> int:
    return word - (1 << 32) if word >> 31 else word


def seal(axis: int, block: dict[str, int]) -> list[int]:
    """The checksum as the number after the last member."""
    return [axis, len(TABLE), 1, signed(TABLE.checksum(axis, block))]


def take(bench: BlockBench, *axes: int) -> None:
    take_blocks(bench, axes)


def other(member: Member, raw: int) -> int:
    """Another permitted number of the member, if one exists."""
    return member.raw_range[1] if raw != member.raw_range[1] else member.raw_range[0]


def refusal(bench: BlockBench) -> int:
    return bench.read_words("config.refusal")[0]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_board_begins_with_what_the_tuning_code_computes(bench: BlockBench, axis: int) -> None:
    assert read_block(bench, axis) == block_of(tuned_axis(axis + 1).constants)


def test_the_table_has_every_member_of_the_structure_once(core: Core) -> None:
    def leaves(type_: object, prefix: str = "") -> Iterator[str]:
        for name, field in type_.fields:  # type: ignore[attr-defined]
            if field.type.kind == "struct":
                yield from leaves(field.type, f"{prefix}{name}.")
            elif field.type.kind == "array":
                yield from (f"{prefix}{name}[{k}]" for k in range(field.type.length))
            else:
                yield prefix + name

    assert sorted(leaves(core.ffi.typeof("axis_config_t"))) == sorted(TABLE.members)


@settings(max_examples=30)
@given(data=st.data())
def test_any_block_within_the_ranges_comes_back_as_it_was_sent(core: Core, data: st.DataObject) -> None:
    bench = BlockBench(core)
    bench.to_stop()
    axis = data.draw(st.integers(0, 1))
    kept = read_block(bench, 1 - axis)
    block = {m.name: data.draw(st.integers(*m.raw_range)) & (m.raw_range[1] if m.bits else -1) for m in MEMBERS}
    send_block(bench, axis, block)
    assert read_block(bench, axis) != block or kept == block, "nothing is applied yet"
    before = bench.read_words("tick")[0]
    take(bench, axis)
    assert read_block(bench, axis) == block
    assert read_block(bench, 1 - axis) == kept
    assert before < bench.read_words("config.taken_tick")[0] <= bench.read_words("tick")[0]
    assert bench.read_words("applied_count") == [1]


@pytest.mark.parametrize("wrong", ["bit", "axis"])
def test_a_block_with_a_wrong_checksum_is_refused(bench: BlockBench, wrong: str) -> None:
    old = read_block(bench, 0)
    block = {**old, "speed.kp": old["speed.kp"] + 1}
    send_block(bench, 0, block)
    *place, checksum = seal(0, block)
    sent = checksum ^ 0x0100_0000 if wrong == "bit" else seal(1, block)[3]
    assert not bench.write_words("config.window", [*place, sent])
    assert refusal(bench) == REFUSALS["CHECKSUM"]
    assert not bench.write_words("config.take", [1]), "a wrong checksum also withdraws the right one"
    assert refusal(bench) == REFUSALS["UNCHECKED"]
    assert read_block(bench, 0) == old


def test_a_block_changed_after_its_checksum_is_refused(bench: BlockBench) -> None:
    block = read_block(bench, 0)
    send_block(bench, 0, block)
    assert bench.write_words("config.window", [0, 0, 1, block[MEMBERS[0].name]])
    assert not bench.write_words("config.take", [1])
    assert refusal(bench) == REFUSALS["UNCHECKED"]


@pytest.mark.parametrize(
    "member", [m for m in MEMBERS if m.raw_range[1] < 2**31 - 1 or m.raw_range[0] > 0], ids=lambda m: m.name
)
def test_a_member_out_of_range_is_refused(bench: BlockBench, member: Member) -> None:
    number = list(TABLE.members).index(member.name)
    wrong = [raw for raw in (member.raw_range[0] - 1, member.raw_range[1] + 1) if -(2**31) <= raw < 2**31]
    for raw in wrong:
        assert not bench.write_words("config.window", [0, number, 1, raw])
        assert refusal(bench) == REFUSALS["RANGE"]
        assert bench.read_words("config.refused_member") == [number]
    for raw in member.raw_range:
        assert bench.write_words("config.window", [0, number, 1, raw])


def test_refuses_impossible_stop_category(bench: BlockBench) -> None:
    """OVER_VOLTAGE with a ramp: braking would raise the bus voltage further."""
    number = list(TABLE.members).index("stop.ramp")
    assert not bench.write_words("config.window", [0, number, 1, 1])
    assert bench.write_words("config.window", [0, number, 1, 1 << 6])


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([2, 0, 1, 0], "AXIS"),
        ([0, len(TABLE) + 1, 1, 0], "MEMBER"),
        ([0, len(TABLE) - 1, 3, 0, 0, 0], "MEMBER"),
        ([0, len(TABLE), 2, 0, 0], "MEMBER"),
        ([0, -1, 1, 0], "MEMBER"),
        ([0, 0, -1], "MEMBER"),
        ([0, 0, 23, *[0] * 22], "MEMBER"),
        ([0, 0, 2, 0], "FORM"),
        ([0, 0], "FORM"),
    ],
)
def test_a_malformed_part_is_refused(bench: BlockBench, words: list[int], reason: str) -> None:
    assert not bench.write_words("config.window", words)
    assert refusal(bench) == REFUSALS[reason]


@pytest.mark.parametrize("axes", [0, 1, 2, 3])
def test_take_without_a_ready_block_is_refused(bench: BlockBench, axes: int) -> None:
    old = [read_block(bench, axis) for axis in range(2)]
    if axes == 3:
        send_block(bench, 0, old[0])
    assert not bench.write_words("config.take", [axes])
    assert refusal(bench) == REFUSALS["UNCHECKED" if axes else "AXIS"]
    bench.slow(3)
    assert [read_block(bench, axis) for axis in range(2)] == old
    assert bench.read_words("applied_count") == [0]


def test_no_block_is_written_while_blocks_are_pending(bench: BlockBench) -> None:
    block = read_block(bench, 0)
    send_block(bench, 0, block)
    bench.servo.locked = True  # the latch is omitted
    assert bench.write_words("config.take", [1])
    for name, words in (("config.window", [0, 0, 1, 5]), ("config.window", seal(0, block)), ("config.take", [1])):
        assert not bench.write_words(name, words)
        assert refusal(bench) == REFUSALS["BUSY"]


def test_both_axes_apply_their_blocks_in_the_same_tick(bench: BlockBench) -> None:
    blocks = [read_block(bench, axis) for axis in range(2)]
    for axis, block in enumerate(blocks):
        block["position_gain"] += 1 + axis
        send_block(bench, axis, block)
    take(bench, 0, 1)
    assert [read_block(bench, axis) for axis in range(2)] == blocks
    assert bench.read_words("applied_count") == [1]


def test_in_motion_only_live_members_change(bench: BlockBench) -> None:
    bench.to_spin(0)
    old = read_block(bench, 0)
    live = {m.name: other(m, old[m.name]) for m in MEMBERS if m.live}
    send_block(bench, 0, {**old, **live})
    take(bench, 0)
    assert bench.axis(0).sm.state == STATE.RUN
    for member in MEMBERS:
        now = read_block(bench, 0)
        if member.live or member.raw_range[0] == member.raw_range[1]:
            continue
        send_block(bench, 0, {**now, member.name: other(member, now[member.name])})
        with pytest.raises(BlockRefusedError, match="at standstill") as error:
            take(bench, 0)
        assert error.value.reason == "MOTION"
        assert member.name in str(error.value)
        assert read_block(bench, 0) == now


def test_one_axis_in_motion_blocks_the_exchange_of_both(bench: BlockBench) -> None:
    bench.to_spin(1)
    old = [read_block(bench, axis) for axis in range(2)]
    for axis in range(2):
        send_block(bench, axis, {**old[axis], "u_dc_max": 30000})
    with pytest.raises(BlockRefusedError, match="u_dc_max"):
        take(bench, 0, 1)
    assert [read_block(bench, axis) for axis in range(2)] == old
    send_block(bench, 0, {**old[0], "u_dc_max": 30000})
    take(bench, 0)
    assert bench.axis(0).config.u_dc_max == 30000


def test_an_axis_that_is_rotated_by_hand_is_not_at_rest(bench: BlockBench) -> None:
    bench.turn(0, 20.0)
    bench.slow(100)
    assert bench.axis(0).sm.state == STATE.STOP
    send_block(bench, 0, {**read_block(bench, 0), "u_dc_max": 30000})
    with pytest.raises(BlockRefusedError, match="at standstill"):
        take(bench, 0)


def test_parameters_follow_their_defaults_and_others_stay(bench: BlockBench) -> None:
    bench.set_parameter("acceleration_limit", 1234.0)
    bench.slow(2)
    kept = bench.read_words("param.acceleration_limit")
    changes = {
        "speed_limit": speed(100.0), "i_q_limit": amps(1.5), "features": 3, "position_limit": 5000,
        "over_speed": speed(150.0), "following_error": 77, "stop.disable": 0, "stop.quick_stop": 2, "feedback": 1,
    }  # fmt: skip
    send_block(bench, 1, {**read_block(bench, 1), **changes, "torque_constant": 999})
    take(bench, 1)
    bench.slow(2)
    assert bench.read_words("param.speed_limit")[1] == changes["speed_limit"]
    assert bench.read_words("param.speed_limit")[0] != changes["speed_limit"]
    assert bench.read_words("param.acceleration_limit") == kept
    assert bench.read_words("param.position_min")[1] == -5000
    assert bench.read_words("axis2.torque_constant") == [999]
    axis = bench.axis(1)
    assert (axis.parameter.features, axis.limits.i_q, axis.parameter.on_disable, axis.parameter.on_quick_stop) == (
        3,
        amps(1.5),
        0,
        2,
    )
    assert axis.sensorless


def test_position_gain_changes_gradually(bench: BlockBench) -> None:
    bench.to_spin(0)
    block = read_block(bench, 0)
    old, new = block["position_gain"], 2 * block["position_gain"]
    send_block(bench, 0, {**block, "position_gain": new})
    take(bench, 0)
    seen = bench.trace(4000, lambda: bench.axis(0).motion.position_gain, follow=False)
    assert old < seen[0] < old * 1.1
    assert seen == sorted(seen)
    assert seen[-1] == new


def test_gains_taken_during_the_first_rotor_search_are_those_of_the_motion(bench: BlockBench) -> None:
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    block = read_block(bench, 0)
    send_block(bench, 0, {**block, "speed.kp": 2 * block["speed.kp"], "position_gain": 3 * block["position_gain"]})
    take(bench, 0)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.ALIGN)
    bench.to_substate(0, SUBSTATE.SPIN)
    motion = bench.axis(0).motion
    assert (motion.speed_gains.kp, motion.position_gain) == (2 * block["speed.kp"], 3 * block["position_gain"])


@settings(max_examples=40)
@given(data=st.data())
def test_change_of_gains_is_bumpless(core: Core, data: st.DataObject) -> None:
    """Speed control with a large error: the integral part compensates the step of the proportional part."""
    bench = BlockBench(core)
    bench.to_stop()
    bench.to_spin(0)
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    bench.slow(20)
    axis = bench.axis(0)
    block = read_block(bench, 0)
    for path in ("speed.kp", "speed.ki", "current_loop.q.kp", "current_loop.d.kp", "current_loop.omega_psi"):
        block[path] = round(block[path] * data.draw(st.floats(0.5, 1.5)))
    send_block(bench, 0, block)
    loop, motion = axis.current_loop, axis.motion
    error = motion.speed_ref - axis.feedback.speed
    speed_sum = motion.speed_pi.integral + error * axis.config.speed.kp
    voltage = loop.q.integral + (axis.current_ref.q - loop.current.q) * 65536 * axis.config.current_loop.q.kp
    voltage += loop.omega_e * axis.config.current_loop.omega_psi
    bench.servo.config_blocks.pending = 1
    assert core.lib.config_blocks_latch(
        core.ffi.addressof(bench.servo, "config_blocks"), core.ffi.addressof(bench.servo, "config_status"),
        core.ffi.addressof(bench.servo, "parameter"), core.ffi.addressof(bench.servo, "nominal"), bench.servo.axis,
    )  # fmt: skip
    one = 1 << 55
    after = motion.speed_pi.integral + error * axis.config.speed.kp
    assert after == speed_sum or abs(motion.speed_pi.integral) >= one - (1 << 24)
    held = loop.q.integral + (axis.current_ref.q - loop.current.q) * 65536 * axis.config.current_loop.q.kp
    held += loop.omega_e * axis.config.current_loop.omega_psi
    assert held == voltage or abs(loop.q.integral) >= one - (1 << 24)
