"""Stops of an axis: the categories, on commands and on faults, and their escalation."""

from __future__ import annotations

import math
from typing import Any

import pytest
from core_library import Core
from servo_bench import FAULTS, MODE, STATE, STOP_CATEGORY, SUBSTATE, Bench, amps, bus_code, speed

HALF = 16384
REFUSED = 1451 * math.pi / 30  # of axis 1 [rad/s]


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


@pytest.fixture
def turning(bench: Bench) -> Bench:
    """Both axes follow a speed of 100 rad/s."""
    bench.to_spin(0, 1)
    for axis in range(2):
        bench.write(axis, mode=MODE.SPEED, speed=speed(100.0))
        bench.turn(axis, 100.0)
    bench.slow(100)
    return bench


def configure(bench: Bench, **masks: int) -> Any:
    """Change the stop categories of faults of axis 1."""
    config = bench.core.ffi.new("axis_config_t *", bench.axis(0).config[0])
    for name, value in masks.items():
        setattr(config.stop, name, value)
    bench.references.append(config)
    bench.axis(0).config = config
    return config


def place(bench: Bench, axis: int = 0) -> tuple[int, int]:
    return bench.view(axis).state, bench.view(axis).substate


def outputs(bench: Bench) -> tuple[bool, list[int]]:
    return bool(bench.hal.axis[0].outputs_on), list(bench.hal.axis[0].duty)


def withdraw(bench: Bench, category: int, command: str = "disable") -> None:
    bench.write_raw(f"param.on_{command}", [category] * 2)
    bench.write(0, **({"enable": 0} if command == "disable" else {"quick_stop": 1}))
    bench.slow()


# ---- commands -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["disable", "quick_stop"])
def test_coast_opens_the_switches_at_once(turning: Bench, command: str) -> None:
    withdraw(turning, STOP_CATEGORY.COAST, command)
    assert place(turning) == (STATE.RUN, SUBSTATE.FREEWHEEL)
    assert not turning.hal.axis[0].outputs_on
    assert place(turning, 1) == (STATE.RUN, SUBSTATE.SPIN)


@pytest.mark.parametrize("command", ["disable", "quick_stop"])
def test_ramp_brakes_before_the_outputs_open(turning: Bench, command: str) -> None:
    withdraw(turning, STOP_CATEGORY.RAMP, command)
    assert place(turning) == (STATE.RUN, SUBSTATE.SPIN)
    turning.follow(60)
    turning.turn(0, 0.0)
    turning.until(lambda: place(turning)[1] == SUBSTATE.FREEWHEEL, 200)
    assert not turning.hal.axis[0].outputs_on


@pytest.mark.parametrize("command", ["disable", "quick_stop"])
def test_short_keeps_all_low_sides_on_until_the_shaft_rests(turning: Bench, command: str) -> None:
    """All low sides on, until the shaft rests."""
    withdraw(turning, STOP_CATEGORY.SHORT, command)
    assert place(turning) == (STATE.RUN, SUBSTATE.FREEWHEEL)
    assert outputs(turning) == (True, [0, 0, 0])
    turning.slow(50)
    assert outputs(turning)[0]
    turning.turn(0, 0.0)
    turning.until(lambda: not turning.hal.axis[0].outputs_on, 500)
    turning.until(lambda: place(turning) == (STATE.STOP, SUBSTATE.READY), 200)


@pytest.mark.parametrize(("part", "shorted"), [(0.97, True), (1.03, False), (-0.97, True), (-1.03, False)])
def test_a_short_is_refused_if_its_current_would_be_too_large(bench: Bench, part: float, shorted: bool) -> None:
    """K_e w / sqrt(R^2 + w^2 L^2) against 8.25 A; the next harsher category is to coast."""
    bench.to_spin(0)
    bench.turn_without_current(0, part * REFUSED)
    bench.slow(100)
    withdraw(bench, STOP_CATEGORY.SHORT)
    assert place(bench) == (STATE.RUN, SUBSTATE.FREEWHEEL)
    assert outputs(bench)[0] == shorted


