"""The timing diagram of DRM F34 as the order of calls, and the snapshot of a tick."""

from __future__ import annotations

import pytest
from core_library import Core
from servo_bench import STATE, SUBSTATE, Bench

M1, M2 = 0, 1


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def parts(calls: list[tuple[str, int, int]]) -> list[tuple[str, int]]:
    """Loops in the order in which they ran: a slow loop arms a capture, a fast one loads duties."""
    names = {"capture_arm": "slow", "pwm_duty": "fast", "adc_offsets": "offsets", "watchdog": "watchdog"}
    return [(names[name], axis) for name, axis, _ in calls if name in names]


def test_m1_runs_the_fast_loop_of_motor_1_then_the_slow_loop_of_motor_2(bench: Bench, core: Core) -> None:
    bench.to_spin(M1, M2)
    core.lib.probe_run(bench.servo, 7)
    bench.log()
    core.lib.servo_m1_isr(bench.servo)
    assert parts(bench.calls()) == [("fast", M1), ("slow", M2)]


def test_m2_runs_the_fast_loop_of_motor_2_then_the_slow_loop_of_motor_1(bench: Bench, core: Core) -> None:
    bench.to_spin(M1, M2)
    core.lib.probe_run(bench.servo, 7)
    core.lib.servo_m1_isr(bench.servo)
    bench.log()
    core.lib.servo_m2_isr(bench.servo)
    assert parts(bench.calls()) == [("fast", M2), ("slow", M1)]


def test_other_slots_also_run_after_the_fast_loops(bench: Bench, core: Core) -> None:
    """The estimates run a quarter of a slow tick after the slow loops, the monitors after half of it.

    Each axis in the interrupt of the other axis, after its offsets have been sampled.
    """
    bench.to_spin(M1, M2)
    for period in range(1, 8):
        bench.log()
        core.lib.servo_m1_isr(bench.servo)
        core.lib.servo_m2_isr(bench.servo)
        looked = [[("offsets", M2)], [("offsets", M1)]] if period in (2, 4) else [[], []]
        served = [("watchdog", 0xFFFF)] if period == 6 else []
        assert parts(bench.calls()) == [("fast", M1), *looked[0], ("fast", M2), *looked[1], *served]


def test_a_fast_loop_signals_when_its_duties_are_written(bench: Bench, core: Core) -> None:
    bench.to_spin(M1, M2)
    before = list(bench.hal.duties_done)
    core.lib.probe_run(bench.servo, 5)
    assert [now - then for now, then in zip(bench.hal.duties_done, before, strict=True)] == [5, 5]


def test_captured_edge_is_read_before_the_next_is_armed(bench: Bench, core: Core) -> None:
    """Clearing the flags first would discard a capture whose interrupt is pending."""
    bench.to_spin(M1)
    core.lib.probe_run(bench.servo, 7)
    bench.log()
    core.lib.probe_run(bench.servo, 1)
    order = [
        name for name, axis, _ in bench.calls() if axis == M1 and name in ("capture_take", "edge_age", "capture_arm")
    ]
    assert order == ["capture_take", "edge_age", "capture_arm"]


def test_counter_is_read_before_the_index(bench: Bench, core: Core) -> None:
    """In the reverse order the index pulse of a counted wrap could be missed."""
    bench.to_spin(M1)
    core.lib.probe_run(bench.servo, 7)
    core.lib.servo_m1_isr(bench.servo)
    bench.log()
    core.lib.servo_m2_isr(bench.servo)
    order = [name for name, axis, _ in bench.calls() if axis == M1 and name in ("encoder_count", "index_count")]
    assert order == ["encoder_count", "index_count"]


def test_edge_interrupt_reads_the_edge_and_the_slow_loop_uses_it(bench: Bench, core: Core) -> None:
    """The speed does not depend on whether the interrupt or the slow loop reads the capture."""
    speeds = []
    for interrupt in (False, True):
        b = Bench(core)
        b.to_spin(M1)
        for k in range(1, 4):
            hal = b.hal.axis[0]
            hal.count = (hal.count + 20) & 0xFFFF
            hal.edge.count, hal.edge.time = hal.count, 390 * k
            hal.edge_waits, hal.age = True, 5
            if interrupt:
                core.lib.servo_edge_isr(b.servo, M1)
                assert not hal.edge_waits
            core.lib.probe_run(b.servo, 8)
        speeds.append(b.view(0).speed)
    assert speeds[0] == speeds[1] > 0


