"""Sub-state TEST and test signals: start, end, and effect on the set-points."""

from __future__ import annotations

import pytest
from core_library import Core
from servo_bench import (
    FAULTS,
    FEATURES,
    INPUTS,
    LIMITS,
    MODE,
    STATE,
    SUBSTATE,
    TEST_POINT,
    Bench,
    amps,
    bus_code,
    rad_s,
    speed,
)

TURN = 2**32


def current(bench: Bench) -> float:
    """Current set-point of TEST [A]."""
    return float(bench.axis(0).current_ref.d / 32768 * 8.25)


def start_signal(bench: Bench, point: int, amplitude: float = 0.05, step: float = 0.01, calls: int = 200) -> None:
    """Start a signal on the first axis; amplitude relative to full scale, step in revolutions per call."""
    bench.write(0, test_amplitude=round(amplitude * 32768), test_step=round(step * TURN), test_growth=0)
    bench.write(0, test_calls=calls, test_point=point)


def point(bench: Bench) -> int:
    return int(bench.axis(0).test_signal.point)


@pytest.fixture
def testing(core: Core) -> Bench:
    """The first axis in TEST."""
    bench = Bench(core)
    bench.to_stop()
    bench.write(0, mode=4, enable=1)
    bench.to_substate(0, SUBSTATE.TEST)
    return bench


# ---- sub-state TEST -------------------------------------------------------------------------------------------------


