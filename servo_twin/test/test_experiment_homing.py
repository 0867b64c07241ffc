"""Homing finds hard stops of any stiffness; wrong figures violate the bounds."""

from __future__ import annotations

import numpy as np
import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import homing, rig


def test_every_figure_is_within_its_bound() -> None:
    outcome = homing.run(PlantConfig.load(), seed=6)
    assert [row for row in outcome.rows if not row.agrees] == []


def test_wrong_position_of_stops_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The position of the stops is wrong by ten counts."""
    zeros = homing._zeros
    monkeypatch.setattr(homing, "_zeros", lambda board: [zero + 10 * rig.COUNT for zero in zeros(board)])
    (first, second) = homing.contacts(PlantConfig.load(), 6, "steel", 0)
    assert min(first.place, second.place) > homing.PLACE_MAX


def test_wrong_position_of_switches_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    zeros = homing._zeros
    monkeypatch.setattr(homing, "_zeros", lambda board: [zero - 10 * rig.COUNT for zero in zeros(board)])
    found = homing.to_switches(PlantConfig.load(), 6, 0)
    low, high = homing.BEYOND_EDGE
    assert all(one.done and not low <= one.place <= high for one in found)


def test_missing_switch_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(homing, "fit", lambda board, *pins: None)
    monkeypatch.setattr(homing, "HOMING_TIMEOUT", 3.0)
    assert not any(one.done for one in homing.to_switches(PlantConfig.load(), 6, 0))


def test_axis_without_the_feature_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig, "features", lambda board, axis, **switches: None)
    it = homing.unhomed(PlantConfig.load(), 6)
    for stationary in it.stationary.values():
        assert np.ptp(stationary.shaft) > 1000.0
        assert not stationary.limits[-1] & it.mask
