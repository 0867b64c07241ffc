"""Homing finds hard stops of any stiffness; wrong figures violate the bounds."""

from __future__ import annotations

import numpy as np
import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import homing, rig


def test_every_figure_is_within_its_bound() -> None:
    outcome = homing.run(PlantConfig.load(), seed=6)
    assert [row for row in outcome.rows if not row.agrees] == []


def test_axis_without_the_feature_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig, "features", lambda board, axis, **switches: None)
    it = homing.unhomed(PlantConfig.load(), 6)
    for stationary in it.stationary.values():
        assert np.ptp(rig.shaft_counts(stationary)) > 1000.0
        assert not stationary["limits"][-1] & it.mask
