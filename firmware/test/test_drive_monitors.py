"""Monitors of the axes besides motion: temperature, converters, loops, watchdog; and the record of a fault."""

from __future__ import annotations

import pytest
from core_library import Core
from servo_bench import ALL_FAULTS, FAULTS, MODE, STATE, SUBSTATE, Bench, speed

HOT, COOL = 2321, 1911  # codes of 85 and 70 degrees with the packaged sensor


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def place(bench: Bench, axis: int = 0) -> tuple[int, int]:
    return bench.view(axis).state, bench.view(axis).faults


def code_of(fault: int) -> int:
    return fault.bit_length()


# ---- temperature
def test_over_temperature_stops_its_axis_only(bench: Bench) -> None:
    bench.to_spin(0)
    bench.hal.axis[0].temperature_code = HOT
    bench.slow(18)
    assert place(bench) == (STATE.FAULT, FAULTS.OVER_TEMPERATURE)
    assert not bench.hal.axis[0].outputs_on
    assert place(bench, 1)[1] == 0


def test_over_temperature_can_be_cleared_below_the_hysteresis_only(bench: Bench) -> None:
    bench.to_stop()
    bench.hal.axis[0].temperature_code = HOT
    bench.slow(20)
    bench.hal.axis[0].temperature_code = COOL
    bench.clear(0)
    assert place(bench) == (STATE.FAULT, FAULTS.OVER_TEMPERATURE)
    assert bench.servo.record[0].pending == FAULTS.OVER_TEMPERATURE
    bench.hal.axis[0].temperature_code = COOL - 1
    bench.slow()
    bench.clear(0)
    assert place(bench) == (STATE.INIT, 0)


# ---- converters
def noise(bench: Bench, k: int, phases: str = "abc") -> None:
    for axis in range(2):
        for x in range(3):
            if axis == 1 or "abc"[x] in phases:
                bench.hal.axis[axis].offset_code[x] = 2048 + (7 * k + 3 * x) % 11 - 5


@pytest.mark.parametrize("phase", ["a", "b", "c"])
def test_constant_code_while_others_are_noisy_is_a_current_sense_fault(bench: Bench, phase: str) -> None:
    bench.to_stop()
    for k in range(400):
        noise(bench, k, "abc".replace(phase, ""))
        bench.slow()
    assert place(bench) == (STATE.FAULT, FAULTS.CURRENT_SENSE)
    assert place(bench, 1) == (STATE.STOP, 0)


def test_a_failed_converter_is_reported_instead_of_the_over_current_that_it_caused(bench: Bench) -> None:
    bench.to_spin(0)
    for k in range(300):
        noise(bench, k, "bc")
        bench.hal.axis[0].over_current = k == 60
        bench.slow()
    assert place(bench) == (STATE.FAULT, FAULTS.OVER_CURRENT | FAULTS.CURRENT_SENSE)
    assert bench.view(0).first_fault == code_of(FAULTS.CURRENT_SENSE)


# ---- phases and encoder: this board has no currents and no back-EMF


def without_current(bench: Bench) -> None:
    bench.to_spin(0)
    bench.servo.parameter.faults_enabled[0] = ALL_FAULTS & ~FAULTS.ENCODER_LOST
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))


@pytest.mark.parametrize(
    ("codes", "enabled", "fault"),
    [
        (1, ALL_FAULTS, FAULTS.PHASE_LOST),
        (3, ALL_FAULTS, FAULTS.CURRENT_SENSE),
        (3, ALL_FAULTS & ~FAULTS.CURRENT_SENSE, FAULTS.PHASE_LOST),
    ],
)
def test_a_current_measurement_is_suspected_after_more_than_one_code(
    core: Core, codes: int, enabled: int, fault: int
) -> None:
    """The last codes before PHASE_LOST are off their offset; each belongs to one of two sampled phases. A
    suspected converter suppresses no fault while CURRENT_SENSE is disabled."""
    sound, bench = Bench(core), Bench(core)
    without_current(sound)
    ticks = 0
    while sound.view(0).state != STATE.FAULT:
        sound.slow()
        ticks += 1
        assert ticks < 400
    without_current(bench)
    bench.servo.parameter.faults_enabled[0] = enabled & ~FAULTS.ENCODER_LOST
    bench.slow(ticks - codes)
    bench.hal.axis[0].offset_code = [2100, 2100, 2100]
    bench.slow(codes)
    assert place(bench)[1] == fault


def test_an_alternating_count_is_a_dead_channel(bench: Bench) -> None:
    bench.to_stop()
    for k in range(80):
        bench.turn(0, (1.0 if k % 2 else -1.0) * 0.0015707963 / 0.5e-3)
        bench.slow()
    assert place(bench) == (STATE.FAULT, FAULTS.ENCODER_LOST)


