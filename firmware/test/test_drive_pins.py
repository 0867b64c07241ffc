"""Switches, enable input and holding brake of an axis, on the fake board."""

from __future__ import annotations

from typing import Any

import pytest
from core_library import Core
from servo_bench import (
    FAULTS,
    INPUTS,
    LIMITS,
    MODE,
    STATE,
    STOP_CATEGORY,
    SUBSTATE,
    Bench,
    amps,
    bus_code,
    rad_s,
    speed,
)

OPEN, CLOSE = 12, 9  # slow ticks


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def configure_pins(bench: Bench, *pins: int, axis: int = 0) -> Any:
    """Wire pins of an axis; returns its configuration."""
    return bench.configure_pins(sum(pins), axis, open_ticks=OPEN, close_ticks=CLOSE)


def spin(bench: Bench) -> None:
    """Enable axis 1 without a rotor search, until SPIN and an open brake."""
    bench.to_stop()
    bench.axis(0).aligned = True
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    bench.slow(OPEN + 3)


def begin_opening(bench: Bench) -> None:
    """Enable axis 1, with a known rotor angle, until its brake coil is energised."""
    configure_pins(bench, INPUTS.BRAKE_OPEN)
    bench.to_stop()
    bench.axis(0).aligned = True
    bench.write(0, enable=1)
    bench.until(lambda: bench.hal.axis[0].holding_released, 100)


class TestSwitches:
    def test_inputs_not_configured_are_not_read(self, bench: Bench) -> None:
        bench.hal.axis[0].inputs = INPUTS.HOME | INPUTS.LIMIT_MIN | INPUTS.LIMIT_MAX
        bench.to_spin(0)
        assert (bench.view(0).inputs, bench.view(0).limits, bench.view(0).faults) == (0, 0, 0)
        assert not bench.hal.axis[0].enable_used

    def test_a_level_is_accepted_in_its_second_tick(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.HOME)
        bench.hal.axis[0].inputs = INPUTS.HOME
        bench.slow()
        bench.hal.axis[0].inputs = 0
        bench.slow(3)
        assert bench.view(0).inputs == 0
        bench.hal.axis[0].inputs = INPUTS.HOME
        bench.slow(3)
        assert bench.view(0).inputs == INPUTS.HOME
        assert bench.view(1).inputs == 0

    @pytest.mark.parametrize(("switch", "direction"), [(INPUTS.LIMIT_MAX, 1), (INPUTS.LIMIT_MIN, -1)])
    def test_a_limit_switch_ahead_stops_the_motion_with_a_ramp(self, bench: Bench, switch: int, direction: int) -> None:
        configure_pins(bench, INPUTS.LIMIT_MIN, INPUTS.LIMIT_MAX)
        spin(bench)
        bench.write(0, mode=MODE.SPEED, speed=speed(100.0 * direction))
        bench.follow(200)
        bench.hal.axis[0].inputs = switch
        log = bench.follow(3)
        assert bench.view(0).faults == FAULTS.LIMIT_SWITCH
        assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)
        ramp = 100.0 / 4000.0 / 0.5e-3
        bench.follow(round(ramp) + 10)
        assert bench.view(0).state == STATE.FAULT
        assert not bench.hal.axis[0].outputs_on
        assert len(log) == 3

    @pytest.mark.parametrize("mode", [MODE.POSITION, MODE.SPEED, MODE.TORQUE])
    def test_only_motion_away_from_an_active_switch_is_permitted(self, bench: Bench, mode: int) -> None:
        configure_pins(bench, INPUTS.LIMIT_MIN, INPUTS.LIMIT_MAX)
        bench.hal.axis[0].inputs = INPUTS.LIMIT_MAX
        spin(bench)
        assert (bench.view(0).faults, bench.view(0).limits) == (0, LIMITS.INPUT)
        start = bench.view(0).position

        def push(direction: int) -> Any:
            if mode == MODE.POSITION:
                bench.write(0, mode=mode, position=start + direction * 400)
            elif mode == MODE.SPEED:
                bench.write(0, mode=mode, speed=speed(20.0 * direction))
            else:
                bench.write(0, mode=mode, i_q=amps(0.5 * direction))
            bench.slow(40)
            return bench.view(0).i_q_ref if mode == MODE.TORQUE else bench.view(0).speed_ref

        assert abs(push(1)) <= (0 if mode == MODE.TORQUE else speed(1.0))
        assert bench.view(0).limits & (LIMITS.INPUT | LIMITS.POSITION) == LIMITS.INPUT | LIMITS.POSITION
        assert push(-1) < 0

    def test_a_switch_behind_the_shaft_is_a_fault_unless_it_bounces(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.LIMIT_MIN, INPUTS.LIMIT_MAX)
        bench.hal.axis[0].inputs = INPUTS.LIMIT_MAX
        spin(bench)
        bench.write(0, mode=MODE.SPEED, speed=speed(-30.0))
        bench.follow(50)
        for inputs in (0, INPUTS.LIMIT_MAX, 0):  # moving away from the switch
            bench.hal.axis[0].inputs = inputs
            bench.follow(5)
        assert bench.view(0).faults == 0
        bench.follow(150)
        bench.hal.axis[0].inputs = INPUTS.LIMIT_MAX  # not reachable in this direction
        bench.follow(4)
        assert bench.view(0).faults == FAULTS.LIMIT_SWITCH

    def test_both_limit_switches_active_refuse_an_enable(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.LIMIT_MIN, INPUTS.LIMIT_MAX)
        bench.hal.axis[0].inputs = INPUTS.LIMIT_MIN | INPUTS.LIMIT_MAX
        bench.slow(3)
        bench.to_stop()
        bench.write(0, enable=1)
        bench.slow(20)
        assert (bench.view(0).state, bench.view(0).limits) == (STATE.STOP, LIMITS.INPUT)

    def test_both_limit_switches_at_once_are_a_fault_at_rest(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.LIMIT_MIN, INPUTS.LIMIT_MAX)
        spin(bench)
        bench.hal.axis[0].inputs = INPUTS.LIMIT_MIN | INPUTS.LIMIT_MAX
        bench.slow(4)
        assert bench.view(0).faults == FAULTS.LIMIT_SWITCH

    def test_a_limit_switch_with_a_disabled_fault_still_stops_the_motion(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.LIMIT_MIN, INPUTS.LIMIT_MAX)
        bench.servo.parameter.faults_enabled[0] &= ~FAULTS.LIMIT_SWITCH
        spin(bench)
        bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
        bench.follow(100)
        bench.hal.axis[0].inputs = INPUTS.LIMIT_MAX
        bench.follow(60)
        assert (bench.view(0).faults, bench.view(0).state) == (0, STATE.RUN)
        assert abs(rad_s(bench.view(0).speed_ref)) < 1.0


