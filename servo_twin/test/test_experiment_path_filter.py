"""F23 and F24: the S curve is recognised, a ramp is not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import path_filter

ABLE = 1e9


@pytest.fixture(scope="module")
def recorded() -> tuple[Trace, float, int]:
    return path_filter.record(PlantConfig.load(), 6, 314.0)


def test_agrees_with_the_reference_design() -> None:
    outcome = path_filter.run(PlantConfig.load(), seed=6)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def wrong(recorded: tuple[Trace, float, int], path: NDArray[np.float64]) -> set[str]:
    recording, speed, distance = recorded
    rows = path_filter.figures(recording.changed(position_ref=path), speed, distance, ABLE)
    return {row.name for row in rows if not row.agrees}


def test_ramp_is_not_an_s_curve(recorded: tuple[Trace, float, int]) -> None:
    recording, speed, distance = recorded
    ramp: NDArray[np.float64] = np.minimum(speed * recording.time, distance)
    assert "largest jump of the S curve's speed per slow loop" in wrong(recorded, np.round(ramp))


@pytest.mark.parametrize("omega_n", [30.0, 100.0, 250.0])
def test_the_bandwidth_of_a_path_is_recovered(omega_n: float) -> None:
    time = TICK * np.arange(2000, dtype=np.float64)
    path = np.round(path_filter.analytic(time, 1e5, 0.4, omega_n))
    assert path_filter.fit_omega_n(time, path, 1e5, 0.4) == pytest.approx(omega_n, rel=1e-3)
