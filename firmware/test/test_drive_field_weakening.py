"""Conditions of field weakening, and its end.

No current flows on this board: a shaft that is rotated fast needs the full voltage at once.
"""

from __future__ import annotations

import itertools

import pytest
from core_library import Core
from servo_bench import FAULTS, FEATURES, LIMITS, MODE, STATE, SUBSTATE, Bench, amps, bus_code, speed

FAST = 415.0
"""Speed at which the back-EMF alone exceeds the voltage limit at 20 V [rad/s]."""

MOST = amps(3.0)


@pytest.fixture
def bench(core: Core) -> Bench:
    return Bench(core)


def weakened(bench: Bench, features: int = FEATURES.FIELD_WEAKENING) -> None:
    """Axis 1 in SPIN, rotated fast at a low bus voltage."""
    bench.to_spin(0)
    bench.switch_on(0, features)
    bench.set_parameter("speed_limit", 418.0)
    bench.hal.bus_code = bus_code(20.0)
    bench.slow(50)
    bench.turn_without_current(0, FAST)
    bench.slow(60)


def i_d_ref(bench: Bench) -> int:
    return int(bench.axis(0).current_ref.d)


def test_field_weakening_acts_and_is_reported(bench: Bench) -> None:
    weakened(bench)
    assert i_d_ref(bench) == -MOST
    assert bench.view(0).limits & LIMITS.FIELD_WEAKENING
    assert not bench.view(1).limits & LIMITS.FIELD_WEAKENING


def test_no_field_weakening_without_the_feature(bench: Bench) -> None:
    weakened(bench, features=0)
    assert i_d_ref(bench) == 0
    assert not bench.view(0).limits & LIMITS.FIELD_WEAKENING
    assert bytes(bench.core.ffi.buffer(bench.core.ffi.addressof(bench.axis(0), "weakening"))).strip(b"\0") == b""


def test_motoring_current_is_reduced_and_braking_current_is_not(bench: Bench) -> None:
    """With 3 A of 4 A in i_d 2.6 A remain in i_q; no motoring current above the voltage limit."""
    weakened(bench)
    for commanded, maximum in ((4.0, 0.0), (-4.0, 2.645)):
        bench.write(0, mode=MODE.TORQUE, i_q=amps(commanded))
        bench.slow(5)
        assert abs(int(bench.axis(0).current_ref.q)) == pytest.approx(amps(maximum), abs=2)
        assert bench.axis(0).motion.current_reduced


def test_the_speed_controller_does_not_wind_up(bench: Bench) -> None:
    """The integrator stays at the remaining limit, zero, as long as the voltage is at its limit."""
    weakened(bench)
    bench.write(0, mode=MODE.SPEED, speed=speed(418.0))
    bench.slow(2000)
    assert bench.view(0).state != STATE.FAULT
    assert int(bench.axis(0).current_ref.q) == 0
    held = bench.axis(0).motion.speed_pi.integral / 2.0**24 / 2**31 * 8.25
    assert abs(held) < 0.5  # the proportional part of 3 rad/s, with the other sign


def test_current_is_restored_at_the_slew_rate_when_the_feature_is_disabled(bench: Bench) -> None:
    weakened(bench)
    before = i_d_ref(bench)
    bench.switch_on(0, 0)
    bench.slow(30)
    assert i_d_ref(bench) <= before < 0, "not restored at the voltage limit"
    i_d = []
    for _ in range(200):
        bench.turn(0, 50.0)  # slower: enough voltage
        bench.slow()
        i_d.append(i_d_ref(bench))
    steps = [after - before for before, after in itertools.pairwise(i_d)]
    assert i_d[-1] == 0
    assert 0 <= min(steps) <= max(steps) <= MOST // 8 + 1  # at the slew rate, not at once
    assert not bench.view(0).limits & LIMITS.FIELD_WEAKENING


def test_a_fault_ends_field_weakening_at_once(bench: Bench) -> None:
    weakened(bench)
    bench.hal.bus_code = bus_code(36.0)
    bench.until(lambda: bench.view(0).state == STATE.FAULT, 20)
    assert bench.view(0).faults & FAULTS.OVER_VOLTAGE
    assert not bench.hal.axis[0].outputs_on
    assert i_d_ref(bench) == 0
    assert int(bench.axis(0).weakening.d) == 0
    bench.slow()
    assert not bench.view(0).limits & LIMITS.FIELD_WEAKENING


def test_field_weakening_ends_when_the_outputs_go_off(bench: Bench) -> None:
    weakened(bench)
    bench.write_raw("param.on_disable", [0, 0])  # COAST
    bench.write(0, enable=0)
    bench.to_substate(0, SUBSTATE.FREEWHEEL, 10)
    assert i_d_ref(bench) == 0
    assert int(bench.axis(0).weakening.d) == 0


def test_a_reduced_limit_of_i_d_applies_at_once(bench: Bench) -> None:
    """The host reduces the limit of i_d while the shaft rotates."""
    weakened(bench)
    config = bench.core.ffi.cast("axis_config_t *", bench.axis(0).config)
    config.field_weakening.i_d_max = amps(1.0)
    bench.slow(2)
    assert i_d_ref(bench) == -amps(1.0)


def test_no_field_weakening_at_a_low_speed(bench: Bench) -> None:
    bench.to_spin(0)
    bench.switch_on(0, FEATURES.FIELD_WEAKENING)
    bench.turn_without_current(0, 20.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(3.0))
    bench.slow(100)
    assert bench.view(0).substate == SUBSTATE.SPIN
    assert i_d_ref(bench) == 0
