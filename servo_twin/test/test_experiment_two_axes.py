"""Two axes on one bus: small influence on each other; a large influence violates the bounds."""

from __future__ import annotations

import dataclasses

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import two_axes
from servo_twin.validation.experiments.two_axes import Pair, Reversals


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


def test_axis_at_rest_has_no_influence(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = two_axes.turn

    def turn(
        plant: PlantConfig, seed: int, watched: int, reversals: Reversals | None, compensated: bool = True
    ) -> Pair:
        return genuine(plant, seed, watched, None, compensated)

    monkeypatch.setattr(two_axes, "turn", turn)
    assert {f"axis{n}, the other reverses: bus voltage variation" for n in (1, 2)} <= wrong(PlantConfig.load())


def test_influence_of_the_other_axis_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = two_axes.turn

    def turn(
        plant: PlantConfig, seed: int, watched: int, reversals: Reversals | None, compensated: bool = True
    ) -> Pair:
        even, other = genuine(plant, seed, watched, reversals, compensated)
        return dataclasses.replace(even, omega=even.omega * (1.02 if reversals else 1.0)), other

    monkeypatch.setattr(two_axes, "turn", turn)
    assert "axis1 rotates, the other reverses: additional deviation" in wrong(PlantConfig.load())
