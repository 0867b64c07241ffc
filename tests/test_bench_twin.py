"""The benches of the virtual board build and run, and compare equal measurements."""

from __future__ import annotations

import math
from typing import get_args

import pytest
from bench import plant, twin
from servo_twin.level import Level


def test_plant_bench_has_both_levels() -> None:
    rows = plant.rows(plant.run(periods=512))
    assert len(rows) == 5
    for row in rows:
        assert all(math.isfinite(value) for value in row.values())
        assert row["averaged_ns"] > 0.0
        assert row["switching_ns"] > 0.0
        assert row["encoder_edges"] == 0.0 if row["volts"] == 0.0 else row["encoder_edges"] > 1.0


@pytest.mark.parametrize("level", get_args(Level))
def test_boards_run_in_parallel(level: Level, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(twin.SIMULATED, level, 0.05)
    both = twin.run_in_parallel(level, 2)
    assert both.factor > 0.0
    assert 0.0 < both.cpu_share <= 1.0
