"""The benches of the virtual board build and run, and compare equal measurements."""

from __future__ import annotations

import math
from typing import Any, get_args

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


def boards(cpu_share: float) -> dict[str, dict[str, Any]]:
    return {"1": {"factor": 50.0, "cpu_share": 1.0}, "2": {"factor": 90.0, "cpu_share": cpu_share}}


def test_growth_is_relative_to_one_board() -> None:
    assert twin.growth(boards(0.97)) == [
        "turning boards, one per thread, in parallel, by wall-clock time: 1: 50.0 (x 1.0), 2: 90.0 (x 1.8)"
    ]


def test_growth_reports_other_load() -> None:
    assert "CPU share of the boards: 1: 100%, 2: 40%" in twin.growth(boards(0.4))[1]


@pytest.mark.parametrize(
    ("comment", "name"),
    [
        (b"\0GCC: (Debian 12.2.0-14) 12.2.0\0", "gcc 12.2.0"),
        (b"\0GCC: (Debian 12.2.0-14) 12.2.0\0Debian clang version 22.1.8 (1)\0", "clang 22.1.8"),
        (b"\0", "unknown compiler"),
    ],
)
def test_compiler_of_a_library_is_identified(comment: bytes, name: str) -> None:
    assert twin.compiler(b"\x7fELF" + comment) == name
