"""The brake holds loads and inputs stop motions; missing brakes and inputs violate the bounds."""

from __future__ import annotations

import math

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import pins


@pytest.mark.usefixtures("level")
def test_every_figure_is_within_its_bound() -> None:
    """At level registers this includes the computing time at the end of two rotor searches in the same tick."""
    assert {row.name for row in pins.run(PlantConfig.load(), seed=2).rows if not row.agrees} == set()


def test_load_without_a_brake_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pins, "BRAKE", 0.0)
    with pytest.raises(SimulationError, match="after the search"):
        pins.measure_drops(PlantConfig.load(), 2, 1.0)


def test_unconfigured_pins_violate_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pins, "fit", lambda board, *names: None)
    plant = PlantConfig.load()
    with pytest.raises(SimulationError, match=r"in SPIN|after the search"):
        pins.measure_drops(plant, 2, 1.0)  # the brake stays closed
    assert not pins.open_enable(plant, 2)[1]
    with pytest.raises(SimulationError, match="switches"):
        pins.overrun(plant, 2)
    results = pins.cut_wires(plant, 2)
    assert not results["limit_max, holding"]
    assert not results["enable, at rest: refused without a fault"]


def test_load_drops_with_a_brake_slower_than_nominal(monkeypatch: pytest.MonkeyPatch) -> None:
    """The configured waiting time of 30 ms is too short for a brake that takes 90 ms."""
    monkeypatch.setattr(pins, "CLOSE_TIME", 0.09)
    found = pins.measure_drops(PlantConfig.load(), 2, math.pi / 3)
    assert min(disabled for _, _, disabled, _ in found.drops) > pins.TRANSFER_DROP_MAX
