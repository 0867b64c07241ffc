"""Derating of the current of a hot winding, and its fault above the maximum temperature."""

from __future__ import annotations

import pytest
from core_library import Core
from servo_bench import FAULTS, FEATURES, LIMITS, MODE, STATE, SUBSTATE, Bench, amps, bus_code, speed

STEP = 64  # slow ticks of the model
HALF = 115.0  # deg C: the limit is half way between 4 A and 2 A
BOTH = LIMITS.CURRENT | LIMITS.TEMPERATURE


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def warm(bench: Bench, celsius: float, axis: int = 0) -> None:
    """Set the estimated temperature [deg C] and run a step of the model."""
    bench.axis(axis).diagnosis.winding.temperature = round(celsius / 256.0 * 2**31)
    bench.slow(STEP)


def celsius(bench: Bench, axis: int = 0) -> float:
    return float(bench.view(axis).winding_temperature) / 2**15 * 256.0


def i_q_set_point(bench: Bench, axis: int = 0) -> float:
    """Set-point of the current [A]."""
    return float(bench.view(axis).i_q_ref) / 2**15 * 8.25


def place(bench: Bench) -> tuple[int, int, int]:
    return bench.view(0).state, bench.view(0).substate, bench.view(0).faults


def limits(bench: Bench) -> int:
    """Limits without LIMIT_VOLTAGE: no current flows on this board."""
    return int(bench.view(0).limits & ~LIMITS.VOLTAGE)


def hot(bench: Bench, *, features: int = 0) -> None:
    """Axis in SPIN with the winding at `HALF`."""
    bench.switch_on(0, FEATURES.WINDING_MODEL | features)
    bench.to_spin(0)
    warm(bench, HALF)


def test_no_derating_without_the_feature(bench: Bench) -> None:
    bench.to_spin(0)
    warm(bench, 200.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(2)
    assert celsius(bench) == pytest.approx(200.0, abs=0.1), "the estimate is computed"
    assert i_q_set_point(bench) == pytest.approx(4.0, abs=1e-3)
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)
    assert limits(bench) == 0


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_torque_is_derated_and_flagged(bench: Bench, sign: int) -> None:
    hot(bench)
    bench.write(0, mode=MODE.TORQUE, i_q=sign * amps(4.0))
    bench.slow(2)
    assert i_q_set_point(bench) == pytest.approx(sign * 3.0, abs=0.01)
    assert limits(bench) == BOTH
    bench.write(0, mode=MODE.TORQUE, i_q=sign * amps(2.5))
    bench.slow(2)
    assert i_q_set_point(bench) == pytest.approx(sign * 2.5, abs=1e-3)
    assert limits(bench) == 0
    assert bench.servo.parameter.i_q_limit[0] == bench.axis(0).config.i_q_limit, (
        "the parameter of the host is unchanged"
    )


def test_a_lower_limit_of_the_host_is_not_flagged_as_derating(bench: Bench) -> None:
    hot(bench)
    bench.set_parameter("i_q_limit", 1.5)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(2)
    assert i_q_set_point(bench) == pytest.approx(1.5, abs=1e-3)
    assert limits(bench) == LIMITS.CURRENT


def test_no_current_vector_exceeds_the_derated_limit(bench: Bench) -> None:
    """Folded-back braking current is moved to i_d, which has priority."""
    hot(bench)
    warm(bench, 135.0)
    bench.hal.bus_code = bus_code(31.5)
    bench.write(0, mode=MODE.SPEED, speed=speed(-300.0))
    bench.turn(0, 300.0)
    for _ in range(50):
        bench.slow()
        d, q = bench.axis(0).current_ref.d, bench.axis(0).current_ref.q
        assert (d * d + q * q) ** 0.5 / 2**15 * 8.25 < 2.02
    assert bench.view(0).limits & LIMITS.REGENERATION


