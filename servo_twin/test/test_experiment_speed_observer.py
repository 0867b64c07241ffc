"""Speed observer: less noise and lag; without it the bounds are violated."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from servo_msgs_py.trace import Trace
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import speed_observer
from servo_twin.validation.experiments.speed_observer import Pair


def run(monkeypatch: pytest.MonkeyPatch, swapped: bool) -> dict[str, bool]:
    """The experiment at 5 rpm; `swapped`: the names of the runs with and without the observer are exchanged."""
    genuine = speed_observer.both

    def both(plant: PlantConfig, seed: int, axis: int, play: Callable[[Board], Trace]) -> Pair:
        without, observed = genuine(plant, seed, axis, play)
        return (observed, without) if swapped else (without, observed)

    monkeypatch.setattr(speed_observer, "both", both)
    monkeypatch.setattr(speed_observer, "SPEEDS", (5.0,))
    monkeypatch.setattr(speed_observer, "MEASURED", 2.0)
    return {row.name: row.agrees for row in speed_observer.run(PlantConfig.load(), seed=1).rows}


def test_all_figures_are_better_with_the_observer(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(run(monkeypatch, swapped=False).values())


def test_no_figure_is_better_without_the_observer(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = run(monkeypatch, swapped=True)
    ratios = [agrees for name, agrees in rows.items() if "with / without" in name]
    assert len(ratios) == 4
    assert not any(ratios)
