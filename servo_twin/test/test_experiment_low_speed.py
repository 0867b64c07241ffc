"""Very low speed: the enhanced method is better; without it the bounds are violated."""

from __future__ import annotations

import pytest
from servo_msgs_py.trace import Trace
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import low_speed


def run(monkeypatch: pytest.MonkeyPatch, swapped: bool) -> dict[str, bool]:
    """The experiment at 5 rpm; `swapped`: the names of the two methods are exchanged."""
    genuine = low_speed.hold_speed

    def hold_speed(plant: PlantConfig, seed: int, axis: int, speed: float, enhanced: bool) -> Trace:
        return genuine(plant, seed, axis, speed, enhanced != swapped)

    monkeypatch.setattr(low_speed, "hold_speed", hold_speed)
    monkeypatch.setattr(low_speed, "SPEEDS", (5.0,))
    monkeypatch.setattr(low_speed, "MEASURED", 2.0)
    return {row.name: row.agrees for row in low_speed.run(PlantConfig.load(), seed=1).rows}


def test_enhanced_is_better_than_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(run(monkeypatch, swapped=False).values())


def test_plain_is_not_better_than_enhanced(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = run(monkeypatch, swapped=True)
    ratios = [agrees for name, agrees in rows.items() if "enhanced / plain" in name]
    assert len(ratios) == 4
    assert not any(ratios)


def test_wrong_mean_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = low_speed.hold_speed

    def hold_speed(plant: PlantConfig, seed: int, axis: int, speed: float, enhanced: bool) -> Trace:
        right = genuine(plant, seed, axis, speed, enhanced)
        return right.changed(omega=1.02 * right["omega"])

    monkeypatch.setattr(low_speed, "hold_speed", hold_speed)
    monkeypatch.setattr(low_speed, "SPEEDS", (5.0,))
    rows = {row.name: row.agrees for row in low_speed.run(PlantConfig.load(), seed=1).rows}
    assert not rows["axis1 5 rpm, position error with enhanced M/T"]
