"""Two axes on one bus: small influence on each other; a large influence violates the bounds."""

from __future__ import annotations

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import two_axes


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two_axes, "MEASURED", 0.8)


def wrong(plant: PlantConfig) -> set[str]:
    return {row.name for row in two_axes.run(plant, seed=3).rows if not row.agrees}


def test_every_figure_is_within_its_bound() -> None:
    assert wrong(PlantConfig.load()) == set()


def test_braking_speed_is_lower_with_a_softer_bus() -> None:
    assert wrong(PlantConfig.load().with_bus(capacitance=1e-3)) == set()


def test_too_much_braking_energy_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is below the bus voltage that the kinetic energy of both shafts produces."""
    monkeypatch.setattr(two_axes, "top_speed", lambda plant, axes, wanted: wanted)
    monkeypatch.setattr(two_axes, "over_voltage", lambda: 28.0)
    assert "both brake: highest bus voltage" in wrong(PlantConfig.load().with_bus(capacitance=2e-3))
