"""Harmonics of the torque ripple from synthetic turns: a shaft under speed control, integrated in time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_measurement.least_squares import Floats
from servo_measurement.ripple_fit import TURN, Complexes, Measured, significant, turn_ripple
from servo_msgs_py.text_file import parse_toml
from servo_tuning.sensors import EdgeDelay
from servo_tuning.torque_ripple import HARMONICS, HARMONICS_MAX, TORQUE_RIPPLE, Harmonic, fragment, read_harmonics

STEP = 1e-3  # of the samples [s]
PARTS = 10  # integration steps per sample
INERTIA = 1.2e-5  # kg m^2
SPEED = 9.4  # rad/s
SENSOR = EdgeDelay(0.5e-3, 0.6e-3)
FRICTION = 0.004  # N m
COUNT = TURN / 4000.0
TURNS = 8


def turn(harmonics: list[Harmonic], direction: float, rng: np.random.Generator, noise: float) -> Complexes:
    """One recording: the current of a PI controller, and the delayed mean speed; noise of the torque [N m]."""
    total = round(1.15 * TURN / SPEED / STEP) * PARTS + 400 * PARTS
    dt = STEP / PARTS
    kp, ki = INERTIA * 400.0, INERTIA * 400.0 * 80.0
    order, amplitude, phase = (np.array([getattr(h, n) for h in harmonics]) for n in ("order", "amplitude", "phase"))
    theta, omega, integral = rng.uniform(-10.0, 10.0), direction * SPEED, direction * FRICTION
    rows = np.empty((total, 3))
    for k in range(total):
        error = direction * SPEED - omega
        integral += ki * error * dt
        torque = kp * error + integral
        ripple = float((amplitude * np.sin(order * theta + phase)).sum()) if harmonics else 0.0
        omega += (torque + ripple - direction * FRICTION) / INERTIA * dt
        theta += omega * dt
        rows[k] = theta, omega, torque
    window, late = round(SENSOR.window / dt), round(SENSOR.delay / dt)
    mean = np.convolve(rows[:, 1], np.full(window, 1.0 / window), "same")
    at = np.arange(200 * PARTS, total, PARTS)
    angle: Floats = np.floor(rows[at, 0] / COUNT) * COUNT
    torque = rows[at, 2] + noise * rng.standard_normal(at.size)
    time = at.astype(np.float64) * dt
    return turn_ripple(time, angle, mean[at - late], torque, INERTIA, SENSOR)


def measured(harmonics: list[Harmonic], seed: int, noise: float = 0.002, turns: int = TURNS) -> list[Measured]:
    rng = np.random.default_rng(seed)
    return significant(*([turn(harmonics, sign, rng, noise) for _ in range(turns)] for sign in (1.0, -1.0)))


def test_known_harmonics_are_found() -> None:
    """Within 5 % and 0.05 rad, and nothing else; order 84 is at 126 Hz, where the speed lags by 0.5 rad."""
    true = [Harmonic(1, 0.003, 4.0), Harmonic(12, 0.010, 0.7), Harmonic(24, 0.002, 2.0), Harmonic(84, 0.005, 5.0)]
    found = measured(true, 1)
    assert [one.harmonic.order for one in found] == [1, 12, 24, 84]
    for one, expected in zip(found, true, strict=True):
        assert one.harmonic.amplitude == pytest.approx(expected.amplitude, rel=0.05)
        late = (one.harmonic.phase - 0.5 * COUNT * expected.order - expected.phase + math.pi) % TURN - math.pi
        assert abs(late) < 0.05


def synthetic(seed: int, harmonics: list[Harmonic], noise: float, turns: int) -> list[Measured]:
    """`significant` for turns with noise of all orders [N m]."""
    rng = np.random.default_rng(seed)
    true = np.zeros(100, complex)
    for one in harmonics:
        true[one.order - 1] = one.amplitude * np.exp(1j * one.phase)
    groups = [true + noise * (rng.standard_normal((turns, 100, 2)) @ [1.0, 1j]) for _ in range(2)]
    return significant(*(list(group) for group in groups))


def test_noise_has_no_harmonic() -> None:
    """In at most 1 % of the measurements; ten of a thousand, and three standard deviations of that number."""
    assert sum(bool(synthetic(seed, [], 0.001, TURNS)) for seed in range(1000)) <= 19


@given(
    st.lists(st.integers(1, 100), min_size=1, max_size=12, unique=True),
    st.floats(0.001, 0.05),
    st.floats(0.0, 6.28),
    st.integers(0, 1000),
)
@settings(max_examples=50, deadline=None)
def test_the_greatest_harmonics_are_named_with_their_uncertainty(
    orders: list[int], amplitude: float, phase: float, seed: int
) -> None:
    true = [Harmonic(order, amplitude * (1.0 + 0.5 * k), phase) for k, order in enumerate(orders)]
    found = synthetic(seed, true, 0.02 * amplitude, TURNS)
    kept = {one.order: one for one in true[-HARMONICS_MAX:]}
    assert kept.keys() <= {one.harmonic.order for one in found}
    for one in found:
        if (expected := kept.get(one.harmonic.order)) is not None:
            assert abs(one.harmonic.amplitude - expected.amplitude) < 3.0 * one.amplitude
            assert abs((one.harmonic.phase - phase + math.pi) % TURN - math.pi) < 3.0 * one.phase


def test_a_difference_of_the_directions_is_an_uncertainty() -> None:
    forward: list[Complexes] = [np.full(100, 0.01 + 0j)] * 4
    backward: list[Complexes] = [-0.9 * one for one in forward]
    assert significant(forward, forward)
    assert not significant(forward, backward)


def test_less_than_a_turn_is_refused() -> None:
    time = np.linspace(0.0, 0.1, 100)
    with pytest.raises(ValueError, match=r"0\.\d+ of a turn"):
        turn_ripple(time, 5.0 * time, np.full(100, 5.0), np.zeros(100), INERTIA, SENSOR)


@pytest.mark.parametrize(
    "harmonics", [[], [Harmonic(12, 0.0104, 0.71)], [Harmonic(1, 1e-5, 6.28), Harmonic(84, 1.0, 0.0)]]
)
def test_fragment_is_read_back(harmonics: list[Harmonic]) -> None:
    table = parse_toml(fragment("axis1", harmonics))["axis1"][TORQUE_RIPPLE]
    assert HARMONICS in table
    assert list(read_harmonics("axis1.torque_ripple", table)) == harmonics
