"""Field weakening in the tuning tool: integers, stability, remaining torque, refusals and warnings."""

from __future__ import annotations

import math
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_tuning.assessment import assess
from servo_tuning.errors import ConfigError
from servo_tuning.field_weakening import Loop, field_weakening_loops, largest_torque, top_speed
from servo_tuning.findings import findings
from servo_tuning.report import axis_reports, text
from tuning_tool import axis, configuration


class Motor(NamedTuple):
    """Motor of axis 1."""

    r_s: float = 0.55  # [ohm]
    l_d: float = 0.403e-3  # [H]
    l_q: float = 0.512e-3  # [H]
    psi_m: float = 0.0154  # flux linkage of the magnets [V s]
    pole_pairs: float = 2.0  # [1]


MOTOR = Motor()


@given(
    speed=st.floats(10.0, 500.0), volts=st.floats(5.0, 15.0), maximum=st.floats(0.0, 3.5), fraction=st.floats(0.0, 1.0)
)
def test_remaining_torque_is_within_voltage_and_current(
    speed: float, volts: float, maximum: float, fraction: float
) -> None:
    """No other current within the limits gives more torque, within the resolution of i_d."""
    best = largest_torque(MOTOR, 4.0, speed, volts, -maximum)
    omega, i_d = 2.0 * speed, -fraction * maximum
    assert -maximum <= best.i_d <= 0.0
    assert math.hypot(best.i_d, best.i_q) <= 4.0 + 1e-9
    if best.torque > 0.0:
        assert voltage(omega, best.i_d, best.i_q) <= volts + 1e-9
    q = [k * 0.02 for k in range(200) if math.hypot(i_d, k * 0.02) <= 4.0 and voltage(omega, i_d, k * 0.02) <= volts]
    tried = max((3.0 * i_q * (0.0154 - 0.109e-3 * i_d) for i_q in q), default=0.0)
    assert tried <= best.torque + 3e-3


def voltage(omega: float, i_d: float, i_q: float) -> float:
    return math.hypot(0.55 * i_d - omega * 0.512e-3 * i_q, 0.55 * i_q + omega * (0.0154 + 0.403e-3 * i_d))


def test_top_speed_without_torque_is_that_of_the_back_emf() -> None:
    assert top_speed(MOTOR, 4.0, 13.0, 0.0, lambda _: 0.0) == pytest.approx(13.0 / (2.0 * 0.0154), rel=2e-3)


@pytest.mark.parametrize("gain", [0.05, 0.126, 0.4, 0.9])
def test_margins_are_those_of_the_closed_loop(gain: float) -> None:
    """``z^2 - z + K`` leaves the unit circle at K = 1; the phase is that of the open loop at the crossover."""
    loop = Loop(gain, 0.5e-3)
    z = complex(math.cos(loop.turn), math.sin(loop.turn))
    open_loop = gain / (z * (z - 1.0))
    assert abs(open_loop) == pytest.approx(1.0)
    assert 180.0 + math.degrees(math.atan2(open_loop.imag, open_loop.real)) % -360.0 == pytest.approx(loop.phase)
    assert loop.stable
    assert not Loop(1.01, 0.5e-3).stable


@pytest.mark.parametrize("number", [1, 2])
def test_the_configured_loops_are_stable(number: int) -> None:
    it = axis(number, defaults__features__field_weakening=True)
    loops = field_weakening_loops(it.axis, it.board, it.block)
    assert loops["by i_d"].crossover == pytest.approx(40.0, rel=0.02)
    assert all(1.0 / loop.gain >= 2.0 and loop.phase >= 45.0 for loop in loops.values())
    assert not [line for line in map(str, findings(it, assess(it))) if "field_weakening" in line]


def test_a_too_fast_loop_causes_a_warning_if_enabled() -> None:
    for on in (True, False):
        it = axis(1, defaults__field_weakening__bandwidth=100.0, defaults__features__field_weakening=on)
        found = [line for line in map(str, findings(it, assess(it))) if "field_weakening.bandwidth" in line]
        assert bool(found) == on


def test_demagnetisation_limits_the_current() -> None:
    it = axis(1, defaults__field_weakening__magnet_current=1.5)
    assert it.block["field_weakening.i_d_max"] == round(1.5 / 8.25 * 2**15)


def test_a_speed_limit_beyond_the_voltage_needs_field_weakening() -> None:
    """A motor with more flux: 4000 rpm is above the no-load speed at 24 V, but reached with 3 A of i_d."""
    changes = {"axis1__motor__psi_m": 0.0159, "axis1__limits": {"speed": 415.0, "over_speed": 470.0}}
    with pytest.raises(ConfigError, match="switch field_weakening on"):
        axis(1, **changes)
    it = axis(1, **changes, defaults__features__field_weakening=True)
    assert it.axis("limits.speed") == 415.0


def test_report_contains_the_remaining_torque() -> None:
    page = text(axis_reports(configuration()))
    assert page.count("field weakening") >= 2
    assert "loop by i_d on the circle" in page
