"""The experiment winding: the drive agrees with the bounds; missing derating violates them."""

from __future__ import annotations

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig, winding
from servo_twin.validation.experiments.outcome import Judge
from servo_twin.validation.experiments.winding import CASES, Motor, configured, time_series

PLANT = PlantConfig.load()
SEED = 4
QUICK = (Motor(2.0, 0.2), Motor(2.4, 0.3, r_s=0.35))


def test_other_motors_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(winding, "SECONDS", 15.0)
    monkeypatch.setattr(winding, "CASES", (winding.Case("quick", QUICK),))
    outcome = winding.run(PLANT, SEED)
    assert [row.name for row in outcome.rows if not row.agrees] == []
    assert len(outcome.rows) == 12
    assert len(outcome.panels) == 2


def test_missing_derating_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the feature the current is not derated."""
    monkeypatch.setattr(rig, "features", lambda *_, **__: None)
    world, servo, nominal, true = configured(PLANT, QUICK)
    found = time_series(world, SEED, servo, 2.5)
    for it, model, real in zip(found, nominal, true, strict=True):
        wrong = {row.name for row in winding.figures(Judge(), it, model, real) if not row.agrees}
        assert {"time until derating", "final current", "final winding temperature"} <= wrong
        assert it["i_q_ref"][-1] == pytest.approx(4.0, abs=0.01)


def test_wrong_nominal_value_applies_only_to_the_controller() -> None:
    world, _, nominal, true = configured(PLANT, CASES[2].motors)
    for axis, (model, real, motor) in enumerate(zip(nominal, true, CASES[2].motors, strict=True)):
        assert model.resistance == pytest.approx(motor.resistance_error * real.resistance)
        assert model.capacity == pytest.approx(motor.capacity_error * real.capacity)
        assert world.axes[axis].winding_resistance == real.resistance
        assert model.equilibrium(model.rated) == pytest.approx(model.maximum)
