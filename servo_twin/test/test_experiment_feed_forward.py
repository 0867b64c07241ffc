"""Feed-forward improves the figures; without it the bounds are violated."""

from __future__ import annotations

import pytest
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import feed_forward, rig
from servo_twin.validation.experiments.feed_forward import Mismatch
from servo_twin.validation.experiments.plant_limits import nominal_shafts
from servo_twin.validation.experiments.rig import record, spinning


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed_forward, "DISTANCES", (1.0,))


def rows(**changes: float) -> dict[str, bool]:
    plant = PlantConfig.load()
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, **{name: factor * getattr(entry, name) for name, factor in changes.items()})
    return {row.name: row.agrees for row in feed_forward.run(plant, seed=4).rows}


@pytest.mark.usefixtures("short", "level")
@pytest.mark.parametrize("changes", [{}, {"inertia": 2.0}])
def test_every_figure_is_within_its_bound(changes: dict[str, float]) -> None:
    found = rows(**changes)
    assert len(found) == 10
    assert all(found.values()), found


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("missing", ["SPEED_FORWARD", "ACCELERATION_FORWARD"])
def test_missing_feature_violates_the_bounds(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    genuine, nominals = rig.features, nominal_shafts(PlantConfig.load(), 4)

    def features(board: Board, axis: int, **switches: bool) -> None:
        genuine(board, axis, **{name: on for name, on in switches.items() if name != missing})

    monkeypatch.setattr(rig, "features", features)
    monkeypatch.setattr(feed_forward, "nominal_shafts", lambda plant, seed: nominals)
    found = rows()
    for axis in (1, 2):
        if missing == "SPEED_FORWARD":
            assert not found[f"axis{axis} 1 turns, following error, speed / none"]
        else:
            assert not found[f"axis{axis} 1 turns, following error, speed, acceleration"]


def test_figures_of_a_shaft_at_rest() -> None:
    with spinning(PlantConfig.load(), 4) as board:
        recording = record(board, [0], 0.1)[0]
    here = round(recording["position"][0])
    plant = PlantConfig.load()
    there = feed_forward.measure(recording, here, plant, 0)
    assert (there.overshoot, there.settling) == (0.0, 0.0)
    assert there.error <= 0.5
    away = feed_forward.measure(recording, here + 1000, plant, 0)
    assert (away.overshoot, away.settling) == (0.0, None)


def test_bounds_are_scaled_with_the_inertia() -> None:
    maximum = [feed_forward.error_bound(100.0, Mismatch(there, 1.0)) for there in (0.5, 1.0, 2.0)]
    assert maximum == pytest.approx([253.0, 78.0, 128.0])
