"""Friction compensation: its effect depends on the nominal value; without it the bounds are violated."""

from __future__ import annotations

import pytest
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import friction, rig
from servo_twin.validation.experiments.plant_limits import nominal_shafts


@pytest.fixture
def only_right(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(friction, "TIMES", (1.0,))


def wrong(seed: int = 5) -> set[str]:
    return {row.name for row in friction.run(PlantConfig.load(), seed).rows if not row.agrees}


def test_every_figure_is_within_its_bound() -> None:
    assert wrong() == set()


@pytest.mark.usefixtures("only_right", "level")
def test_correct_nominal_value_agrees() -> None:
    assert wrong() == set()


@pytest.mark.usefixtures("level")
def test_missing_feature_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """All six figures, at twice the nominal friction: the effect of less may be below the encoder resolution.

    Without the feature axis 2 loses 4.5 to 5.4 counts at the start, depending on the initial position between two edges
    of the encoder (seed); the bound is 4.6.
    """
    monkeypatch.setattr(friction, "TIMES", (2.0,))
    genuine, nominals = rig.features, nominal_shafts(PlantConfig.load(), 1)

    def features(board: Board, axis: int, **switches: bool) -> None:
        genuine(board, axis, **{name: on for name, on in switches.items() if name != "FRICTION"})

    monkeypatch.setattr(rig, "features", features)
    monkeypatch.setattr(friction, "nominal_shafts", lambda plant, seed: nominals)
    assert len(wrong(seed=4)) == 6


@pytest.mark.parametrize(("times", "expected"), [(1.0, 0.0), (2.0, 0.5), (0.5, 1.0), (0.25, 3.0)])
def test_uncompensated_friction_is_calculated(times: float, expected: float) -> None:
    assert friction.uncompensated(times) == pytest.approx(expected)
