"""Braking: bus voltage below its limit, energy budget of the resistor, current of the winding short."""

from __future__ import annotations

import math

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import braking


def wrong(plant: PlantConfig) -> set[str]:
    return {row.name for row in braking.run(plant, seed=3).rows if not row.agrees}


def test_every_figure_is_within_its_bound() -> None:
    assert wrong(PlantConfig.load()) == set()


def test_agrees_with_other_motors_and_a_tenth_of_the_capacitor() -> None:
    plant = PlantConfig.load().with_bus(capacitance=0.5e-3, r_brake=4.0)
    heavy = plant.with_axis(0, inertia=2.4e-5, r_s=0.65).with_axis(1, inertia=3e-5, psi_m=0.0128)
    assert wrong(heavy) == set()


def test_missing_current_reduction_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of the bus voltage is set below the start of the fold-back."""
    monkeypatch.setattr(braking, "over_voltage", lambda: 28.0)
    assert "no resistor: highest bus voltage" in wrong(PlantConfig.load())


def test_missing_resistor_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = braking.stop
    monkeypatch.setattr(braking, "stop", lambda plant, seed, speed, resistor: genuine(plant, seed, speed, 0.0))
    monkeypatch.setattr(braking, "use_budget", lambda plant, seed, resistor: braking.Budget(0.0, math.nan, None))
    names = wrong(PlantConfig.load())
    assert {
        "resistor: highest bus voltage",
        "budget: energy until the resistor is switched off",
        "budget: recovery time",
    } <= names


def test_the_short_current_follows_the_formula() -> None:
    """At 8.25 A the short is refused above about 1450 rpm, as on the slide."""
    axis = PlantConfig.load().axes[0]
    wound = [braking.short_current(axis, 100.0, drops=drops) for drops in (False, True)]
    assert wound[0] == pytest.approx(200.0 * axis.psi_m / math.hypot(axis.r_s, 200.0 * 0.4575e-3))
    assert wound[1] < wound[0]
    assert braking.refusal_speed(axis) == pytest.approx(1451 * math.pi / 30, rel=1e-3)
