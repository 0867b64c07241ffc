"""Each effect of the plant agrees with its equation; a missing effect violates its bound."""

from __future__ import annotations

import dataclasses

import pytest
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import plant_effects
from servo_twin.validation.experiments.plant_effects import EFFECTS


@pytest.mark.usefixtures("level")
def test_every_figure_is_within_its_bound() -> None:
    outcome = plant_effects.run(PlantConfig.load(), seed=1)
    assert [(row.name, row.measured, str(row.bound)) for row in outcome.rows if not row.agrees] == []
    assert len(outcome.rows) == len(outcome.panels) * 2 == 14


UNSEEN = {
    "lost motion of the load": {"backlash": 0.0},
    "ripple of the true speed, once per turn": {"disc_eccentricity": 0.0},
    "current that compensates the cogging": {"cogging_torque": 0.0},
    "L_q at the saturation current": {"i_saturation_q": 0.0},
    "R of a warm winding": {"winding_warms": 0.0},
    "psi_m of a warm magnet": {"magnet_coefficient": 0.0},
}


@pytest.mark.parametrize("name", UNSEEN)
def test_missing_effect_violates_the_bounds(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """The equation still contains the effect."""
    effect = next(effect for effect in EFFECTS if effect.name == name)

    def measure(board: Board, axis: int) -> plant_effects.Comparison:
        nominal = board.plant
        for value, without in UNSEEN[name].items():
            board.set_plant(f"axis{axis + 1}.{value}", without)
        board.plant = nominal
        return effect.measure(board, axis)

    monkeypatch.setattr(plant_effects, "EFFECTS", (dataclasses.replace(effect, measure=measure),))
    monkeypatch.setenv("SERVO_TWIN_LEVEL", "ideal")
    outcome = plant_effects.run(PlantConfig.load(), seed=1)
    assert [row.agrees for row in outcome.rows] == [False, False]
