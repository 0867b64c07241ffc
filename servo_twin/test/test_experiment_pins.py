"""The brake holds loads and inputs stop motions; missing brakes and inputs violate the bounds."""

from __future__ import annotations

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import pins


@pytest.mark.usefixtures("level")
def test_every_figure_is_within_its_bound() -> None:
    """At level registers this includes the computing time at the end of two rotor searches in the same tick."""
    assert {row.name for row in pins.run(PlantConfig.load(), seed=2).rows if not row.agrees} == set()


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
