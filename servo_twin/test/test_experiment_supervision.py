"""Motion faults are raised in time, with the right name, without false alarms; otherwise the bounds are violated."""

from __future__ import annotations

import pytest
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig, supervision

CAUSES = ("shaft blocked in a move", "too large load in a move", "driven by a load", "set-point too fast")


def wrong() -> set[str]:
    return {row.name for row in supervision.run(PlantConfig.load(), seed=7).rows if not row.agrees}


def test_every_figure_is_within_its_bound() -> None:
    assert wrong() == set()


def test_disabled_supervision_violates_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = rig.features

    def features(board: Board, axis: int, **switches: bool) -> None:
        genuine(board, axis, **dict.fromkeys(switches, False))

    monkeypatch.setattr(rig, "features", features)
    names = wrong()
    for cause in CAUSES:
        for figure in ("time until outputs off", "expected fault reported", "time with / without the feature"):
            assert f"axis1, {cause}: {figure}" in names
