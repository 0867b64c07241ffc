"""Steps and spectra of recorded runs."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_twin.board import Board
from servo_twin.runs.command import main
from servo_twin.runs.curves import TIME, curves_of
from servo_twin.runs.spectrum import spectrum_of
from servo_twin.runs.steps import steps_of
from servo_twin.simulation import keep_set_points
from servo_twin.validation.simulated_run import SimulatedRun

SEED = 7
COGGING = {"axis1.cogging_torque": 0.01, "axis1.cogging_periods": 12}
TURNS = 3.0  # per second, of the speed step


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Moves of axis 1 and, together with one, of axis 2; then a step of the speed of axis 1."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    board = Board(seed=SEED, level="ideal")
    keep_set_points(board)
    for name, value in COGGING.items():
        board.set_plant(name, value)
    with SimulatedRun(path, board, seed=SEED) as simulated:
        simulated.enable()
        simulated.wait(0.3)
        for target in ([10.0, 0.0], [-10.0, 20.0]):
            simulated.write("cmd.position", target)
            simulated.wait(1.0)
        mode = board.catalogue.enums["control_mode_t"]["SPEED"]
        simulated.write("cmd.mode", [float(mode)] * 2, mask=1)
        simulated.write("cmd.speed", [2.0 * math.pi * TURNS, 0.0], mask=1)
        simulated.wait(8.0)
    return path


def text(path: Path, columns: dict[str, NDArray[np.float64]]) -> Path:
    """CSV file of columns."""
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


def printed(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 0) -> Any:
    assert main([*arguments, "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_every_move_is_found_with_its_figures(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "steps.png"
    steps = printed(capsys, "steps", str(run), "--band", "0.01", "-o", str(picture), status=1)
    assert picture.stat().st_size > 10_000
    found = [(step["axis"], step["quantity"], round(step["begin"], 1), round(step["commanded"], 1)) for step in steps]
    assert found == [
        ("axis1", "position", 0.0, 10.0),
        ("axis1", "position", 10.0, -10.0),
        ("axis2", "position", 0.0, 20.0),
        ("axis1", "speed", 0.0, round(2.0 * math.pi * TURNS, 1)),
    ]
    for step in steps[:3]:
        assert abs(step["error"]) < 0.01
        assert 0.0 < step["rise_time"] < step["settling_time"] < 0.6
        assert 0.005 < step["lag"] < 0.05
    assert steps[3]["settling_time"] is None  # the cogging is outside of this band


def test_the_exported_table_has_the_same_steps(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(run), "-o", str(tmp_path), "--topic", "/servo/snapshot"]) == 0
    capsys.readouterr()
    for one, other in zip(steps_of(curves_of(run)), steps_of(curves_of(tmp_path / "servo.snapshot.csv")), strict=True):
        assert (one.axis, one.start, one.figures) == (other.axis, other.start, other.figures)


def shaped() -> dict[str, NDArray[np.float64]]:
    """Samples of a shaft that follows a ramp of 2 rad in 0.2 s from 0.5 s on with a delay of 10 ms."""
    time = np.arange(0.0, 1.5, 0.005)
    reference, position = (2.0 * np.clip((time - start) / 0.2, 0.0, 1.0) for start in (0.5, 0.51))
    speed = np.random.default_rng(SEED).normal(0.0, 1.0, time.size)  # an inner loop
    return {
        TIME: time,
        "axis1.position": position,
        "axis1.position_ref": reference,
        "axis1.speed": speed,
        "axis1.speed_ref": speed,
    }


def test_the_lag_of_a_delayed_shaft(tmp_path: Path) -> None:
    (step,) = steps_of(curves_of(text(tmp_path / "run.csv", shaped())))
    assert step.start == pytest.approx(0.5)
    assert step.duration == pytest.approx(0.2)
    assert step.figures.lag == pytest.approx(0.01, abs=1e-6)
    assert step.figures.rise_time == pytest.approx(0.16, abs=1e-6)
    assert step.figures.tracking_max == pytest.approx(0.1)


def test_no_step_is_measured_across_a_gap_or_from_the_middle(tmp_path: Path) -> None:
    whole = shaped()
    time = whole[TIME]
    for kept in (time > 0.55, time < 0.72, (time < 0.55) | (time > 1.2)):
        columns = {name: column[kept] for name, column in whole.items()}
        assert steps_of(curves_of(text(tmp_path / "run.csv", columns))) == []


def test_a_run_without_steps_or_columns_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = {name: column[:50] for name, column in shaped().items()}
    assert main(["steps", str(text(tmp_path / "still.csv", still))]) == 2
    assert "no set-point changes" in capsys.readouterr().err
    del still["axis1.speed_ref"]
    assert main(["steps", str(text(tmp_path / "less.csv", still))]) == 2
    assert "axis1.speed_ref" in capsys.readouterr().err


def test_the_cogging_of_a_turning_shaft_has_its_order(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "spectrum.svg"
    end = float(list(curves_of(run).blocks())[-1][TIME][-1])
    span = ["--start", str(end - 7.0), "--end", str(end)]
    line, *_ = printed(capsys, "spectrum", str(run), "axis1.speed", *span, "-o", str(picture))
    assert picture.stat().st_size > 5_000
    assert line["order"] == pytest.approx(12.0, abs=0.05)
    assert line["frequency"] == pytest.approx(12.0 * TURNS, abs=0.2)


@pytest.mark.parametrize("frequency", [20.0, 33.33, 90.0])
def test_amplitude_and_frequency_of_a_sine_in_noise(tmp_path: Path, frequency: float) -> None:
    """Also between two bins, and with samples at uneven times."""
    random = np.random.default_rng(SEED)
    time = np.arange(0.0, 20.0, 0.002) + random.uniform(-1e-4, 1e-4, 10_000)
    value = 5.0 + 0.3 * np.sin(2.0 * math.pi * frequency * time) + random.normal(0.0, 0.1, time.size)
    path = text(tmp_path / "run.csv", {TIME: np.sort(time), "axis1.speed": value})
    (line,) = spectrum_of(curves_of(path), "axis1.speed").lines
    assert line.frequency == pytest.approx(frequency, abs=0.05)
    assert line.amplitude == pytest.approx(0.3, rel=0.03)


def test_noise_has_no_lines(tmp_path: Path) -> None:
    random = np.random.default_rng(SEED)
    time = np.arange(0.0, 60.0, 0.001)
    path = text(tmp_path / "run.csv", {TIME: time, "axis1.i_q": random.normal(0.0, 1.0, time.size)})
    assert spectrum_of(curves_of(path), "axis1.i_q").lines == ()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["axis1.nonsense"], "axis1.position"),
        (["axis1.speed", "--end", "0.1"], "are needed"),
        (["axis1.position", "--end", "0.5"], "is constant"),
    ],
)
def test_a_wrong_spectrum_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main(["spectrum", str(text(tmp_path / "run.csv", shaped())), *arguments]) == 2
    assert message in capsys.readouterr().err
