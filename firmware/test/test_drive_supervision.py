"""Supervision of a spinning axis: stall, runaway, minimum ramp of a stop, and features of the control."""

from __future__ import annotations

import itertools
import math

import pytest
from core_library import Core
from servo_bench import (
    COUNT,
    FAULTS,
    FEATURES,
    MODE,
    PERIODS,
    STATE,
    SUBSTATE,
    TICK,
    Bench,
    amps,
    bus_code,
    rad_s,
    speed,
)


def running(bench: Bench, mode: int, rad_per_s: float) -> None:
    """An ideal shaft in motion, in one of the modes."""
    if mode == MODE.POSITION:
        bench.write(0, mode=MODE.POSITION, position=2_000_000)
    else:
        bench.write(0, mode=MODE.SPEED, speed=speed(rad_per_s))
    bench.follow(400)
    if mode == MODE.TORQUE:
        bench.write(0, mode=MODE.TORQUE, i_q=amps(0.5))
        bench.slow(5)


# ---- stall ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "target", [{"mode": MODE.SPEED, "speed": speed(50.0)}, {"mode": MODE.POSITION, "position": 4000}]
)
def test_full_current_without_movement_is_a_stall(bench: Bench, target: dict[str, int]) -> None:
    """Blocked shaft or dead encoder: the full current is limited in time."""
    bench.write(0, **target)
    ticks = bench.until(lambda: bench.view(0).state == STATE.FAULT, 2000)
    assert bench.view(0).faults == FAULTS.STALLED
    # servo.toml: timing.stall_max, rotor_search.turn_time in both directions, and the ramp to the limit
    assert 0.7 <= ticks * 0.5e-3 <= 0.95
    assert not bench.hal.axis[0].outputs_on


def test_torque_against_a_wall_is_no_stall(bench: Bench) -> None:
    """Full torque at standstill is normal in torque mode."""
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(3000)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.RUN, 0)


# ---- runaway --------------------------------------------------------------------------------------------------------


def test_gaining_speed_against_the_full_current_is_a_runaway(bench: Bench) -> None:
    """As after an encoder slip by half an electrical revolution: the torque has the wrong sign."""
    for k in range(200):
        if bench.view(0).state == STATE.FAULT:
            break
        bench.turn(0, 2.0 * k)
        bench.slow()
    assert bench.view(0).faults == FAULTS.RUNAWAY
    assert k < 100
    assert not bench.hal.axis[0].outputs_on


@pytest.mark.parametrize("sign", [1, -1])
def test_speed_far_above_its_limit_is_a_runaway(bench: Bench, sign: int) -> None:
    bench.turn_without_current(0, sign * 300.0)
    bench.slow(100)
    assert bench.view(0).state == STATE.RUN
    bench.turn(0, sign * 380.0)
    ticks = bench.until(lambda: bench.view(0).state == STATE.FAULT, 100)
    assert bench.view(0).faults == FAULTS.RUNAWAY
    assert ticks * 0.5e-3 <= 0.03


@pytest.mark.parametrize("sign", [1, -1])
def test_reversal_at_full_current_is_no_runaway(bench: Bench, sign: int) -> None:
    """Braking at full current while the speed decreases."""
    bench.write(0, mode=MODE.SPEED, speed=speed(sign * 300.0))
    bench.follow(250)
    bench.write(0, speed=speed(-sign * 300.0))
    shaft = sign * 300.0
    for _ in range(600):
        shaft = max(min(shaft - sign * 1.0, 300.0), -300.0)  # slower than the ramp: the current is at its limit
        bench.turn(0, shaft)
        bench.slow()
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.RUN, 0)


def test_braking_is_no_runaway(bench: Bench) -> None:
    bench.turn_without_current(0, 300.0)
    bench.slow(50)
    bench.write(0, enable=0)
    for k in range(300):
        bench.turn(0, 300.0 - k)
        bench.slow()
        assert bench.view(0).faults == 0
    assert (bench.view(0).state, bench.view(0).substate) in (
        (STATE.RUN, SUBSTATE.SPIN),
        (STATE.RUN, SUBSTATE.FREEWHEEL),
    )


@pytest.mark.parametrize("mode", [MODE.POSITION, MODE.SPEED, MODE.TORQUE])
def test_lowered_speed_limit_brakes_and_is_no_runaway(bench: Bench, mode: int) -> None:
    """The host lowers the limit in motion: the speed ramps down below it, the axis stays in RUN."""
    running(bench, mode, 280.0)
    bench.set_parameter("speed_limit", 100.0)
    shaft = rad_s(bench.view(0).speed)
    for _ in range(600):
        set_point = rad_s(bench.view(0).speed_ref) if mode != MODE.TORQUE else 100.0
        shaft = max(set_point, shaft - 3.0)  # 6000 rad/s2: possible with some amperes
        bench.turn(0, shaft)
        bench.slow()
        assert bench.view(0).faults == 0, f"at {shaft:.0f} rad/s"
    assert shaft <= 101.0