def test_excessive_current_ends_the_short(turning: Bench) -> None:
    withdraw(turning, STOP_CATEGORY.SHORT)
    turning.hal.axis[0].current_code[0] = 4095
    turning.hal.axis[0].current_code[1] = 0
    turning.slow()
    assert outputs(turning) == (False, [HALF] * 3)
    assert place(turning) == (STATE.RUN, SUBSTATE.FREEWHEEL)


def test_hold_after_a_disable_ends_after_its_time(turning: Bench) -> None:
    withdraw(turning, STOP_CATEGORY.HOLD)
    turning.follow(60)
    turning.turn(0, 0.0)
    assert place(turning) == (STATE.RUN, SUBSTATE.SPIN)
    held = turning.until(lambda: place(turning)[1] == SUBSTATE.FREEWHEEL, 2500)
    assert held == pytest.approx(2000, abs=60)


def test_an_enable_during_a_winding_short_waits_for_standstill(turning: Bench) -> None:
    withdraw(turning, STOP_CATEGORY.SHORT)
    turning.write(0, enable=1)
    turning.slow(10)
    assert outputs(turning) == (True, [0, 0, 0])
    turning.turn(0, 0.0)
    turning.to_substate(0, SUBSTATE.SPIN)


# ---- faults ---------------------------------------------------------------------------------------------------------


def fail(bench: Bench, *findings: str) -> None:
    """Raise findings; FOLLOWING_ERROR by default."""
    lib = bench.core.lib
    found = sum(1 << int(getattr(lib, f"FINDING_{name}")) for name in findings or ("FOLLOWING_ERROR",))
    lib.axis_raise(bench.core.ffi.addressof(bench.axis(0)), found)
    bench.slow()


@pytest.mark.parametrize("category", ["ramp", "hold", "shorted"])
def test_a_fault_is_reported_at_once_and_enters_fault_after_the_stop(turning: Bench, category: str) -> None:
    config = configure(turning, **{category: FAULTS.FOLLOWING_ERROR})
    fail(turning)
    assert turning.view(0).faults == FAULTS.FOLLOWING_ERROR
    assert place(turning) == (STATE.RUN, SUBSTATE.FREEWHEEL if category == "shorted" else SUBSTATE.SPIN)
    assert turning.hal.axis[0].outputs_on
    turning.write(0, enable=1, clear_faults=1)
    turning.slow(5)
    assert turning.view(0).faults == FAULTS.FOLLOWING_ERROR, "a fault cannot be cleared before the end of the stop"
    if category != "shorted":
        turning.follow(60)
    turning.turn(0, 0.0)
    ticks = turning.until(lambda: turning.view(0).state == STATE.FAULT, 2500)
    assert not turning.hal.axis[0].outputs_on
    assert turning.view(0).faults == FAULTS.FOLLOWING_ERROR
    assert (ticks + 60 > config.stop.hold_ticks) == (category == "hold")
    assert place(turning, 1) == (STATE.RUN, SUBSTATE.SPIN)
    turning.clear(0)
    turning.slow(30)
    assert turning.view(0).state == STATE.STOP


def test_a_more_severe_fault_ends_the_ramp_at_once(turning: Bench) -> None:
    configure(turning, ramp=FAULTS.FOLLOWING_ERROR)
    fail(turning)
    assert place(turning) == (STATE.RUN, SUBSTATE.SPIN)
    turning.hal.axis[0].break_latched = True
    turning.slow()
    assert turning.view(0).state == STATE.FAULT
    assert turning.view(0).faults == FAULTS.FOLLOWING_ERROR | FAULTS.OVER_CURRENT
    assert not turning.hal.axis[0].outputs_on


def test_the_harsher_stop_of_two_simultaneous_faults_applies(turning: Bench) -> None:
    configure(turning, ramp=FAULTS.FOLLOWING_ERROR)
    fail(turning, "FOLLOWING_ERROR", "OVER_VOLTAGE")
    assert turning.view(0).state == STATE.FAULT


