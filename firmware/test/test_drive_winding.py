"""A hot winding holds its axis back, and stops it only when that does not help."""

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
    """The estimate from now on, and a step of the model with it."""
    bench.axis(axis).diagnosis.winding.temperature = round(celsius / 256.0 * 2**31)
    bench.slow(STEP)


def celsius(bench: Bench, axis: int = 0) -> float:
    return float(bench.view(axis).winding_temperature) / 2**15 * 256.0


def asked(bench: Bench, axis: int = 0) -> float:
    """Set-point of the current [A]."""
    return float(bench.view(axis).i_q_ref) / 2**15 * 8.25


def place(bench: Bench) -> tuple[int, int, int]:
    return bench.view(0).state, bench.view(0).substate, bench.view(0).faults


def limits(bench: Bench) -> int:
    """But for the voltage: no current flows on this board."""
    return int(bench.view(0).limits & ~LIMITS.VOLTAGE)


def hot(bench: Bench, *, features: int = 0) -> None:
    """Spinning, at `HALF`."""
    bench.switch_on(0, FEATURES.WINDING_MODEL | features)
    bench.to_spin(0)
    warm(bench, HALF)


def test_without_the_feature_no_current_is_reduced(bench: Bench) -> None:
    bench.to_spin(0)
    warm(bench, 200.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(2)
    assert celsius(bench) == pytest.approx(200.0, abs=0.1), "the estimate is there"
    assert asked(bench) == pytest.approx(4.0, abs=1e-3)
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)
    assert limits(bench) == 0


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_torque_is_derated_and_says_so(bench: Bench, sign: int) -> None:
    hot(bench)
    bench.write(0, mode=MODE.TORQUE, i_q=sign * amps(4.0))
    bench.slow(2)
    assert asked(bench) == pytest.approx(sign * 3.0, abs=0.01)
    assert limits(bench) == BOTH
    bench.write(0, mode=MODE.TORQUE, i_q=sign * amps(2.5))
    bench.slow(2)
    assert asked(bench) == pytest.approx(sign * 2.5, abs=1e-3)
    assert limits(bench) == 0
    assert bench.servo.parameter.i_q_limit[0] == bench.axis(0).config.i_q_limit, "what a host has written stands"


def test_a_tighter_limit_of_the_host_is_no_matter_of_temperature(bench: Bench) -> None:
    hot(bench)
    bench.set_parameter("i_q_limit", 1.5)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(2)
    assert asked(bench) == pytest.approx(1.5, abs=1e-3)
    assert limits(bench) == LIMITS.CURRENT


def test_no_vector_is_longer_than_the_winding_bears(bench: Bench) -> None:
    """Braking current folds back into i_d, which comes first."""
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


# ---- a shaft that is held back is none that stands, runs away or strays
def test_a_shaft_that_stands_at_less_than_the_full_current_is_no_stall(bench: Bench) -> None:
    hot(bench)
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    for _ in range(3000):  # three times the time of a stall
        bench.slow()
        assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)
    assert asked(bench) == pytest.approx(3.0, abs=0.02)
    assert limits(bench) == BOTH
    warm(bench, 60.0)
    bench.until(lambda: place(bench)[1] == SUBSTATE.ALIGN, 1200)  # the test of a stall, at full current


def test_a_reduced_current_is_no_runaway(bench: Bench) -> None:
    hot(bench)
    bench.write(0, mode=MODE.SPEED, speed=speed(-200.0))
    bench.slow(60)
    for k in range(100):
        bench.turn(0, 2.0 * k)  # the load is stronger
        bench.slow()
    assert limits(bench) == BOTH
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)


def test_a_reduced_current_is_no_following_error(bench: Bench) -> None:
    hot(bench, features=FEATURES.FOLLOWING_ERROR)
    bench.write(0, mode=MODE.POSITION, position=bench.view(0).position + 100_000)
    bench.slow(300)
    assert bench.view(0).limits & LIMITS.TEMPERATURE
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)


# ---- the feature is switched off, the limit changes
def test_a_limit_that_ends_waits_for_the_next_set_point(bench: Bench) -> None:
    hot(bench)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(4.0))
    bench.slow(2)
    bench.switch_on(0, 0)
    bench.slow(200)
    assert asked(bench) == pytest.approx(3.0, abs=0.01)
    bench.write(0, i_q=amps(4.0))
    bench.slow(3)
    assert asked(bench) == pytest.approx(4.0, abs=1e-3)


def test_it_ends_with_the_drive(bench: Bench) -> None:
    hot(bench)
    bench.switch_on(0, 0)
    bench.slow(2)
    assert bench.axis(0).current_max.q < amps(3.1)
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 2000)
    bench.slow(2)
    assert bench.axis(0).current_max.q == bench.axis(0).limits.i_q


# ---- the fault
def test_what_goes_beyond_stops_its_axis_until_it_has_cooled(bench: Bench) -> None:
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


def test_the_fault_can_be_switched_off_like_others(bench: Bench) -> None:
    bench.switch_on(0, FEATURES.WINDING_MODEL)
    bench.servo.parameter.faults_enabled[0] &= ~FAULTS.MOTOR_TEMPERATURE
    bench.to_spin(0)
    warm(bench, 150.0)
    bench.slow(2)
    assert place(bench) == (STATE.RUN, SUBSTATE.SPIN, 0)
    assert bench.axis(0).current_max.q == amps(2.0), "the limit stays"


def test_the_temperature_outlives_fault_and_disable(bench: Bench) -> None:
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
    assert before - 0.3 < celsius(bench) < before, "it cools meanwhile"


def test_currents_warm_it_up_in_every_state(bench: Bench) -> None:
    """A rotor search at full current, for one."""
    bench.to_stop()
    before = celsius(bench)
    assert before == pytest.approx(100.0, abs=0.01), "what a reset has forgotten"
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    assert celsius(bench) > celsius(bench, 1) + 0.02