# ---- stop -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", [{"quick_stop": 1}, {"enable": 0}])
def test_stops_obey_the_acceleration_limit(bench: Bench, stop: dict[str, int]) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(200.0))
    bench.follow(300)
    bench.set_parameter("acceleration_limit", 100.0)
    bench.write(0, **stop)
    bench.follow(1)
    references = bench.trace(1000, lambda: rad_s(bench.view(0).speed_ref))
    steps = [a - b for a, b in itertools.pairwise(references)]
    assert max(steps) == pytest.approx(100.0 * 0.5e-3, rel=1e-3)
    assert references[0] - references[-1] == pytest.approx(50.0, abs=0.5)


def test_stop_with_a_low_acceleration_limit_ends_in_time(bench: Bench) -> None:
    """At 1 rad/s2 it would take minutes: after stop.time_max, 5 s, the outputs go off."""
    bench.write(0, mode=MODE.SPEED, speed=speed(200.0))
    bench.follow(300)
    bench.set_parameter("acceleration_limit", 1.0)
    bench.write(0, enable=0)
    bench.follow(9990)
    assert bench.hal.axis[0].outputs_on
    bench.follow(20)
    assert not bench.hal.axis[0].outputs_on


def test_steep_acceleration_limits_apply_to_stops(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(200.0))
    bench.follow(300)
    bench.write(0, quick_stop=1)
    bench.follow(int(200.0 / 4000.0 / 0.5e-3) + 10)
    assert abs(rad_s(bench.view(0).speed_ref)) < 1.0


# ---- enable of a rotating shaft--------------------------------------------------------------------------------------


def test_calib_waits_for_a_coasting_shaft(bench: Bench) -> None:
    """Otherwise READY would short the windings at full speed after a fault."""
    bench.turn_without_current(0, 250.0)
    bench.slow(20)
    bench.hal.axis[0].over_current = True
    bench.slow(2)
    bench.hal.axis[0].over_current = False
    bench.clear(0)
    bench.to_stop()
    bench.write(0, enable=1)
    times_on = bench.hal.axis[0].times_on
    bench.slow(1000)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.CALIB)
    assert bench.axis(0).sense.samples == 0, "a rotating shaft may drive current through the diodes"
    bench.axis(0).calibrated = True  # it began to rotate after the last sample
    bench.slow(10)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.CALIB)
    assert bench.hal.axis[0].times_on == times_on
    bench.axis(0).calibrated = False
    bench.turn(0, 0.0)
    bench.to_substate(0, SUBSTATE.READY)
    bench.to_substate(0, SUBSTATE.SPIN)


def test_waiting_in_calib_can_be_cancelled(bench: Bench) -> None:
    bench.turn_without_current(0, 100.0)
    bench.slow(20)
    bench.hal.bus_code = bus_code(14.0)
    bench.slow(20)
    bench.hal.bus_code = bus_code(24.0)
    bench.slow(20)
    for axis in range(2):
        bench.clear(axis)
    bench.to_stop()
    bench.write(0, enable=1)
    bench.slow(500)
    assert bench.view(0).substate == SUBSTATE.CALIB
    bench.write(0, enable=0)
    bench.slow(2)
    assert bench.view(0).state == STATE.STOP


@pytest.mark.parametrize("wait", [SUBSTATE.CALIB, SUBSTATE.FREEWHEEL])
def test_enable_of_a_rotating_shaft_expires(bench: Bench, wait: int) -> None:
    """An externally driven shaft must not start automatically when it comes to rest minutes later."""
    bench.turn_without_current(0, 100.0)
    bench.slow(20)
    if wait == SUBSTATE.CALIB:
        bench.hal.axis[0].over_current = True
        bench.slow(2)
        bench.hal.axis[0].over_current = False
        bench.clear(0)
        bench.to_stop()
    else:
        bench.write(0, enable=0)
        bench.to_substate(0, SUBSTATE.FREEWHEEL)
    bench.write(0, enable=1)
    bench.slow(5)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, wait)
    assert bench.axis(0).enable_requested
    times_on = bench.hal.axis[0].times_on
    bench.core.lib.probe_run(bench.servo, 26 * 16000)  # servo.toml: timing.rest_max; the edges stay recent
    assert not bench.axis(0).enable_requested
    bench.turn(0, 0.0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 300)
    bench.slow(500)
    assert bench.view(0).state == STATE.STOP
    if wait == SUBSTATE.CALIB:
        assert bench.hal.axis[0].times_on == times_on


