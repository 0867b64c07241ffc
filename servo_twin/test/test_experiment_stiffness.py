"""Deflection by a load step; a drive without enough current violates the bounds."""

from __future__ import annotations

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import stiffness


@pytest.fixture(scope="module")
def plant() -> PlantConfig:
    return PlantConfig.load()


@pytest.mark.usefixtures("level")
def test_every_figure_is_within_its_bound(plant: PlantConfig) -> None:
    outcome = stiffness.run(plant, seed=8)
    assert outcome.agrees, [(row.name, row.measured) for row in outcome.rows if not row.agrees]


def test_too_small_current_violates_the_bounds(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    """The current limit is below the load torque, so the load accelerates the shaft."""
    monkeypatch.setattr(stiffness, "LIMIT", 1.5)
    with pytest.raises(SimulationError, match="axis1 ended in a fault"):
        stiffness.run(plant, seed=8)


def test_missing_deflection_is_an_error(monkeypatch: pytest.MonkeyPatch, plant: PlantConfig) -> None:
    monkeypatch.setattr(stiffness, "NOMINAL", 1e-6)  # less than the friction holds
    assert not stiffness.run(plant, seed=8).row("axis1, recovery time").agrees
