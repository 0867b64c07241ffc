"""Figures of moves for signals with a closed-form solution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from servo_measurement.step_response import measure_step, rms, settling_time

TIME = np.arange(0.0, 2.0, 0.001)
COUNT = 2.0 * math.pi / 4000


def test_first_order_approach_settles_without_overshoot() -> None:
    """1 - exp(-t/T) enters the band of one count after T ln(target/count) and never overshoots."""
    target, constant = 10.0, 0.1
    figures = measure_step(TIME, target * (1.0 - np.exp(-TIME / constant)), target, COUNT)
    assert figures.settling_time == pytest.approx(constant * math.log(target / COUNT), abs=0.0011)
    assert figures.overshoot == 0.0
    assert figures.arrived
    assert figures.reached == pytest.approx(target, abs=1e-6)
    assert figures.error == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_overshoot_of_a_damped_oscillation(direction: float) -> None:
    damping, omega = 0.5, 40.0
    damped = omega * math.sqrt(1.0 - damping**2)
    wave = np.exp(-damping * omega * TIME) * (np.cos(damped * TIME) + damping * omega / damped * np.sin(damped * TIME))
    figures = measure_step(TIME, direction * (1.0 - wave), direction, 1e-3)
    assert figures.overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)), rel=1e-3)
    assert figures.settling_time is not None
    assert 0.2 < figures.settling_time < 0.4


def test_move_that_stops_short_has_not_arrived() -> None:
    figures = measure_step(TIME, np.full_like(TIME, 0.99), 1.0, 1e-3)
    assert not figures.arrived
    assert figures.settling_time is None
    assert figures.error == pytest.approx(-0.01)


def test_a_disturbance_after_arrival_extends_the_settling_time() -> None:
    position = np.ones_like(TIME)
    position[1000] = 1.5
    figures = measure_step(TIME, position, 1.0, 1e-3)
    assert figures.settling_time == pytest.approx(TIME[1001])
    assert figures.arrived


def test_leaving_the_band_at_the_end_is_not_an_arrival() -> None:
    position = np.ones_like(TIME)
    position[-1] = 1.1
    assert not measure_step(TIME, position, 1.0, 1e-3).arrived


def test_tracking_error_of_a_constant_lag() -> None:
    figures = measure_step(TIME, TIME - 0.2, 2.0, 1.0, reference=TIME)
    assert figures.tracking_rms == pytest.approx(0.2)
    assert figures.tracking_max == pytest.approx(0.2)
    assert measure_step(TIME, TIME, 2.0, 1.0).tracking_rms is None


@pytest.mark.parametrize("target", [10.0, -10.0])
@pytest.mark.parametrize("ramp", [0.001, 0.5])
def test_rise_and_lag_of_a_first_order_loop(target: float, ramp: float) -> None:
    """The lag is the time constant for a step and for a ramp; the step rises in T ln 9."""
    constant, step = 0.05, TIME[1]
    reference = target * np.minimum(TIME / ramp, 1.0)
    value = np.zeros_like(TIME)
    for k in range(1, len(TIME)):
        value[k] = reference[k] + (value[k - 1] - reference[k]) * math.exp(-step / constant)
    figures = measure_step(TIME, value, target, COUNT, reference=reference)
    assert figures.lag == pytest.approx(constant, abs=step)
    if ramp == 0.001:
        assert figures.rise_time == pytest.approx(constant * math.log(9.0), abs=2.0 * step)


def test_no_rise_and_no_lag_without_a_distance_or_arrival() -> None:
    still = measure_step(TIME, np.ones_like(TIME), 1.0, COUNT, reference=np.ones_like(TIME))
    assert (still.rise_time, still.lag) == (None, None)
    short = measure_step(TIME, np.minimum(TIME, 0.5), 1.0, COUNT, reference=np.ones_like(TIME))
    assert (short.rise_time, short.lag) == (None, None)


def test_with_zero_distance_any_excursion_is_an_overshoot() -> None:
    position = 1.0 + 0.01 * np.sin(20.0 * TIME)
    position[0] = 1.0
    assert measure_step(TIME, position, 1.0, 0.1).overshoot == pytest.approx(0.01, rel=1e-3)


def test_settling_at_the_edge_of_the_band_is_inside() -> None:
    assert settling_time(np.array([0.0, 1.0]), np.array([0.5, -0.5]), 0.5) == 0.0


def test_rms_is_the_root_of_the_mean_square() -> None:
    assert rms(np.array([3.0, -4.0])) == pytest.approx(math.sqrt(12.5))


def test_series_of_different_length_are_refused() -> None:
    with pytest.raises(ValueError, match="two samples"):
        measure_step(TIME[:1], TIME[:1], 1.0, 0.1)
    with pytest.raises(ValueError, match="equal length"):
        measure_step(TIME, TIME[1:], 1.0, 0.1)
