"""Known open loops, measured in a closed loop with noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from servo_measurement.frequency_response import Response, estimate, figures, joined
from servo_measurement.test_signal import SweptSine
from servo_tuning.linear import Matrix, System, margins

STEP: Final = 0.5e-3
SAMPLES: Final = 2000
F_MIN, F_MAX = 8.0, 800.0


def integrator(gain: float, delay: int, lag: float = 0.0) -> System:
    """``gain / s`` with sample and hold, a delay of `delay` samples, and a first-order lag with the pole `lag`."""

    def step(x: Matrix, u: Matrix) -> tuple[Matrix, Matrix]:
        total, filtered, *late = x
        moved = [u[0], *late][: len(late)]
        arriving = late[-1] if late else u[0]
        filtered = lag * filtered + (1.0 - lag) * arriving
        return np.vstack([total + gain * STEP * filtered, filtered, *moved]), total[None, :]

    return System.of(step, 2 + delay, 1, STEP)


def resonator(frequency: float, damping: float) -> System:
    """An integrator in parallel with a lightly damped resonator."""
    radius = math.exp(-2.0 * math.pi * frequency * damping * STEP)
    angle = 2.0 * math.pi * frequency * STEP
    a = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, 2.0 * radius * math.cos(angle), -(radius**2)],
            [0.0, 1.0, 0.0],
        ]
    )
    b = np.array([[300.0 * STEP], [0.05], [0.0]])
    return System(a, b, np.array([[1.0, 1.0, -1.0]]), np.zeros((1, 1)), STEP)


def swept_sine(amplitude: float = 1.0) -> NDArray[np.float64]:
    """Swept sine of the board, followed by zeros."""
    sine = SweptSine("TORQUE", amplitude, F_MIN, F_MAX, 0.8 * SAMPLES * STEP)
    steps = sine.step * (1.0 + sine.growth) ** np.arange(sine.calls)
    signal = np.zeros(SAMPLES)
    signal[: sine.calls] = amplitude * np.sin(2.0 * math.pi * np.concatenate([[0.0], np.cumsum(steps)[:-1]]))
    return signal


def closed(
    loop: System,
    noise: float,
    seed: int,
    *,
    amplitude: float = 1.0,
    repeats: int = 4,
    nonlinearity: Callable[[float], float] = lambda e: e,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Test signal, error and output of a closed loop with a disturbed output."""
    random = np.random.default_rng(seed)
    d = swept_sine(amplitude)
    error, output = np.empty((2, repeats, SAMPLES))
    for row in range(repeats):
        x = np.zeros(loop.a.shape[0])
        disturbance = noise * random.standard_normal(SAMPLES)
        for k in range(SAMPLES):
            output[row, k] = float(loop.c[0] @ x) + disturbance[k]
            error[row, k] = d[k] - output[row, k]
            x = loop.a @ x + loop.b[:, 0] * nonlinearity(error[row, k])
    return np.tile(d, (repeats, 1)), error, output


def measured(d: NDArray[np.float64], error: NDArray[np.float64], output: NDArray[np.float64]) -> Response:
    return estimate(STEP, d, error, output, F_MIN, F_MAX)


def deviation(response: Response, loop: System, top: float = F_MAX) -> float:
    """Largest relative error."""
    low = response.frequency < top
    truth = loop.response(2.0 * math.pi * response.frequency)
    return float(np.abs(response.value / truth - 1.0)[low].max())


def test_a_loop_without_noise_is_found_exactly() -> None:
    loop = integrator(500.0, 1)
    response = measured(*closed(loop, 0.0, 1))
    assert deviation(response, loop) < 0.01
    truth = margins(loop.response, loop.nyquist)
    found = figures(response)
    assert found.crossover is not None
    assert found.phase_margin is not None
    assert found.gain_margin is not None
    assert found.crossover.value == pytest.approx(truth.crossover, rel=2e-3)
    assert found.phase_margin.value == pytest.approx(truth.phase, abs=0.2)
    assert found.gain_margin.value == pytest.approx(truth.gain, rel=0.01)
    assert found.resonances == ()
    assert found.undetermined == ()
    assert response.coherence.min() > 0.99


@settings(max_examples=12, deadline=None)
@given(
    gain=st.floats(150.0, 700.0),
    delay=st.integers(0, 2),
    lag=st.floats(0.0, 0.5),
    noise=st.floats(0.0, 0.03),
    seed=st.integers(0, 1000),
)
def test_figures_are_within_their_uncertainty(gain: float, delay: int, lag: float, noise: float, seed: int) -> None:
    loop = integrator(gain, delay, lag)
    truth = margins(loop.response, loop.nyquist)
    assert truth.crossover is not None
    assert truth.phase is not None
    if truth.phase < 15.0 or np.abs(np.linalg.eigvals(loop.fed_back(0, 0).a)).max() > 0.995:
        return  # the loop must settle within its recording
    found = figures(measured(*closed(loop, noise, seed)))
    assert found.crossover is not None
    assert found.phase_margin is not None
    assert found.crossover.value == pytest.approx(truth.crossover, abs=5.0 * found.crossover.sigma + 0.01 * gain / 6.28)
    assert found.phase_margin.value == pytest.approx(truth.phase, abs=5.0 * found.phase_margin.sigma + 0.5)