# ---- features --------------------------------------------------------------------------------------------------------


def switch_off(bench: Bench, feature: int) -> None:
    bench.write_raw("param.features", [15 & ~feature, 15])
    bench.slow(2)


def test_all_features_of_the_reference_are_enabled_after_reset(bench: Bench) -> None:
    assert [bench.axis(i).parameter.features for i in range(2)] == [15, 15]


def test_anti_windup_can_be_disabled(bench: Bench) -> None:
    bench.servo.parameter.faults_enabled = [0, 0]  # voltage without current is a fault
    integrals = []
    for feature in (0, FEATURES.ANTI_WINDUP):
        switch_off(bench, feature)
        bench.write(0, mode=MODE.SPEED, speed=speed(300.0))
        bench.slow(200)
        integrals.append(bench.axis(0).motion.speed_pi.integral)
        bench.write(0, quick_stop=1)
        bench.follow(20)
        bench.write(0, enable=1)
    assert integrals[1] > 2 * max(integrals[0], 1)


def test_enhanced_m_t_can_be_disabled(core: Core) -> None:
    """Plain M/T holds the last speed until the timer overflows (F18)."""
    stopped = []
    for feature in (0, FEATURES.ENHANCED_MT):
        bench = Bench(core)
        bench.to_spin(0)
        switch_off(bench, feature)
        bench.turn_without_current(0, 60.0)
        bench.slow(50)
        bench.turn(0, 0.0)
        bench.slow(20)
        stopped.append(rad_s(bench.view(0).speed))
        bench.slow(200)
        assert bench.view(0).speed == 0
    assert stopped[0] < 10.0
    assert stopped[1] == pytest.approx(60.0, rel=0.1)


@pytest.mark.parametrize("off", [0, FEATURES.ENHANCED_MT])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_edge_just_after_a_timer_wrap_gives_no_high_speed(core: Core, off: int, sign: int) -> None:
    """One edge per 168 slow ticks, 65625 timer ticks: the 16-bit difference is 89, which would be 14 rad/s."""
    bench = Bench(core)
    bench.to_spin(0)
    switch_off(bench, off)
    bench.turn_without_current(0, sign * COUNT / (168 * TICK))
    speeds = set()
    for _ in range(4 * 168):
        bench.slow()
        speeds.add(bench.view(0).speed)
    assert speeds == {0}


def test_bus_compensation_can_be_disabled(core: Core) -> None:
    """Without it the duties do not depend on the bus voltage."""
    swings = []
    for feature in (0, FEATURES.BUS_COMPENSATION):
        bench = Bench(core)
        bench.to_spin(0)
        switch_off(bench, feature)
        bench.write(0, mode=MODE.TORQUE, i_q=amps(0.02))
        bench.slow(4)
        bench.axis(0).current_loop.q.integral = 2**52  # a steady voltage
        bench.axis(0).current_loop.d.integral = 0
        duties = []
        for volts in (24.0, 18.0):
            bench.hal.bus_code = bus_code(volts)
            core.lib.servo_m1_isr(bench.servo)
            duties.append(max(bench.hal.axis[0].duty) - min(bench.hal.axis[0].duty))
        swings.append(duties[1] / duties[0])
    assert swings[0] == pytest.approx(24.0 / 18.0, rel=0.03)
    assert swings[1] == pytest.approx(1.0, rel=0.03)


def test_dead_time_compensation_can_be_disabled(core: Core) -> None:
    """With 2 A in phase a the duties differ by twice the loss of dead time and voltage drops."""
    spans = []
    for feature in (0, FEATURES.DEAD_TIME):
        bench = Bench(core)
        bench.to_spin(0)
        switch_off(bench, feature)
        bench.write(0, mode=MODE.TORQUE, i_q=0)
        for phase, current in enumerate((2.0, -1.0, -1.0)):
            bench.hal.axis[0].current_code[phase] = 2048 + round(current / 8.25 * 2048)
        bench.slow(1)
        for controller in (bench.axis(0).current_loop.d, bench.axis(0).current_loop.q):
            controller.integral = controller.excess = 0
        core.lib.servo_m1_isr(bench.servo)
        a, b, c = bench.hal.axis[0].duty
        spans.append((a - (b + c) / 2) / 32768)
    assert spans[0] - spans[1] == pytest.approx(2 * (1e-6 * 16000 + 0.7 / 24), rel=0.1)