def test_phase_pair_is_chosen_with_the_duties(bench: Bench, core: Core) -> None:
    """The conversions of the next period belong to the sector of the duties loaded now."""
    bench.to_spin(M1)
    bench.hal.axis[0].current_code[0] = 2100
    bench.log()
    core.lib.servo_m1_isr(bench.servo)
    names = [name for name, axis, _ in bench.calls() if axis == M1]
    assert names.index("adc_currents") < names.index("pwm_duty") < names.index("adc_select")
    assert bench.axis(0).sense.pair == bench.hal.axis[0].pair


def test_watchdog_is_serviced_once_per_slow_tick(bench: Bench) -> None:
    before = bench.hal.watchdog
    bench.slow(100)
    assert bench.hal.watchdog == before + 100


@pytest.mark.parametrize("phase", range(8))
def test_watchdog_is_not_serviced_if_one_interrupt_stops(core: Core, phase: int) -> None:
    for dead in ("m1", "m2"):
        bench = Bench(core)
        bench.slow(3)
        core.lib.probe_run(bench.servo, phase)
        if dead == "m1":
            core.lib.servo_m1_isr(bench.servo)
        before = bench.hal.watchdog
        for _ in range(64):
            (core.lib.servo_m2_isr if dead == "m1" else core.lib.servo_m1_isr)(bench.servo)
        assert bench.hal.watchdog <= before + 1


# ---- the snapshot ---------------------------------------------------------------------------------------------------


def test_snapshot_counts_pwm_periods(bench: Bench) -> None:
    for k in range(1, 20):
        bench.slow()
        assert bench.servo.snapshot.tick == 8 * k == bench.servo.tick


def test_the_tick_wraps_without_a_change_of_state(bench: Bench, core: Core) -> None:
    bench.to_spin(M1)
    bench.servo.tick = 2**32 - 16
    bench.slow(4)
    assert bench.servo.snapshot.tick == 16
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)


def test_snapshot_is_taken_after_both_slow_loops(bench: Bench, core: Core) -> None:
    """Both axes have the values of the same tick, unchanged until the next tick."""
    bench.to_spin(M1, M2)
    bench.shaft[M1].move(12)
    bench.shaft[M2].move(-7)
    before = [bench.view(i).position for i in range(2)]
    core.lib.probe_run(bench.servo, 7)
    assert [bench.view(i).position for i in range(2)] == before
    for i in range(2):
        bench.hal.axis[i].count = (bench.hal.axis[i].count + (12, -7)[i]) & 0xFFFF
    core.lib.servo_m1_isr(bench.servo)
    assert [bench.view(i).position for i in range(2)] == before
    core.lib.servo_m2_isr(bench.servo)
    assert [bench.view(i).position for i in range(2)] == [before[0] + 12, before[1] - 7]
    copy = bytes(core.ffi.buffer(core.ffi.addressof(bench.servo, "snapshot")))
    core.lib.probe_run(bench.servo, 7)
    assert bytes(core.ffi.buffer(core.ffi.addressof(bench.servo, "snapshot"))) == copy


def test_same_inputs_give_the_same_outputs(core: Core) -> None:
    """Bit-identical results of two boards in one process."""
    snapshots = []
    boards = [Bench(core), Bench(core)]
    for bench in boards:
        bench.to_stop()
    for step in range(400):
        for bench in boards:
            if step == 0:
                bench.write(0, enable=1)
                bench.write(1, enable=1)
            if step == 300:
                bench.write_raw("cmd.position", [1000, -500])
            bench.slow()
    for bench in boards:
        snapshots.append(bytes(core.ffi.buffer(core.ffi.addressof(bench.servo, "snapshot"))))
    assert snapshots[0] == snapshots[1]


def test_identify_gives_hash_and_tick(bench: Bench, core: Core) -> None:
    bench.slow(5)
    app = bench.servo.freemaster.app
    result, size = core.ffi.new("uint8_t[16]"), core.ffi.new("uint16_t *")
    assert app.command(app.context, 3, core.ffi.NULL, 0, result, size) == 0
    answer = bytes(result[0 : size[0]])
    assert answer == bench.catalogue.hash.to_bytes(4, "little") + (40).to_bytes(4, "little")
    assert app.command(app.context, 99, core.ffi.NULL, 0, result, size) != 0
    assert size[0] == 0
