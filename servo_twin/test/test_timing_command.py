"""``servo-sim timing`` at level registers: right timing agrees, wrong registers violate the bounds."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from buffered_registers import poke_buffered
from servo_twin.board import Board
from servo_twin.cli import main
from servo_twin.plant import PlantConfig
from servo_twin.validation.timing.command import measure

PWMA_SM1_VAL4, PWMA_SM1_VAL5 = 0xE63D, 0xE63F


def poke(address: int, value: Callable[[int], int]) -> Callable[[Board], None]:
    """Change a buffered register."""

    def do(board: Board) -> None:
        poke_buffered(board, address, value(board.peek(address)))
        board.run(0.002)

    return do


def wrong(spoil: Callable[[Board], None]) -> set[str]:
    return {row.name for row in measure(PlantConfig.load(), 4, spoil)[0].rows if not row.agrees}


def test_timing_agrees_and_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "timing.png"
    assert main(["timing", "--seed", "3", "--json", "--plot", str(picture)]) == 0
    rows = {row["figure"]: row["measured"] for row in json.loads(capsys.readouterr().out)}
    assert rows["motor 2 behind motor 1, maximum"] == pytest.approx(180.0, abs=0.3)
    assert rows["start interrupt"] == 1.0
    assert picture.stat().st_size > 50_000


def test_all_and_plot_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["timing", "--all", "--plot", str(tmp_path / "timing.png")]) != 0
    assert "--plot and --all cannot be combined" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_late_trigger_violates_the_bounds() -> None:
    """1.5 us after the centre the converter still samples before M1, but not at the mean current."""
    names = wrong(poke(PWMA_SM1_VAL4, lambda value: value + 100))
    assert "motor 1: currents after the centre, maximum" in names


def test_early_interrupt_violates_the_bounds() -> None:
    """M1 comes before the third conversion."""
    names = wrong(poke(PWMA_SM1_VAL5, lambda value: value - 120))
    assert "M1 begins after its data, minimum" in names


def test_a_core_that_is_too_slow_fails_its_rows(capsys: pytest.CaptureFixture[str]) -> None:
    """Handlers half as long again: rows fail, and the board itself counts late loops."""
    assert main(["timing", "--json", "--cycles-per-instruction", "3.5"]) != 0
