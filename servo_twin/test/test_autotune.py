"""``servo-sim autotune``: one board, and random loads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from servo_measurement.autotune import AutotuneRequest
from servo_tuning.reading import SERVO_TOML, read_table
from servo_twin.identification import autotune
from servo_twin.identification.autotune import CONFIRMED, Trial, Trials, summary
from servo_twin.plant import PlantConfig
from servo_twin.sprung_load import SprungLoad

from servo_twin import cli

WORK = Trials(PlantConfig.load(), read_table(SERVO_TOML), AutotuneRequest(0), "ideal", seed=1)


def test_a_random_load_is_tuned_and_stays_quiet_when_its_resonance_changes() -> None:
    """Load 2 of seed 1, of 72 Hz; the same number is the same load."""
    assert WORK.load(2) == WORK.load(2) != WORK.load(3)
    trial = WORK.run(2)
    assert trial.outcome == CONFIRMED
    assert not trial.unstable
    assert trial.part > 0.5
    assert abs(trial.phase) < 5.0


def test_an_oscillation_after_the_change_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """A resonance that changes by much more than stated."""
    monkeypatch.setattr(autotune, "CHANGE", 0.3)
    assert "oscillat" in WORK.run(2).unstable


def test_the_summary_names_what_is_not_confirmed() -> None:
    load = SprungLoad(100.0, 3.0, 0.02)
    good = Trial(load, 1.0, CONFIRMED, "", 40.0, 25.0, 1.0)
    bad = Trial(load, 1.0, "too soft", "faults 0x1", 100.0, 0.0, 0.0)
    text = "\n".join(summary([(0, good), (1, bad)]))
    assert "2 loads: 1 confirmed, 1 not" in text
    assert "median 0.5, 0.5 .. 0.5" in text
    assert "maximum 100.0 s" in text
    assert "load 1, 100 Hz, ratio 3, damping 0.02: too soft" in text
    assert "load 1: faults 0x1" in text


def test_the_command_tunes_a_virtual_board_with_a_rigid_shaft(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Which keeps its bandwidths."""
    assert cli.main(["autotune", "--axis", "2", "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["shaft"]["rigid"]
    assert found["after"] == pytest.approx(found["before"], rel=0.05)
    assert found["settling before"]
    assert (tmp_path / "servo.toml").is_file()


@pytest.mark.parametrize("content", ["", "[axis1.members]\n", "[board"])
def test_a_file_that_cannot_be_used_is_named(content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "my.toml"
    file.write_text(content, encoding="utf-8")
    assert cli.main(["autotune", "--config", str(file), "--out", str(tmp_path)]) != 0
    assert "my.toml" in capsys.readouterr().err
