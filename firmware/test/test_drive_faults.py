"""Faults: raised in every state, cleared only without their cause, and never followed by motion."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from core_library import Core
from servo_bench import CODE_24V, FAULTS, STATE, SUBSTATE, Bench, bus_code

RUN_SUBSTATES = [SUBSTATE.CALIB, SUBSTATE.READY, SUBSTATE.ALIGN, SUBSTATE.SPIN, SUBSTATE.FREEWHEEL]


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def go_to(bench: Bench, axis: int, substate: int) -> None:
    bench.to_stop()
    bench.write(axis, enable=1)
    if substate == SUBSTATE.FREEWHEEL:
        bench.to_substate(axis, SUBSTATE.SPIN)
        bench.turn(axis, 20.0)
        bench.slow(5)
        bench.write(axis, enable=0)
    bench.to_substate(axis, substate)


def over_voltage(bench: Bench) -> None:
    bench.hal.bus_code = bus_code(34.0)


def under_voltage(bench: Bench) -> None:
    bench.hal.bus_code = bus_code(15.0)


def over_current(bench: Bench) -> None:
    bench.hal.axis[0].over_current = True


CAUSES = [
    (over_voltage, FAULTS.OVER_VOLTAGE),
    (under_voltage, FAULTS.UNDER_VOLTAGE),
    (over_current, FAULTS.OVER_CURRENT),
]


def remove_causes(bench: Bench) -> None:
    bench.hal.bus_code = CODE_24V
    bench.hal.axis[0].over_current = False
    bench.slow(20)


@pytest.mark.parametrize(("cause", "fault"), CAUSES)
@pytest.mark.parametrize("substate", RUN_SUBSTATES)
def test_fault_from_every_sub_state(bench: Bench, substate: int, cause: Callable[[Bench], None], fault: int) -> None:
    go_to(bench, 0, substate)
    cause(bench)
    bench.slow(20)
    assert bench.view(0).state == STATE.FAULT
    assert bench.view(0).faults == fault
    hal = bench.hal.axis[0]
    assert not hal.outputs_on
    assert list(hal.duty) == [16384] * 3
    view = bench.view(0)
    assert (view.i_q, view.i_d, view.i_q_ref, view.u_d, view.u_q) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize(("cause", "fault"), CAUSES)
def test_fault_from_stop_and_init(core: Core, cause: Callable[[Bench], None], fault: int) -> None:
    bench = Bench(core)
    bench.to_stop()
    cause(bench)
    bench.slow(20)
    assert bench.view(0).state == STATE.FAULT
    bench = Bench(core)
    cause(bench)
    bench.slow(15)
    assert bench.view(0).state == (STATE.INIT if fault == FAULTS.UNDER_VOLTAGE else STATE.FAULT)
    bench.slow(40)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.FAULT, fault)


def test_over_current_opens_the_switches_in_the_next_fast_loop(bench: Bench) -> None:
    bench.to_spin(0, 1)
    bench.hal.axis[0].over_current = True
    bench.core.lib.probe_run(bench.servo, 1)
    assert not bench.hal.axis[0].outputs_on
    assert bench.axis(0).sm.state == STATE.FAULT
    assert bench.axis(1).sm.state == STATE.RUN


def test_over_current_interrupt_opens_the_switches_immediately(bench: Bench) -> None:
    bench.to_spin(0)
    bench.hal.axis[0].over_current = True
    bench.core.lib.servo_over_current_isr(bench.servo, 0)
    assert not bench.hal.axis[0].outputs_on
    bench.slow()
    assert bench.view(0).faults == FAULTS.OVER_CURRENT


@pytest.mark.parametrize(("cause", "fault"), CAUSES)
def test_clear_works_only_when_the_cause_is_gone(bench: Bench, cause: Callable[[Bench], None], fault: int) -> None:
    bench.to_spin(0)
    cause(bench)
    bench.slow(20)
    for _ in range(3):
        bench.clear(0)
        assert (bench.view(0).state, bench.view(0).faults) == (STATE.FAULT, fault)
    remove_causes(bench)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.FAULT, fault), "a fault stays until it is cleared"
    bench.clear(0)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.INIT, 0)
    bench.slow(40)
    assert bench.view(0).state == STATE.STOP


def test_clear_keeps_the_faults_whose_cause_remains(bench: Bench) -> None:
    bench.to_spin(0)
    over_voltage(bench)
    over_current(bench)
    bench.slow(20)
    assert bench.view(0).faults == FAULTS.OVER_VOLTAGE | FAULTS.OVER_CURRENT
    bench.hal.axis[0].over_current = False
    bench.clear(0)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.FAULT, FAULTS.OVER_VOLTAGE)


def test_no_motion_after_a_fault_without_a_new_enable(bench: Bench) -> None:
    """Neither the old enable, nor one written during the fault or with the clear, arms the axis again."""
    bench.to_spin(0)
    over_current(bench)
    bench.slow(2)
    bench.write(0, enable=1)
    bench.slow()
    remove_causes(bench)
    bench.write(0, enable=1, clear_faults=1)
    bench.slow(200)
    assert bench.view(0).state == STATE.STOP
    assert not bench.hal.axis[0].outputs_on
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)


def test_clear_is_one_shot_and_does_nothing_outside_fault(bench: Bench) -> None:
    bench.to_spin(0)
    bench.clear(0)
    assert bench.servo.command.clear_faults[0] == 0
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)
    over_current(bench)
    bench.slow(2)
    bench.hal.axis[0].over_current = False
    bench.slow(50)
    assert bench.view(0).state == STATE.FAULT, "the clear from before the fault does not count"


def test_outputs_never_come_on_with_a_fault_pending(bench: Bench) -> None:
    """A fault is raised in the slow loop that would leave CALIB."""
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.CALIB)
    bench.until(lambda: bool(bench.axis(0).calibrated) or bench.axis(0).sense.samples > 500, 200)
    times_on = bench.hal.axis[0].times_on
    bench.axis(0).encoder.counter.turns += 1  # index and count disagree
    bench.slow(5)
    assert bench.view(0).faults == FAULTS.ENCODER
    assert bench.hal.axis[0].times_on == times_on


@pytest.mark.parametrize("codes", [(2048, 2048, 2200), (1800, 2048, 2048), (0, 0, 0), (4095, 4095, 4095)])
def test_offset_far_from_mid_scale_is_refused(bench: Bench, codes: tuple[int, int, int]) -> None:
    bench.to_stop()
    for phase, code in enumerate(codes):
        bench.hal.axis[0].current_code[phase] = code
    bench.write(0, enable=1)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 300)
    assert bench.view(0).faults == FAULTS.CURRENT_OFFSET
    assert bench.hal.axis[0].times_on == 0
    for phase in range(3):
        bench.hal.axis[0].current_code[phase] = 2048
    bench.clear(0)
    bench.to_spin(0)


def give_up(bench: Bench) -> float:
    """Let a search of axis 1 fail; return its duration [s]."""
    bench.to_stop()
    bench.shaft_is_free[0] = False
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    ticks = bench.until(lambda: bench.view(0).state == STATE.FAULT, 2500)
    assert not bench.hal.axis[0].outputs_on
    return ticks * 0.5e-3


def test_blocked_shaft_fails_the_search(bench: Bench) -> None:
    assert give_up(bench) < 1.2
    assert bench.view(0).faults == FAULTS.ROTOR_SEARCH
    bench.clear(0)
    bench.shaft_is_free[0] = True
    bench.to_spin(0)


@pytest.mark.parametrize("across", [-0.01, 0.01])
def test_motor_that_moves_without_a_count_has_lost_its_encoder(bench: Bench, across: float) -> None:
    """A voltage across the rotating vector at constant current is the back-EMF of a moving rotor."""
    bench.current_across[0] = across
    assert give_up(bench) < 1.2
    assert bench.view(0).faults == FAULTS.ENCODER_LOST
    bench.clear(0)
    bench.shaft_is_free[0], bench.current_across[0] = True, 0.0
    bench.to_spin(0)


def test_search_compensates_dead_time_in_spite_of_the_host(bench: Bench) -> None:
    """The search enables the compensation if the host has disabled it, and restores the setting afterwards."""
    bench.write_raw("param.features", [0, 0])
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    bench.slow(3)
    assert not bench.axis(0).current_loop.dead_time_off
    bench.to_substate(0, SUBSTATE.SPIN)
    bench.slow()
    assert bench.axis(0).current_loop.dead_time_off


def test_unplugged_motor_fails_the_search_at_once(bench: Bench) -> None:
    """Without current the search does not blame shaft or encoder; the remedy names the motor cable."""
    bench.motor_plugged[0] = False
    assert give_up(bench) < 0.05
    assert bench.view(0).faults == FAULTS.ROTOR_SEARCH
    bench.clear(0)
    bench.shaft_is_free[0] = bench.motor_plugged[0] = True
    bench.to_spin(0)


def test_search_with_an_externally_rotated_shaft_ends_in_a_fault(bench: Bench) -> None:
    bench.to_stop()
    bench.shaft_is_free[0] = False
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    bench.turn(0, 20.0)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 12000)
    assert bench.view(0).faults == FAULTS.ROTOR_SEARCH


def test_missing_index_pulse_is_an_encoder_fault_and_can_be_cleared(bench: Bench) -> None:
    bench.to_spin(0)
    bench.shaft[0].index_works = False
    bench.turn_without_current(0, 100.0)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 300)
    assert bench.view(0).faults == FAULTS.ENCODER
    bench.turn(0, 0.0)
    bench.shaft[0].index_works = True
    bench.slow(200)
    bench.clear(0)
    bench.slow(40)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.STOP, 0)
    bench.to_spin(0)
    bench.turn_without_current(0, 100.0)
    bench.slow(400)
    assert bench.view(0).state == STATE.RUN


def test_fault_of_one_axis_does_not_affect_the_other(bench: Bench) -> None:
    bench.to_spin(0, 1)
    over_current(bench)
    bench.slow(50)
    assert bench.view(0).state == STATE.FAULT
    assert (bench.view(1).state, bench.view(1).substate, bench.view(1).faults) == (STATE.RUN, SUBSTATE.SPIN, 0)


def test_bus_faults_stop_both_axes(bench: Bench) -> None:
    bench.to_spin(0, 1)
    over_voltage(bench)
    bench.slow(10)
    assert [(s[0], s[2]) for s in bench.states()] == [(STATE.FAULT, FAULTS.OVER_VOLTAGE)] * 2


@pytest.mark.parametrize(
    ("volts", "state"), [(16.3, STATE.STOP), (15.7, STATE.FAULT), (32.7, STATE.STOP), (33.3, STATE.FAULT)]
)
def test_a_bus_voltage_outside_its_limits_is_a_fault(bench: Bench, volts: float, state: int) -> None:
    bench.to_stop()
    bench.hal.bus_code = bus_code(volts)
    bench.slow(50)
    assert bench.view(0).state == state


def test_captured_fault_always_reaches_the_state_machine(bench: Bench) -> None:
    """Also if its flag is lost by an interrupt."""
    bench.to_spin(0)
    bench.axis(0).latch.captured = FAULTS.OVER_CURRENT
    bench.slow()
    assert bench.view(0).state == STATE.FAULT


# ---- host time-out ------------------------------------------------------------------------------------------------


def test_board_without_a_host_is_not_supervised(bench: Bench) -> None:
    bench.to_spin(0)
    bench.slow(3000)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)


def test_host_time_out_stops_both_axes_before_the_fault(bench: Bench) -> None:
    bench.keep_alive()
    bench.set_parameter("host_timeout", 0.1)
    bench.to_stop()
    for axis in range(2):
        bench.write(axis, enable=1)
    for _ in range(30):
        bench.keep_alive()
        bench.slow(30)
    assert [s[:2] for s in bench.states()] == [(STATE.RUN, SUBSTATE.SPIN)] * 2
    bench.turn_without_current(0, 50.0)
    bench.keep_alive()
    bench.slow(190)
    assert bench.view(0).substate == SUBSTATE.SPIN, "not before the time-out"
    bench.slow(13)
    assert bench.view(0).substate == SUBSTATE.SPIN, "the shaft is ramped down before the fault"
    assert bench.hal.axis[0].outputs_on
    assert (bench.view(1).state, bench.view(1).faults) == (STATE.FAULT, FAULTS.HOST_SILENT), "this axis was at rest"
    bench.turn(0, 0.0)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 1200)
    assert bench.view(0).faults == FAULTS.HOST_SILENT
    assert not bench.hal.axis[0].outputs_on


def test_returning_host_must_clear_and_enable(bench: Bench) -> None:
    bench.keep_alive()
    bench.to_spin(0)
    bench.slow(1500)
    assert bench.view(0).faults == FAULTS.HOST_SILENT
    bench.keep_alive()
    bench.slow(100)
    assert bench.view(0).state == STATE.FAULT
    bench.clear(0)
    bench.slow(100)
    assert bench.view(0).state == STATE.STOP
    bench.keep_alive()
    bench.write(0, enable=1)
    for _ in range(40):
        bench.keep_alive()
        bench.slow(30)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)


def test_enable_during_the_ramp_down_of_a_host_time_out_is_ignored(bench: Bench) -> None:
    bench.keep_alive()
    bench.to_spin(0)
    bench.turn_without_current(0, 100.0)
    bench.until(lambda: not bench.axis(0).enable_requested, 1100)
    bench.keep_alive()
    bench.write(0, enable=1)
    bench.slow(10)
    assert not bench.axis(0).enable_requested
    bench.turn(0, 0.0)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 1200)


def test_client_that_only_reads_does_not_reset_the_host_time_out(bench: Bench) -> None:
    """A client continues to read after the commanding host has stopped."""
    bench.keep_alive()
    bench.set_parameter("host_timeout", 0.1)
    bench.to_stop()
    bench.keep_alive()
    bench.write(0, enable=1)
    bench.slow(100)
    for _ in range(10):
        assert bench.view(0).faults == 0
        bench.receive_read()
        bench.slow(10)
    bench.receive_read()
    bench.slow(5)
    assert bench.view(0).faults == FAULTS.HOST_SILENT


def test_missing_set_points_do_not_cause_a_host_time_out(bench: Bench) -> None:
    bench.to_spin(0)
    for _ in range(100):
        bench.keep_alive()
        bench.slow(30)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.RUN, 0)
