"""Soft limits stop the shaft; missing limits violate the bounds."""

from __future__ import annotations

import pytest
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig, soft_limits


def wrong() -> set[str]:
    return {row.name for row in soft_limits.run(PlantConfig.load(), seed=6).rows if not row.agrees}


def test_every_figure_is_within_its_bound() -> None:
    assert wrong() == set()


def test_disabled_limits_violate_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig, "features", lambda board, axis, **switches: None)
    names = wrong()
    for mode in ("position", "speed", "torque"):
        for what in ("overtravel with the feature", "distance to the limit at standstill", "limit flag set"):
            assert f"axis1, position, {mode} mode: {what}" in names
    assert "axis1, position, load towards the limit: overtravel with the feature" in names
    assert "axis1, limit set behind the shaft, target further outside: motion" in names