class TestEnableInput:
    def test_open_input_at_rest_refuses_an_enable_without_a_fault(self, bench: Bench) -> None:
        bench.hal.axis[0].inputs = 0
        configure_pins(bench, INPUTS.ENABLE)
        bench.to_stop()
        bench.write(0, enable=1)
        bench.slow(20)
        assert bench.states()[0][:1] == (STATE.STOP,)
        assert (bench.view(0).faults, bench.view(0).limits) == (0, LIMITS.INPUT)
        assert bench.hal.axis[0].enable_used  # enabled again, so that a closed input is effective

        bench.hal.axis[0].inputs = INPUTS.ENABLE
        bench.slow(4)
        assert (bench.view(0).state, bench.view(0).limits) == (STATE.STOP, 0)  # and no automatic enable
        bench.write(0, enable=1)
        bench.slow(2)
        assert bench.view(0).state == STATE.RUN

    def test_input_opened_in_run_is_a_fault_within_a_tick(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.ENABLE)
        spin(bench)
        bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
        bench.follow(100)
        bench.hal.axis[0].inputs = 0
        bench.slow()
        assert bench.view(0).state == STATE.FAULT or bench.axis(0).sm.state == STATE.FAULT
        assert not bench.hal.axis[0].outputs_on
        bench.slow()
        assert bench.view(0).faults == FAULTS.ENABLE_INPUT
        bench.turn(0, 0.0)
        bench.clear(0)
        bench.to_stop()
        assert bench.view(0).faults == 0  # an open input at rest is no fault

    def test_fault_of_the_enable_input_cannot_be_disabled(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.ENABLE)
        bench.servo.parameter.faults_enabled[0] = 0
        spin(bench)
        bench.hal.axis[0].inputs = 0
        bench.slow(2)
        assert bench.view(0).faults == FAULTS.ENABLE_INPUT


