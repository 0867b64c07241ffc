"""A sensorless axis on the fake board: start, waiting, and report of an impossible start."""

from __future__ import annotations

import math

import pytest
from core_library import Core
from servo_bench import FAULTS, LIMITS, MODE, STATE, SUBSTATE, Bench, amps, speed

OBSERVER, ENCODER = 1, 0
CATCH, TRACK, PROVE, RAMP = range(4)


@pytest.fixture
def bench(core: Core) -> Bench:
    """Axis 0 without an encoder, axis 1 with one; both in STOP."""
    b = Bench(core)
    b.write_raw("param.feedback", [OBSERVER, ENCODER])
    b.to_stop()
    b.slow()
    return b


def to_ready(b: Bench) -> None:
    b.write(0, mode=MODE.SPEED, enable=1)
    b.to_substate(0, SUBSTATE.READY)


def substate(b: Bench) -> tuple[int, int]:
    return b.view(0).state, b.view(0).substate


def test_feedback_changes_only_outside_run(bench: Bench) -> None:
    assert bench.axis(0).sensorless
    assert not bench.axis(1).sensorless
    to_ready(bench)
    bench.write_raw("param.feedback", [ENCODER, ENCODER])
    bench.slow(50)
    assert bench.axis(0).sensorless
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 20)
    bench.slow(2)
    assert not bench.axis(0).sensorless


def test_motor_unsuitable_for_the_observer_keeps_its_encoder(core: Core) -> None:
    b = Bench(core)
    config = core.ffi.new("axis_config_t *", b.axis(0).config[0])
    config.observer.drive = 0
    b.axis(0).config = config
    b.to_stop()
    b.axis(0).parameter.feedback = OBSERVER  # a host cannot: the write is refused (test_app_ranges.py)
    b.slow(2)
    assert not b.axis(0).sensorless


def test_sensorless_axis_waits_with_its_outputs_off(bench: Bench) -> None:
    """READY of an axis with an encoder shorts the windings; a sensorless shaft may rotate freely."""
    to_ready(bench)
    bench.slow(200)
    assert substate(bench) == (STATE.RUN, SUBSTATE.READY)
    assert not bench.hal.axis[0].outputs_on
    assert bench.view(0).limits & LIMITS.SENSORLESS == 0


@pytest.mark.parametrize("mode", [MODE.POSITION, MODE.TORQUE])
def test_impossible_sensorless_commands_cause_no_motion(bench: Bench, mode: int) -> None:
    bench.write(0, mode=mode, enable=1)
    bench.to_substate(0, SUBSTATE.READY)
    bench.write(0, position=1000, i_q=amps(1.0), speed=speed(100.0))
    bench.slow(50)
    assert substate(bench) == (STATE.RUN, SUBSTATE.READY)
    assert bench.view(0).limits & LIMITS.SENSORLESS
    assert not bench.hal.axis[0].outputs_on


def test_set_point_below_the_minimum_is_flagged(bench: Bench) -> None:
    to_ready(bench)
    bench.write(0, speed=speed(5.0))
    bench.slow(20)
    assert substate(bench) == (STATE.RUN, SUBSTATE.READY)
    assert bench.view(0).limits & LIMITS.SENSORLESS
    bench.write(0, speed=0)
    bench.slow(2)
    assert bench.view(0).limits & LIMITS.SENSORLESS == 0