# ---- loops and watchdog
def test_one_omitted_loop_is_tolerated_and_more_are_a_fault_of_both_axes(bench: Bench) -> None:
    bench.to_spin(0)
    lib, servo = bench.core.lib, bench.servo
    lib.servo_m1_isr(servo)
    bench.slow(80)
    assert place(bench)[1] == 0
    for _ in range(3):
        lib.servo_m1_isr(servo)
    bench.slow(2)
    for axis in range(2):
        assert place(bench, axis) == (STATE.FAULT, FAULTS.LATE_LOOP)


def test_late_loops_expire(bench: Bench) -> None:
    bench.to_spin(0)
    for _ in range(20):
        bench.hal.late_loops += 1
        bench.slow(70)
    assert place(bench)[1] == 0
    bench.hal.late_loops += 3
    bench.slow(2)
    assert place(bench) == (STATE.FAULT, FAULTS.LATE_LOOP)


def test_a_reset_by_the_watchdog_keeps_the_board_off(core: Core) -> None:
    bench = Bench(core)
    bench.hal.reset_by_watchdog = True
    core.lib.servo_init(bench.servo, bench.hal, core.lib.probe_config())
    bench.slow(50)
    bench.write(0, enable=1)
    bench.slow(50)
    for axis in range(2):
        assert place(bench, axis) == (STATE.FAULT, FAULTS.WATCHDOG)
    bench.clear(0)
    bench.slow(50)
    assert place(bench) == (STATE.STOP, 0)
    assert place(bench, 1) == (STATE.FAULT, FAULTS.WATCHDOG)


def test_an_edge_from_before_a_reset_is_not_used_for_the_speed(bench: Bench) -> None:
    """The memory keeps its content at a restart of the board."""
    bench.turn_without_current(0, 100.0)
    bench.slow(20)
    bench.turn(0, 0.0)
    bench.slow(300)
    encoder = bench.axis(0).encoder
    encoder.edge_waits, encoder.skip_edge = True, False
    encoder.edge = (100, 30)
    bench.core.lib.servo_init(bench.servo, bench.hal, bench.core.lib.probe_config())
    assert not encoder.edge_waits
    encoder.edge_waits = True
    bench.axis(0).source.reset(bench.core.ffi.addressof(bench.axis(0)))
    assert not encoder.edge_waits
    speeds = set()
    for _ in range(5):
        bench.slow()
        speeds.add(bench.view(0).speed)
    assert speeds == {0}


@pytest.mark.parametrize("waits", [False, True])
def test_the_first_edge_after_an_alignment_is_skipped_and_after_a_reset_is_not(bench: Bench, waits: bool) -> None:
    """The pending edge was captured before; it is not the skipped one."""
    axis = bench.axis(0)
    encoder, pointer = axis.encoder, bench.core.ffi.addressof(axis)
    encoder.edge_waits, encoder.skip_edge = waits, False
    axis.source.align(pointer, 0)
    assert (encoder.edge_waits, encoder.skip_edge) == (False, True)
    encoder.edge_waits = waits
    axis.source.reset(pointer)
    assert (encoder.edge_waits, encoder.skip_edge) == (False, False)


# ---- disabled faults
def test_hardware_faults_cannot_be_disabled(bench: Bench) -> None:
    bench.to_spin(0)
    bench.servo.parameter.faults_enabled = [0, 0]
    bench.slow()
    bench.hal.axis[0].temperature_code = 4095
    bench.slow(20)
    assert place(bench) == (STATE.FAULT, FAULTS.OVER_TEMPERATURE)


def test_a_disabled_fault_stops_nothing(bench: Bench) -> None:
    bench.to_spin(0)
    bench.servo.parameter.faults_enabled[0] = ALL_FAULTS & ~(FAULTS.CURRENT_SENSE | FAULTS.PHASE_LOST)
    bench.slow()
    bench.hal.axis[0].offset_code = [2100, 2100, 2100]
    bench.slow(8)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)


# ---- the record
def test_the_record_ends_with_the_fault_and_is_kept_until_it_is_cleared(bench: Bench) -> None:
    bench.to_spin(0)
    bench.slow(100)
    for k in range(30):
        bench.hal.bus_code = 2700 + k
        bench.slow()
    bench.hal.bus_code = 2750
    bench.hal.axis[0].over_current = True
    tick = bench.servo.tick
    bench.slow()
    record = bench.servo.record[0]
    assert (record.code, record.state, record.substate) == (code_of(FAULTS.OVER_CURRENT), STATE.RUN, SUBSTATE.SPIN)
    assert 0 <= record.tick - tick <= 2
    rings = [list(record.u_dc), list(record.i_q)]
    order = [(record.next + k) % 64 for k in range(64)]
    assert record.size == 64
    assert [round(rings[0][k] / 8) for k in order][-31:] == [*(2700 + k for k in range(30)), 2750]
    bench.hal.bus_code = 2800
    bench.slow(10)
    assert [list(record.u_dc), list(record.i_q)] == rings
    bench.hal.axis[0].over_current = False
    bench.clear(0)
    bench.slow(70)
    assert {round(x / 8) for x in record.u_dc} == {2800}