class TestHoldingBrake:
    def test_brake_is_closed_until_the_position_is_controlled(self, bench: Bench) -> None:
        begin_opening(bench)
        assert (bench.axis(0).sm.state, bench.axis(0).substate) == (STATE.RUN, SUBSTATE.SPIN)
        assert bench.hal.axis[0].outputs_on
        assert bench.view(0).inputs == 0
        assert not bench.hal.axis[1].holding_released
        bench.slow(OPEN + 2)
        assert bench.view(0).inputs == INPUTS.BRAKE_OPEN

    def test_set_points_wait_for_the_brake(self, bench: Bench) -> None:
        begin_opening(bench)
        start = bench.view(0).position
        bench.write(0, mode=MODE.POSITION, position=start + 4000)
        while bench.view(0).inputs != INPUTS.BRAKE_OPEN:
            bench.slow()
            assert bench.view(0).position_ref == start
        bench.slow(30)
        assert bench.view(0).position_ref > start

    @pytest.mark.parametrize("again", [{"enable": 1}, {"quick_stop": 0}], ids=str)
    def test_set_points_wait_for_the_brake_in_spite_of_repeated_commands(
        self, bench: Bench, again: dict[str, int]
    ) -> None:
        begin_opening(bench)
        start = bench.view(0).position
        bench.write(0, mode=MODE.POSITION, position=start + 4000)
        bench.slow(2)
        bench.write(0, **again)
        while bench.view(0).inputs != INPUTS.BRAKE_OPEN:
            bench.slow()
            assert bench.view(0).position_ref == start
        bench.slow(30)
        assert bench.view(0).position_ref > start

    @pytest.mark.parametrize("stop", ["enable", "quick_stop", "fault"])
    def test_a_stop_discards_a_waiting_set_point(self, bench: Bench, stop: str) -> None:
        begin_opening(bench)
        start = bench.view(0).position
        bench.write(0, mode=MODE.POSITION, position=start + 4000)
        bench.slow(2)
        if stop == "fault":
            bench.hal.bus_code = bus_code(36.0)
            bench.slow(30)
            bench.hal.bus_code = bus_code(24.0)
            bench.slow(60)
            bench.clear(0)
        else:
            bench.write(0, **{stop: int(stop == "quick_stop")})
            bench.slow(OPEN + CLOSE + 30)
        bench.axis(0).aligned = True
        bench.until(lambda: stop == "quick_stop" or bench.view(0).state == STATE.STOP, 200)
        bench.write(0, enable=1)
        bench.to_substate(0, SUBSTATE.SPIN)
        bench.slow(OPEN + 60)
        assert (bench.view(0).inputs, bench.view(0).position_ref) == (INPUTS.BRAKE_OPEN, start)

    @pytest.mark.parametrize("category", [STOP_CATEGORY.RAMP, STOP_CATEGORY.HOLD])
    def test_position_is_held_after_a_stop_until_the_brake_is_closed(self, bench: Bench, category: int) -> None:
        config = configure_pins(bench, INPUTS.BRAKE_OPEN)
        config.stop.hold_ticks = 50
        bench.servo.parameter.on_disable[0] = category
        spin(bench)
        bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
        bench.follow(100)
        bench.write(0, enable=0)
        ticks = 0
        while bench.hal.axis[0].holding_released:
            bench.follow(1)
            ticks += 1
            assert ticks < 300
        assert abs(rad_s(bench.view(0).speed)) < 3.0
        assert (bench.axis(0).substate, bench.hal.axis[0].outputs_on) == (SUBSTATE.SPIN, True)
        assert ticks >= (50 if category == STOP_CATEGORY.HOLD else 0)
        held = 0
        while bench.hal.axis[0].outputs_on:
            bench.follow(1)
            held += 1
            assert held < 100
        assert CLOSE <= held <= CLOSE + 2

    def test_brake_opens_again_after_a_new_enable(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.BRAKE_OPEN)
        spin(bench)
        bench.write(0, enable=0)
        bench.until(lambda: not bench.hal.axis[0].holding_released, 100)
        bench.write(0, enable=1)
        bench.slow(OPEN + 5)
        assert (bench.view(0).substate, bench.view(0).inputs) == (SUBSTATE.SPIN, INPUTS.BRAKE_OPEN)

    def test_brake_closes_at_once_when_the_outputs_go_off_at_once(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.BRAKE_OPEN)
        spin(bench)
        bench.hal.bus_code = bus_code(36.0)
        bench.slow(20)
        assert bench.view(0).state == STATE.FAULT
        assert not bench.hal.axis[0].holding_released
        assert bench.view(0).inputs == 0

    def test_invalid_angle_repeats_the_search(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.BRAKE_OPEN)
        spin(bench)
        bench.hal.axis[0].over_current = True
        bench.slow(2)
        bench.hal.axis[0].over_current = False
        bench.clear(0)
        bench.to_stop()
        bench.write(0, enable=1)
        bench.to_substate(0, SUBSTATE.ALIGN)
        assert not bench.hal.axis[0].holding_released  # the current is ramped up first
        search, limit = bench.axis(0).search, bench.axis(0).config.rotor_search.current_limit << 16
        bench.motor_plugged[0] = False
        while not bench.hal.axis[0].holding_released:
            search.low_current_periods = 0  # no current flows on this board
            bench.slow()
            assert search.current == limit or not bench.hal.axis[0].holding_released

    def test_the_load_current_is_adopted_without_a_step(self, bench: Bench) -> None:
        configure_pins(bench, INPUTS.BRAKE_OPEN)
        bench.to_stop()
        bench.axis(0).aligned, bench.axis(0).brake.load = True, amps(0.8)
        bench.write(0, enable=1)
        bench.until(lambda: bench.hal.axis[0].holding_released, 100)
        bench.slow()
        assert abs(bench.view(0).i_q_ref - amps(0.8)) < amps(0.02)

    def test_an_axis_without_a_brake_does_not_wait(self, bench: Bench) -> None:
        bench.to_spin(0)
        assert not bench.hal.axis[0].holding_released
        bench.write(0, mode=MODE.POSITION, position=bench.view(0).position + 4000)
        bench.slow(20)
        assert bench.view(0).position_ref > 0