# ---- following error -------------------------------------------------------------------------------------------------


def test_blocked_shaft_in_a_move_is_a_following_error(bench: Bench) -> None:
    """1 rad for 10 ms (servo.toml): long before the stall time of half a second."""
    bench.switch_on(0, FEATURES.FOLLOWING_ERROR)
    bench.slow()
    bench.write(0, position=20_000)
    ticks = bench.until(lambda: bench.view(0).state == STATE.FAULT, 400)
    assert bench.view(0).faults == FAULTS.FOLLOWING_ERROR
    assert not bench.hal.axis[0].outputs_on
    assert ticks * 0.5e-3 < 0.1


@pytest.mark.parametrize("features", [0, FEATURES.SPEED_FORWARD])
@pytest.mark.parametrize("bound", [0.5, 1.0])
def test_lag_proportional_to_the_speed_is_no_following_error(bench: Bench, features: int, bound: float) -> None:
    """The lag of 3332 counts at 314 rad/s without feed-forward (E44) is not a following error."""
    bench.set_parameter("following_error", bound)
    bench.switch_on(0, FEATURES.FOLLOWING_ERROR | features)
    bench.slow()
    for target in (100_000, -100_000, 40):
        bench.write(0, position=target)
        bench.follow(700)
    assert (bench.view(0).state, bench.view(0).faults) == (STATE.RUN, 0)


def test_displacement_by_a_load_is_a_following_error(bench: Bench) -> None:
    """Bound: a distance (1 rad = 637 counts) for a time (10 ms = 20 ticks)."""
    bench.switch_on(0, FEATURES.FOLLOWING_ERROR)
    bench.slow()
    for counts in (636, -636):
        bench.shaft[0].move(counts)
        bench.slow(100)
        bench.shaft[0].move(-counts)
        bench.slow(5)
        bench.shaft[0].move(counts + 20 * (counts // abs(counts)))
        bench.slow(19)
        bench.shaft[0].move(-counts - 20 * (counts // abs(counts)))
        bench.slow(5)
        assert bench.view(0).state == STATE.RUN
    bench.shaft[0].move(638)
    bench.slow(25)
    assert bench.view(0).faults == FAULTS.FOLLOWING_ERROR


@pytest.mark.parametrize("mode", [MODE.SPEED, MODE.TORQUE])
def test_following_error_exists_only_with_a_position_set_point(bench: Bench, mode: int) -> None:
    bench.switch_on(0, FEATURES.FOLLOWING_ERROR)
    bench.slow()
    bench.write(0, mode=mode, speed=0, i_q=0)
    bench.slow(5)
    bench.shaft[0].move(1500)
    bench.slow(100)
    assert bench.view(0).state == STATE.RUN


# ---- over-speed ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [1, -1])
def test_over_speed_is_a_fault_within_milliseconds(bench: Bench, direction: int) -> None:
    bench.set_parameter("over_speed", 200.0)
    bench.switch_on(0, FEATURES.OVER_SPEED)
    bench.turn_without_current(0, direction * 195.0)
    bench.slow(100)
    assert bench.view(0).state == STATE.RUN
    bench.turn(0, direction * 205.0)
    ticks = bench.until(lambda: bench.view(0).state == STATE.FAULT, 20)
    assert bench.view(0).faults == FAULTS.OVER_SPEED
    assert not bench.hal.axis[0].outputs_on
    assert 4 <= ticks <= 8  # servo.toml: timing.over_speed_max, 2 ms


# ---- test currents of the drive ------------------------------------------------------------------------------------


@pytest.mark.parametrize("i_q", [4.0, -4.0, 3.9, 0.0])
@pytest.mark.parametrize("along_q", [True, False])
def test_a_current_that_tests_the_encoder_stays_within_the_limit_of_the_motor(
    bench: Bench, i_q: float, along_q: bool
) -> None:
    """A test current of 0.64 A with either sign, along or across the set-point."""
    bench.turn_without_current(0, 0.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(i_q))
    bench.slow(2)
    axis = bench.axis(0)
    monitor, before = axis.diagnosis.encoder, axis.current_ref.q
    monitor.test_ticks, monitor.along_q, monitor.negative_q = 1, along_q, along_q and before > 0
    bench.core.lib.probe_run(bench.servo, PERIODS)
    asked = axis.current_ref.q - before if along_q else axis.current_ref.d
    assert abs(asked) == pytest.approx(amps(0.64), abs=4)
    assert math.hypot(axis.current_ref.d, axis.current_ref.q) <= amps(4.0) + 1