def test_a_fault_outside_of_spin_does_not_ramp(bench: Bench) -> None:
    configure(bench, ramp=FAULTS.FOLLOWING_ERROR)
    bench.to_stop()
    fail(bench)
    assert bench.view(0).state == STATE.FAULT


def test_a_fault_during_a_stop_changes_to_its_harsher_category(turning: Bench) -> None:
    configure(turning, shorted=FAULTS.FOLLOWING_ERROR)
    withdraw(turning, STOP_CATEGORY.RAMP)
    fail(turning)
    assert outputs(turning) == (True, [0, 0, 0])
    turning.turn(0, 0.0)
    turning.until(lambda: turning.view(0).state == STATE.FAULT, 500)


# ---- the bus --------------------------------------------------------------------------------------------------------


def q_limits(bench: Bench) -> tuple[float, float]:
    """Available current against the motion and with it, relative to the limit."""
    found = []
    for target in (0.0, 200.0):
        bench.write(0, speed=speed(target))
        bench.slow(200)
        found.append(bench.view(0).i_q_ref / amps(4.0))
    return found[0], found[1]


@pytest.mark.parametrize(("volts", "part"), [(24.0, 1.0), (29.0, 1.0), (30.5, 0.5), (32.0, 0.0)])
def test_braking_current_is_folded_back_by_the_bus(turning: Bench, volts: float, part: float) -> None:
    turning.hal.bus_code = bus_code(volts)
    turning.slow(50)
    against, along = q_limits(turning)
    assert against == pytest.approx(-part, abs=0.02)
    assert along == pytest.approx(1.0, abs=0.01)


def test_a_slow_shaft_is_braked_at_any_bus_voltage(turning: Bench) -> None:
    """Below 71 rad/s the winding losses at full current exceed the braking power."""
    turning.turn(0, 60.0)
    turning.hal.bus_code = bus_code(32.0)
    turning.slow(100)
    assert q_limits(turning)[0] == pytest.approx(-1.0, abs=0.01)


def test_folded_back_current_is_flagged_and_moved_to_i_d(turning: Bench) -> None:
    turning.hal.bus_code = bus_code(32.0)
    turning.slow(50)
    turning.write(0, speed=0)
    turning.slow(60)
    assert turning.view(0).limits & 0x20
    assert turning.axis(0).current_ref.d == pytest.approx(-amps(3.0), abs=2)
    turning.write(0, speed=speed(200.0))
    turning.slow(60)
    assert not turning.view(0).limits & 0x20
    assert turning.axis(0).current_ref.d == 0


def test_the_resistor_is_switched_and_raises_the_limit(turning: Bench) -> None:
    turning.write_raw("param.brake", [1])
    turning.hal.bus_code = bus_code(28.2)
    turning.slow(10)
    assert turning.hal.brake_resistor
    assert all(turning.view(axis).limits & 0x40 for axis in range(2))
    turning.hal.bus_code = bus_code(34.5)
    turning.slow(100)
    assert place(turning) == (STATE.RUN, SUBSTATE.SPIN), "no over-voltage while the resistor is available"
    turning.hal.bus_code = bus_code(36.0)
    turning.slow(20)
    assert turning.view(0).faults == FAULTS.OVER_VOLTAGE, "over-voltage at the end of the converter range"


def test_an_exhausted_resistor_enables_the_over_voltage_fault_again(turning: Bench) -> None:
    turning.write_raw("param.brake", [1])
    turning.hal.bus_code = bus_code(34.0)
    ticks = turning.until(lambda: turning.view(0).state == STATE.FAULT, 2000)
    assert ticks * 0.5e-3 == pytest.approx(60.0 / (34.0**2 / 4.7 - 10.0), rel=0.03)
    assert turning.view(0).faults == FAULTS.OVER_VOLTAGE
    assert not turning.hal.brake_resistor
