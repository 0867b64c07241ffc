"""From writes of the host to the commands of one tick: elements, new writes, consistency."""

from __future__ import annotations

from typing import Any

import pytest
from core_library import Core
from hypothesis import given
from hypothesis import strategies as st
from servo_bench import FAULTS, MODE, Bench

FIELDS = ("position", "speed", "i_q", "mode", "enable", "quick_stop", "clear_faults", "home")
"""Set-points and requests of one element per axis, in the order of the block."""
BITS = dict(zip(FIELDS, (0, 1, 2, 4, 5, 6, 7, 8), strict=True))
"""Bits of `axis_command_t.fresh`; bit 3 marks timed points."""
FRESH_POSITION = 1
TO_LATCH = 7
"""PWM periods from the snapshot to the latch; one more to the slow loops."""


@pytest.fixture
def bench(core: Core) -> Bench:
    bench = Bench(core)
    bench.to_stop()
    return bench


def marks_of(core: Core, offset: int, size: int) -> Any:
    marks = core.ffi.new("latch_marks_t *")
    core.lib.latch_reset(marks)
    core.lib.latch_mark(marks, offset, size)
    return marks


@given(data=st.data())
def test_any_range_marks_exactly_the_elements_it_contains(core: Core, data: st.DataObject) -> None:
    total = core.ffi.offsetof("command_block_t", "memory")
    begin = data.draw(st.integers(0, total - 1))
    size = data.draw(st.integers(1, total - begin))
    marks = marks_of(core, begin, size)
    for field in FIELDS:
        offset = core.ffi.offsetof("command_block_t", field)
        element = core.ffi.sizeof(dict(core.ffi.typeof("command_block_t").fields)[field].type.item)
        for axis in range(2):
            touched = begin < offset + (axis + 1) * element and offset + axis * element < begin + size
            assert (marks.fresh[axis] >> BITS[field] & 1) == touched


def test_freshness_lasts_one_tick(bench: Bench) -> None:
    bench.write(0, position=100)
    bench.core.lib.probe_run(bench.servo, TO_LATCH)
    assert bench.axis(0).command.fresh & FRESH_POSITION
    assert not bench.axis(1).command.fresh & FRESH_POSITION
    bench.core.lib.probe_run(bench.servo, 1)
    assert not bench.axis(0).command.fresh & FRESH_POSITION
    assert bench.axis(0).command.position == 100


def test_whole_block_in_one_write(bench: Bench) -> None:
    """Every field of both axes in one write: the mode applies before the set-point."""
    bench.to_spin(0, 1)
    bench.write_raw("cmd.mode", [MODE.SPEED, MODE.TORQUE])
    bench.write_raw("cmd.speed", [2**27, 0])
    bench.write_raw("cmd.i_q", [0, 1234])
    bench.slow(2)
    assert bench.view(0).speed_ref > 0
    assert bench.view(1).i_q_ref == 1234


def test_read_only_variables_refuse_writes(bench: Bench, core: Core) -> None:
    for name in ("tick", "axis1.position", "axis2.faults", "catalogue_hash", "snapshot", "axis1.torque_constant"):
        assert core.lib.servo_write(bench.servo, bench.address(name), b"\0\0", 2) != 0


# ---- applied_tick, hold ---------------------------------------------------------------------------------------------


def test_applied_tick_is_that_of_the_slow_tick_after_the_write(bench: Bench) -> None:
    snapshot = bench.servo.snapshot
    before, count = snapshot.applied_tick, snapshot.applied_count
    bench.slow(3)
    assert (snapshot.applied_tick, snapshot.applied_count) == (before, count), "nothing was written"
    bench.write(0, position=5)
    bench.slow()
    assert snapshot.applied_tick == snapshot.tick
    assert snapshot.applied_count == count + 1
    tick = snapshot.tick
    bench.slow(2)
    assert (snapshot.applied_tick, snapshot.tick) == (tick, tick + 16)


def test_writes_between_two_slow_ticks_take_effect_together(bench: Bench, core: Core) -> None:
    count = bench.servo.snapshot.applied_count
    bench.write(0, position=7)
    core.lib.probe_run(bench.servo, 3)
    bench.write(1, position=8)
    core.lib.probe_run(bench.servo, TO_LATCH - 3)
    assert all(bench.axis(i).command.fresh & FRESH_POSITION for i in range(2))
    core.lib.probe_run(bench.servo, 1)
    assert bench.servo.snapshot.applied_count == count + 1
    assert [bench.axis(i).command.position for i in range(2)] == [7, 8]


