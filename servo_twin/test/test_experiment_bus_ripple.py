"""Ripple of the bus voltage: suppressed by the compensation; missing compensation violates the bounds."""

from __future__ import annotations

import numpy as np
import pytest
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import bus_ripple


def test_every_figure_is_within_its_bound() -> None:
    outcome = bus_ripple.run(PlantConfig.load(), seed=9)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def test_missing_compensation_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = bus_ripple.turn

    def turn(plant: PlantConfig, seed: int, axis: int, compensated: bool) -> Trace:
        return genuine(plant, seed, axis, False)

    monkeypatch.setattr(bus_ripple, "turn", turn)
    wrong = {row.name for row in bus_ripple.run(PlantConfig.load(), seed=9).rows if not row.agrees}
    assert wrong == {
        f"axis{n}, current ripple{what} compensation" for n in (1, 2) for what in (" with / without", " with")
    }


def test_the_amplitude_at_one_frequency_is_found() -> None:
    time = TICK * np.arange(1000)
    signal = 7.0 + 0.25 * np.sin(2.0 * np.pi * 100.0 * time + 1.0) + 0.5 * np.sin(2.0 * np.pi * 50.0 * time)
    assert bus_ripple.amplitude(signal, 100.0) == pytest.approx(0.25)