def test_test_mode_begins_without_current_independent_of_the_memory(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    bench.write(0, i_q=amps(2.0), speed=speed(20.0))
    bench.slow(2)
    bench.write(0, mode=4, enable=1)
    bench.to_substate(0, SUBSTATE.TEST)
    bench.slow(100)
    assert current(bench) == 0.0
    assert bench.axis(0).startup.step == 0


def test_current_and_speed_of_the_vector_ramp_to_their_set_points(testing: Bench) -> None:
    slew = testing.axis(0).config.rotor_search.current_slew / 2**31 * 8.25
    testing.write(0, i_q=amps(1.5), speed=speed(30.0))
    testing.slow(2)
    assert current(testing) == pytest.approx(min(1.5, 2 * slew), rel=0.01)
    testing.slow(200)
    assert current(testing) == pytest.approx(1.5, abs=0.001)
    before = testing.axis(0).startup.angle
    testing.slow(100)
    rotation = ((testing.axis(0).startup.angle - before) % TURN) / TURN
    pairs = testing.axis(0).config.encoder.pole_pairs
    assert rotation == pytest.approx(30.0 * pairs * 0.05 / 6.2831853 % 1.0, abs=0.002)


def test_limits_apply_in_test_mode(testing: Bench) -> None:
    testing.set_parameter("i_q_limit", 1.0)
    testing.set_parameter("speed_limit", 10.0)
    testing.write(0, i_q=amps(3.0), speed=speed(30.0))
    testing.slow(300)
    assert current(testing) == pytest.approx(1.0, abs=0.001)
    assert testing.axis(0).startup.speed == pytest.approx(speed(10.0), rel=1e-6)
    assert testing.view(0).limits & (LIMITS.CURRENT | LIMITS.SPEED) == LIMITS.CURRENT | LIMITS.SPEED


def test_a_vector_with_expired_set_points_stops_and_holds(testing: Bench) -> None:
    testing.set_parameter("command_timeout", 0.05)
    testing.write(0, i_q=amps(1.0), speed=speed(10.0))
    testing.slow(60)
    assert testing.axis(0).startup.step != 0
    testing.slow(200)
    assert current(testing) == pytest.approx(1.0, abs=0.001)
    assert testing.axis(0).startup.step == 0
    assert testing.view(0).limits & LIMITS.EXPIRED
    assert testing.view(0).substate == SUBSTATE.TEST


def test_over_speed_is_a_fault_in_test_mode(testing: Bench) -> None:
    testing.set_parameter("over_speed", 50.0)
    testing.switch_on(0, FEATURES.OVER_SPEED)
    testing.slow(2)
    testing.turn(0, 60.0)
    testing.until(lambda: testing.view(0).state == STATE.FAULT, 60)
    assert testing.view(0).faults == FAULTS.OVER_SPEED


@pytest.mark.parametrize("command", [{"enable": 0}, {"quick_stop": 1}, {"mode": MODE.POSITION}, {"mode": MODE.SPEED}])
def test_test_mode_ends_without_current_and_waits_for_an_enable(testing: Bench, command: dict[str, int]) -> None:
    testing.write(0, i_q=amps(1.0))
    testing.slow(100)
    testing.write(0, **command)
    testing.until(lambda: testing.view(0).substate == SUBSTATE.READY or testing.view(0).state == STATE.STOP, 5)
    testing.until(lambda: testing.view(0).state == STATE.STOP, 5)
    testing.slow(500)
    assert testing.view(0).state == STATE.STOP
    assert not testing.hal.axis[0].outputs_on


def test_a_fast_shaft_coasts_after_test_mode(testing: Bench) -> None:
    testing.turn(0, 300.0)
    testing.slow(20)
    testing.write(0, enable=0)
    testing.to_substate(0, SUBSTATE.FREEWHEEL, 5)
    assert not testing.hal.axis[0].outputs_on


def test_test_mode_alone_starts_no_motion(bench: Bench) -> None:
    """A spinning axis comes to rest and holds; the position in memory is not followed."""
    bench.write(0, mode=MODE.SPEED, speed=speed(20.0))
    bench.follow(100)
    bench.write(0, mode=4, position=100_000)
    log = bench.follow(400)
    assert bench.view(0).substate == SUBSTATE.SPIN
    assert log[-1][1] == log[-100][1]
    bench.write(0, i_q=amps(1.0))
    assert bench.follow(50)[-1][1] == log[-1][1]


def test_a_sensorless_axis_does_not_enter_test_mode(core: Core) -> None:
    bench = Bench(core)
    bench.write_raw("param.feedback", [1, 0])
    bench.to_stop()
    bench.write(0, mode=4, enable=1)
    bench.slow(300)
    assert bench.view(0).substate == SUBSTATE.READY


def test_an_axis_with_a_holding_brake_does_not_enter_test_mode(core: Core) -> None:
    """A vector at a wrong angle would not hold the load of the brake."""
    bench = Bench(core)
    bench.configure_pins(INPUTS.BRAKE_OPEN, open_ticks=50, close_ticks=20)
    bench.to_stop()
    bench.write(0, mode=4, enable=1)
    bench.slow(100)
    assert bench.view(0).state == STATE.STOP
    assert not bench.view(0).inputs & INPUTS.BRAKE_OPEN
    assert not bench.axis(0).enable_requested


# ---- test signals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [TEST_POINT.I_D, TEST_POINT.I_Q])
def test_a_fast_signal_lasts_its_periods_and_does_not_change_the_set_point(testing: Bench, at: int) -> None:
    testing.write(0, i_q=amps(1.0))
    testing.slow(100)
    start_signal(testing, at, calls=100)
    testing.slow(2)
    assert point(testing) == at
    seen = set()
    for _ in range(12):
        testing.slow()
        seen.add(testing.axis(0).test_signal.value)
        assert current(testing) == pytest.approx(1.0, abs=0.001)
        assert testing.axis(0).current_ref.q == 0
    assert len(seen) > 8
    testing.slow(3)
    assert point(testing) == TEST_POINT.NONE
    assert testing.axis(0).test_signal.value == 0
    assert testing.axis(0).fast == testing.core.lib.LOOP_FAST


def test_a_signal_on_the_torque_is_in_the_current_set_point(bench: Bench) -> None:
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.slow(4)
    start_signal(bench, TEST_POINT.TORQUE, calls=50)
    bench.slow(2)
    for _ in range(40):
        bench.slow()
        assert bench.view(0).i_q_ref == bench.axis(0).test_signal.value
    bench.slow(20)
    assert (point(bench), bench.view(0).i_q_ref) == (TEST_POINT.NONE, 0)


def test_a_signal_on_the_speed_is_in_the_speed_set_point(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.slow(4)
    start_signal(bench, TEST_POINT.SPEED, amplitude=0.01, calls=50)
    bench.slow(2)
    for _ in range(40):
        bench.slow()
        assert bench.view(0).speed_ref == bench.axis(0).test_signal.value * 65536
    bench.slow(20)
    assert (point(bench), bench.view(0).speed_ref) == (TEST_POINT.NONE, 0)


def test_a_signal_on_the_speed_keeps_speed_and_soft_limits(bench: Bench) -> None:
    bench.set_parameter("speed_limit", 20.0)
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.slow(4)
    start_signal(bench, TEST_POINT.SPEED, amplitude=0.2, step=0.002, calls=5000)
    bench.slow(2)
    peaks = bench.trace(400, lambda: rad_s(bench.view(0).speed_ref), follow=False)
    assert max(peaks) == pytest.approx(20.0, abs=0.01)
    assert min(peaks) == pytest.approx(-20.0, abs=0.01)
    bench.set_parameter("position_max", -0.5)  # behind the shaft: no motion towards it
    bench.switch_on(0, FEATURES.POSITION_LIMITS)
    bench.slow(4)
    peaks.clear()
    for _ in range(600):
        bench.slow()
        peaks.append(rad_s(bench.view(0).speed_ref))
    assert max(peaks) <= 0.0
    assert bench.view(0).limits & LIMITS.POSITION or rad_s(bench.view(0).speed_ref) < 0.0


def test_a_signal_ends_when_its_set_point_expires(bench: Bench) -> None:
    bench.set_parameter("command_timeout", 0.05)
    bench.write(0, mode=MODE.SPEED, speed=speed(5.0))
    bench.follow(10)
    start_signal(bench, TEST_POINT.TORQUE, calls=100_000)
    bench.follow(20)
    assert point(bench) == TEST_POINT.TORQUE
    bench.follow(100)
    assert bench.view(0).limits & LIMITS.EXPIRED
    assert point(bench) == TEST_POINT.NONE


def test_no_signal_begins_at_an_active_limit_switch(bench: Bench) -> None:
    bench.configure_pins(INPUTS.LIMIT_MIN)
    bench.hal.axis[0].inputs = INPUTS.LIMIT_MIN
    bench.slow(5)
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    start_signal(bench, TEST_POINT.TORQUE)
    bench.slow(3)
    assert point(bench) == TEST_POINT.NONE


def test_slow_points_need_a_controlled_speed(testing: Bench) -> None:
    for at in (TEST_POINT.TORQUE, TEST_POINT.SPEED):
        start_signal(testing, at)
        testing.slow(3)
        assert point(testing) == TEST_POINT.NONE


@pytest.mark.parametrize("end", [{"enable": 0}, {"quick_stop": 1}, {"test_point": TEST_POINT.NONE}])
def test_a_signal_ends_with_disable_quick_stop_or_its_command(bench: Bench, end: dict[str, int]) -> None:
    bench.write(0, mode=MODE.SPEED, speed=0)
    start_signal(bench, TEST_POINT.SPEED, amplitude=0.001, calls=100_000)
    bench.slow(20)
    assert point(bench) == TEST_POINT.SPEED
    bench.write(0, **end)
    bench.slow(2)
    assert point(bench) == TEST_POINT.NONE
    assert bench.axis(0).motion.speed_test_signal == 0


def test_a_fault_ends_a_signal(bench: Bench) -> None:
    start_signal(bench, TEST_POINT.I_Q, calls=100_000)
    bench.slow(5)
    assert point(bench) == TEST_POINT.I_Q
    bench.hal.bus_code = bus_code(34.0)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 20)
    bench.slow()
    assert point(bench) == TEST_POINT.NONE


def test_a_signal_requested_with_outputs_off_is_discarded(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    start_signal(bench, TEST_POINT.I_Q, calls=100_000)
    bench.slow(5)
    bench.to_spin(0)
    bench.slow(5)
    assert point(bench) == TEST_POINT.NONE
