"""F21 and F22: effect of the anti-windup; missing anti-windup violates the bounds."""

from __future__ import annotations

import numpy as np
import pytest
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import anti_windup


def test_agrees_with_the_reference_design() -> None:
    outcome = anti_windup.run(PlantConfig.load(), seed=3)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


@pytest.mark.parametrize("swapped", [True, False])
def test_missing_anti_windup_violates_the_bounds(monkeypatch: pytest.MonkeyPatch, swapped: bool) -> None:
    genuine = anti_windup.respond

    def respond(plant: PlantConfig, seed: int, frequency: float, anti_windup: bool) -> Trace:
        return genuine(plant, seed, frequency, swapped)

    monkeypatch.setattr(anti_windup, "respond", respond)
    outcome = anti_windup.run(PlantConfig.load(), seed=3)
    wrong = {row.name for row in outcome.rows if not row.agrees}
    how = "without" if swapped else "with"
    assert wrong >= {f"peak {how} anti-windup", f"lag {how} anti-windup"}


def test_depth_of_the_reference_shaft_is_one_ampere() -> None:
    axis = PlantConfig.load().axes[0]
    assert anti_windup.current_limit(axis, anti_windup.FREQUENCY) == pytest.approx(1.0)


@pytest.mark.parametrize("inertia", [0.4e-5, 2.4e-5])
def test_anti_windup_agrees_with_another_inertia(inertia: float) -> None:
    """Frequency and limit are scaled with the inertia, for which the loop is not tuned."""
    outcome = anti_windup.run(PlantConfig.load().with_axis(0, inertia=inertia), seed=5)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


@pytest.mark.parametrize("frequency", [6.6, 20.0, 37.0])
def test_quarter_periods_are_whole_ticks(frequency: float) -> None:
    whole = anti_windup.whole_ticks(frequency)
    assert whole == pytest.approx(frequency, rel=0.5 * TICK / (0.25 / frequency) + 0.002)  # half a tick off
    assert 0.25 / whole / TICK == pytest.approx(round(0.25 / whole / TICK))


@pytest.mark.parametrize("lag", [0.0, 14.4, 72.0])
def test_amplitude_and_lag_of_a_known_sine(lag: float) -> None:
    time = TICK * np.arange(1000)
    wave = 60.0 * np.sin(2.0 * np.pi * anti_windup.FREQUENCY * time - np.radians(lag))
    peaks, lags = anti_windup.half_waves(wave, anti_windup.FREQUENCY)
    assert len(peaks) == 19
    assert np.allclose(peaks, 60.0, rtol=1e-3)
    assert np.allclose(lags, lag, atol=360.0 * anti_windup.FREQUENCY * TICK)