def test_writes_during_a_lock_are_latched_later(bench: Bench) -> None:
    """While the server copies, nothing is latched and no snapshot is published; the write is latched afterwards."""
    tick = bench.servo.snapshot.tick
    bench.write(0, enable=1)
    bench.servo.locked = True
    bench.slow(3)
    assert not bench.axis(0).enable_requested
    assert bench.servo.snapshot.tick == tick
    bench.servo.locked = False
    bench.slow()
    assert bench.axis(0).enable_requested
    assert bench.servo.snapshot.tick == bench.servo.snapshot.applied_tick == tick + 32


def test_locked_parameters_of_the_board_are_not_read_and_pending_faults_not_published(bench: Bench) -> None:
    """The server may have copied half a number; the complete number is latched or published later."""
    bench.slow()
    before = bench.servo.settings.host_timeout
    bench.servo.locked = True
    bench.servo.parameter.host_timeout = before + 1
    bench.servo.parameter.monitor[0] = 1
    bench.servo.parameter.brake = 1
    bench.hal.axis[0].over_current = True
    bench.slow(2)
    assert bench.axis(0).latch.pending & FAULTS.OVER_CURRENT
    assert bench.servo.record[0].pending == 0
    settings = bench.servo.settings
    assert (settings.host_timeout, settings.monitor[0], settings.brake) == (before, 0, 0)
    bench.servo.locked = False
    bench.slow(2)
    assert bench.servo.record[0].pending & FAULTS.OVER_CURRENT
    assert (settings.host_timeout, settings.monitor[0], settings.brake) == (before + 1, 1, 1)


def test_an_omitted_latch_does_not_repeat_a_new_write(bench: Bench) -> None:
    """An old `clear_faults` must not clear a later fault."""
    bench.write(0, clear_faults=1)
    bench.slow()
    bench.core.lib.probe_run(bench.servo, TO_LATCH - 1)
    bench.core.lib.servo_m1_isr(bench.servo)  # without M2, which runs the latch
    assert bench.axis(0).command.fresh == 0


def test_locked_tick_does_not_repeat_a_fresh_write(bench: Bench) -> None:
    bench.to_spin(0)
    bench.write(0, enable=1, mode=MODE.SPEED, position=1, speed=2, i_q=3, quick_stop=1, clear_faults=1)
    bench.core.lib.probe_run(bench.servo, TO_LATCH)
    command = bench.axis(0).command
    assert command.fresh == sum(1 << bit for field, bit in BITS.items() if field != "home")
    bench.core.lib.probe_run(bench.servo, 1)
    bench.servo.locked = True
    bench.slow()
    assert command.quick_stop
    assert command.fresh == 0
    bench.servo.locked = False


def test_parameter_applies_from_the_tick_after_its_write(bench: Bench, core: Core) -> None:
    """Parameters written by the protocol, of both axes and of the board."""
    core.lib.probe_run(bench.servo, 8)
    before = [bench.axis(i).parameter.following_error for i in range(2)]
    bench.servo.parameter.following_error = [7, 8]
    core.lib.probe_run(bench.servo, 8)
    assert [bench.axis(i).parameter.following_error for i in range(2)] == before
    bench.write_raw("param.host_timeout", [321])
    core.lib.probe_run(bench.servo, 8)
    assert [bench.axis(i).parameter.following_error for i in range(2)] == [7, 8]
    assert bench.servo.settings.host_timeout == 321
    assert not bench.servo.marks.parameters


def test_limit_is_not_lost_with_an_omitted_interrupt(bench: Bench, core: Core) -> None:
    """A lower limit is applied by the next slow loop of its axis, independent of other writes before."""
    bench.to_spin(0)
    limit = bench.axis(0).limits.i_q // 2
    bench.write_raw("param.i_q_limit", [limit, limit])
    for _ in range(8):
        core.lib.servo_m1_isr(bench.servo)  # latches, and runs the slow loop of axis 2 only
    assert bench.axis(0).limits.i_q != limit
    core.lib.probe_run(bench.servo, 8)
    assert [bench.axis(i).limits.i_q for i in range(2)] == [limit, limit]


def test_counter_of_applied_writes_wraps(bench: Bench) -> None:
    bench.servo.applied_count = 0xFFFF
    bench.write(0, position=1)
    bench.slow()
    assert bench.servo.snapshot.applied_count == 0