def test_the_feedback_of_noise_does_not_bias_the_loop() -> None:
    """Output over error tends to -1 if noise drives both; the instrumental variable avoids this bias."""
    loop = integrator(500.0, 1)
    d, error, output = closed(loop, 0.15, 3, repeats=24)
    response = measured(d, error, output)
    o, e = np.fft.rfft(output, axis=1), np.fft.rfft(error, axis=1)
    naive = (o * e.conj()).sum(axis=0) / (np.abs(e) ** 2).sum(axis=0)
    f = np.fft.rfftfreq(SAMPLES, STEP).astype(np.float64)
    high = (f > 250.0) & (f < 500.0)
    truth = loop.response(2.0 * math.pi * f[high])
    assert np.abs(np.mean(naive[high] / truth) - 1.0) > 0.2
    points = (response.frequency > 250.0) & (response.frequency < 500.0)
    ratio = response.value[points] / loop.response(2.0 * math.pi * response.frequency[points])
    assert np.abs(np.mean(ratio) - 1.0) < 0.05


def test_friction_and_nonlinearity_increase_the_uncertainty() -> None:
    """With Coulomb friction at reversals, a signal that is too small is detected by scatter or coherence."""
    loop = integrator(500.0, 1)

    def dead_zone(e: float) -> float:
        return e - math.copysign(min(abs(e), 0.2), e)

    large = measured(*closed(loop, 0.01, 5, amplitude=20.0, nonlinearity=dead_zone))
    small = measured(*closed(loop, 0.01, 5, amplitude=0.15, nonlinearity=dead_zone))
    assert figures(large).crossover is not None
    assert np.median(small.sigma) > 5.0 * np.median(large.sigma)
    d, error, output = closed(loop, 0.01, 6)
    shifted = measured(d, error + 3.0, output - 2.0)
    assert np.abs(shifted.value - measured(d, error, output).value).max() < 1e-9


def test_no_figures_from_a_signal_below_the_noise() -> None:
    found = figures(measured(*closed(integrator(500.0, 1), 1.0, 7, amplitude=0.01)))
    assert (found.crossover, found.phase_margin, found.gain_margin) == (None, None, None)
    assert found.undetermined
    nothing = figures(measured(*[np.zeros((3, SAMPLES))] * 3))
    assert nothing.crossover is None


def test_missing_crossover_is_reported() -> None:
    loop = integrator(500.0, 1)
    response = measured(*closed(loop, 0.0, 8))
    for cut, side in ((response.frequency < 60.0, "above"), (response.frequency > 110.0, "below")):
        part = Response(*(getattr(response, name)[cut] for name in ("frequency", "value", "sigma", "coherence")))
        found = figures(part)
        assert found.crossover is None
        assert f"the gain is always {side} 1" in found.undetermined[0]
    both = joined([part, Response(*(getattr(response, n)[~cut] for n in ("frequency", "value", "sigma", "coherence")))])
    assert np.array_equal(both.frequency, response.frequency)
    assert figures(both) == figures(response)


def test_a_resonance_and_its_antiresonance_are_found() -> None:
    loop = resonator(250.0, 0.02)
    grid = np.linspace(150.0, 400.0, 20_000)
    size = np.abs(loop.response(2.0 * math.pi * grid)) * grid
    found = figures(measured(*closed(loop, 0.001, 9))).resonances
    assert {r.height > 0.0 for r in found} >= {True}
    peak = max(found, key=lambda r: r.height)
    assert peak.frequency == pytest.approx(grid[np.argmax(size)], rel=0.04)


def test_the_nearest_of_several_crossovers_is_reported() -> None:
    """Below the resonance of a load on a spring the loop crosses unity gain with a phase lead."""

    def sprung(omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        zeros, poles = (w**2 - omega**2 + 0.02j * w * omega for w in (300.0, 600.0))
        return np.asarray(200.0 / (1j * omega) * np.exp(-2e-4j * omega) * zeros / poles)

    frequency = np.geomspace(F_MIN, F_MAX, 2000)
    value = sprung(2.0 * math.pi * frequency)
    found = figures(Response(frequency, value, np.full_like(frequency, 1e-3), np.ones_like(frequency)))
    truth = margins(sprung, 2.0 * math.pi * F_MAX)
    assert found.crossover is not None
    assert found.phase_margin is not None
    assert truth.phase is not None
    assert truth.phase > 0.0
    assert found.phase_margin.value == pytest.approx(truth.phase, abs=2.0)
    assert found.crossover.value == pytest.approx(truth.crossover, rel=0.15)  # the fit smooths the steep flank


def test_a_swept_sine_ends_after_whole_turns() -> None:
    for point, top in (("I_Q", 6400.0), ("TORQUE", 790.0)):
        sine = SweptSine(point, 1.0, 0.02 * top, top, 0.3)
        steps = sine.step * (1.0 + sine.growth) ** np.arange(sine.calls)
        assert steps[-1] / sine.period == pytest.approx(top, rel=0.02)
        assert math.remainder(float(steps.sum()), 1.0) == pytest.approx(0.0, abs=1e-3)
    assert SweptSine("I_D", 1.0, 100.0, 100.0, 0.1).growth == 0.0