def test_set_point_from_before_the_enable_is_ignored(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.slow(5)
    to_ready(bench)
    bench.slow(20)
    assert substate(bench) == (STATE.RUN, SUBSTATE.READY)


@pytest.mark.parametrize("direction", [1, -1])
def test_start_up_ramps_are_those_of_the_slide(bench: Bench, direction: int) -> None:
    """Without back-EMF: after CATCH the vector rotates in the commanded direction; current and speed ramp up."""
    config = bench.axis(0).config.startup
    to_ready(bench)
    bench.write(0, speed=speed(direction * 100.0))
    bench.to_substate(0, SUBSTATE.STARTUP, 3)
    startup = bench.axis(0).startup
    assert startup.phase == CATCH
    assert bench.hal.axis[0].outputs_on
    bench.until(lambda: startup.phase == RAMP, config.catch_ticks + 2)
    assert bench.axis(0).current_ref.d == 0
    bench.slow()
    assert bench.axis(0).current_ref.d == pytest.approx(config.first_current, abs=200)
    bench.slow(100)
    assert startup.speed == 101 * config.speed_step
    assert math.copysign(1, startup.step) == direction
    bench.slow(100)
    assert bench.axis(0).current_ref.d == pytest.approx(config.final_current, abs=1)
    bench.slow(400)
    assert startup.speed == config.final_speed
    assert bench.view(0).position != 0


def test_failed_start_up_is_a_fault(bench: Bench) -> None:
    """Without back-EMF the outputs go off after START_UP_DURATION, and the enable is withdrawn."""
    to_ready(bench)
    bench.write(0, speed=speed(100.0))
    bench.to_substate(0, SUBSTATE.STARTUP, 3)
    maximum = bench.axis(0).config.startup.duration_ticks + bench.axis(0).config.startup.catch_ticks
    ticks = bench.until(lambda: bench.view(0).state == STATE.FAULT, maximum + 20)
    assert bench.view(0).faults == FAULTS.START_UP
    assert ticks == pytest.approx(maximum, abs=4)
    assert not bench.hal.axis[0].outputs_on
    bench.slow(2)
    bench.clear(0)
    bench.slow(100)
    assert bench.view(0).state == STATE.STOP


@pytest.mark.parametrize("command", [{"enable": 0}, {"speed": 0}, {"mode": MODE.POSITION}, {"quick_stop": 1}])
def test_start_up_ends_when_the_command_is_withdrawn(bench: Bench, command: dict[str, int]) -> None:
    to_ready(bench)
    bench.write(0, speed=speed(100.0))
    bench.to_substate(0, SUBSTATE.STARTUP, 3)
    bench.slow(100)
    bench.write(0, **command)
    bench.until(lambda: substate(bench) != (STATE.RUN, SUBSTATE.STARTUP), 3)
    assert not bench.hal.axis[0].outputs_on
    bench.slow(5)
    assert substate(bench) in ((STATE.STOP, SUBSTATE.READY), (STATE.RUN, SUBSTATE.READY))
    assert SUBSTATE.FREEWHEEL != SUBSTATE.READY


def test_soft_limit_prevents_the_start_towards_it(bench: Bench) -> None:
    bench.write_raw("param.position_max", [0, 0])
    bench.switch_on(0, 1 << 7)
    to_ready(bench)
    bench.write(0, speed=speed(100.0))
    bench.slow(50)
    assert substate(bench) == (STATE.RUN, SUBSTATE.READY)
    bench.write(0, speed=speed(-100.0))
    bench.to_substate(0, SUBSTATE.STARTUP, 3)


def test_both_axes_start_at_once(core: Core) -> None:
    b = Bench(core)
    b.write_raw("param.feedback", [OBSERVER, OBSERVER])
    b.to_stop()
    for axis in (0, 1):
        b.write(axis, mode=MODE.SPEED, enable=1)
    b.to_substate(0, SUBSTATE.READY)
    b.to_substate(1, SUBSTATE.READY)
    b.write(0, speed=speed(100.0))
    b.write(1, speed=speed(-100.0))
    b.slow(60)
    assert [b.view(i).substate for i in (0, 1)] == [SUBSTATE.STARTUP, SUBSTATE.STARTUP]
    assert b.axis(0).startup.step > 0 > b.axis(1).startup.step


def test_pll_continues_at_its_speed_until_it_is_locked(bench: Bench) -> None:
    to_ready(bench)
    bench.write(0, speed=speed(100.0))
    bench.to_substate(0, SUBSTATE.STARTUP, 3)
    estimate = bench.axis(0).estimate
    assert not estimate.locked
    estimate.pll.step, before = 12_345, estimate.pll.angle
    bench.core.lib.probe_run(bench.servo, 1)
    assert (estimate.pll.angle - before) % 2**32 == 12_345


def test_missing_back_emf_in_spin_is_detected(bench: Bench) -> None:
    """Forced into SPIN without a back-EMF: the observed speed is not accepted."""
    to_ready(bench)
    bench.write(0, speed=speed(100.0))
    bench.to_substate(0, SUBSTATE.STARTUP, 3)
    bench.slow(100)
    axis = bench.axis(0)
    axis.estimate.pll.integral = axis.config.pll.step_per_speed // 5
    axis.estimate.speed = speed(100.0)
    axis.estimate.locked = True
    bench.core.lib.startup_hand_over(bench.core.ffi.addressof(axis))
    axis.substate, axis.fast = SUBSTATE.SPIN, 2
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 400)
    assert bench.view(0).faults == FAULTS.SPEED_FEEDBACK