# ---- a derated axis: no stall, runaway or following error
def test_standstill_at_a_derated_current_is_no_stall(bench: Bench) -> None:
    hot(bench)
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    for _ in range(3000):  # three times the stall time
        bench.slow()
        assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)
    assert i_q_set_point(bench) == pytest.approx(3.0, abs=0.02)
    assert limits(bench) == BOTH
    warm(bench, 60.0)
    bench.until(lambda: place(bench)[1] == SUBSTATE.ALIGN, 1200)  # the stall test, at full current


def test_a_derated_current_causes_no_runaway_fault(bench: Bench) -> None:
    hot(bench)
    bench.write(0, mode=MODE.SPEED, speed=speed(-200.0))
    bench.slow(60)
    for k in range(100):
        bench.turn(0, 2.0 * k)  # the load is stronger
        bench.slow()
    assert limits(bench) == BOTH
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)


def test_a_derated_current_causes_no_following_error(bench: Bench) -> None:
    hot(bench, features=FEATURES.FOLLOWING_ERROR)
    bench.write(0, mode=MODE.POSITION, position=bench.view(0).position + 100_000)
    bench.slow(300)
    assert bench.view(0).limits & LIMITS.TEMPERATURE
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)


# ---- the feature is disabled, the limit changes
def test_the_end_of_derating_applies_with_the_next_set_point(bench: Bench) -> None:
    hot(bench)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(2)
    bench.switch_on(0, 0)
    bench.slow(200)
    assert i_q_set_point(bench) == pytest.approx(3.0, abs=0.01)
    bench.write(0, i_q=amps(4.0))
    bench.slow(3)
    assert i_q_set_point(bench) == pytest.approx(4.0, abs=1e-3)


def test_derating_ends_with_a_disable(bench: Bench) -> None:
    hot(bench)
    bench.switch_on(0, 0)
    bench.slow(2)
    assert bench.axis(0).current_max.q < amps(3.1)
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 2000)
    bench.slow(2)
    assert bench.axis(0).current_max.q == bench.axis(0).limits.i_q


# ---- the fault
def test_an_overheated_winding_stops_its_axis_until_it_has_cooled_down(bench: Bench) -> None:
    hot(bench)
    warm(bench, 140.5)
    bench.slow(2)
    assert place(bench)[0::2] == (STATE.FAULT, FAULTS.MOTOR_TEMPERATURE)
    assert not bench.hal.axis[0].outputs_on
    assert bench.view(1).faults == 0
    for temperature in (139.0, 130.5):
        warm(bench, temperature)
        bench.clear(0)
        assert place(bench)[0::2] == (STATE.FAULT, FAULTS.MOTOR_TEMPERATURE)
        assert bench.servo.record[0].pending == FAULTS.MOTOR_TEMPERATURE
    warm(bench, 129.5)
    bench.clear(0)
    assert place(bench)[0::2] == (STATE.INIT, 0)


def test_the_fault_of_the_winding_can_be_disabled(bench: Bench) -> None:
    bench.switch_on(0, FEATURES.WINDING_MODEL)
    bench.servo.parameter.faults_enabled[0] &= ~FAULTS.MOTOR_TEMPERATURE
    bench.to_spin(0)
    warm(bench, 150.0)
    bench.slow(2)
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)
    assert bench.axis(0).current_max.q == amps(2.0), "still derated"


def test_the_temperature_is_kept_through_fault_and_disable(bench: Bench) -> None:
    hot(bench)
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 2000)
    before = celsius(bench)
    assert HALF - 0.2 < before < HALF
    bench.hal.bus_code = bus_code(35.0)
    bench.slow(20)
    assert bench.view(0).state == STATE.FAULT
    bench.hal.bus_code = bus_code(24.0)
    bench.slow(1000)
    bench.clear(0)
    bench.slow(STEP)
    assert before - 0.3 < celsius(bench) < before, "it cools down"


def test_current_of_the_rotor_search_heats_the_winding(bench: Bench) -> None:
    bench.to_stop()
    before = celsius(bench)
    assert before == pytest.approx(100.0, abs=0.01), "start value after a reset"
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    assert celsius(bench) > celsius(bench, 1) + 0.02
