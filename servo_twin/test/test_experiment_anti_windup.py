"""F21 and F22: anti-windup makes the difference, and the bounds see it."""

from __future__ import annotations

import numpy as np
import pytest
from servo_twin.experiments import anti_windup
from servo_twin.experiments.anti_windup import Response
from servo_twin.experiments.rig import TICK
from servo_twin.plant import PlantConfig


def test_agrees_with_the_reference_design() -> None:
    outcome = anti_windup.run(PlantConfig.load(), seed=3)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


@pytest.mark.parametrize("swapped", [True, False])
def test_bounds_notice_a_missing_anti_windup(monkeypatch: pytest.MonkeyPatch, swapped: bool) -> None:
    genuine = anti_windup.respond

    def respond(plant: PlantConfig, seed: int, anti_windup: bool) -> Response:
        return genuine(plant, seed, swapped)

    monkeypatch.setattr(anti_windup, "respond", respond)
    outcome = anti_windup.run(PlantConfig.load(), seed=3)
    wrong = {row.name for row in outcome.rows if not row.agrees}
    assert wrong >= ({"peak without", "lag without"} if swapped else {"peak with", "lag with"})


def test_depth_of_the_reference_shaft_is_one_ampere() -> None:
    axis = PlantConfig.load().axes[0]
    assert anti_windup.current_limit(axis) == pytest.approx(1.0)


def test_another_shaft() -> None:
    plant = PlantConfig.load().with_axis(0, inertia=1.1e-5, psi_m=0.014)
    outcome = anti_windup.run(plant, seed=5)
    assert outcome.row("peak with").measured < outcome.row("peak without").measured  # type: ignore[operator]


@pytest.mark.parametrize("lag", [0.0, 14.4, 72.0])
def test_height_and_lag_of_a_known_wave(lag: float) -> None:
    time = TICK * np.arange(1000)
    wave = 60.0 * np.sin(2.0 * np.pi * anti_windup.FREQUENCY * time - np.radians(lag))
    peaks, lags = anti_windup.half_waves(wave)
    assert len(peaks) == 19
    assert np.allclose(peaks, 60.0, rtol=1e-3)
    assert np.allclose(lags, lag, atol=360.0 * anti_windup.FREQUENCY * TICK)
