"""``servo-sim``: runs in simulated time from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from servo_twin.board import Board
from servo_twin.cli import main
from servo_twin.level import ELF_VARIABLE
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError, enable, move, turns


def test_a_move_of_five_turns_arrives_without_overshoot(capsys: pytest.CaptureFixture[str]) -> None:
    """Five boards, as the rest position within the friction is random: of 160 moves some 5 % overshoot by three counts
    and may rest there, and of 80 moves 7 % creep over the last counts for more than half a second."""
    beyond, resting, settling = [], [], []
    for seed in range(3, 8):
        assert main(["move", "--seed", str(seed), "--json"]) == 0
        figures = json.loads(capsys.readouterr().out)
        assert 0.0 < figures["search_time"] < 1.2
        for result in figures["moves"]:
            assert result["target"] == 20000
            assert abs(result["reached"] - 20000) <= 2
            assert result["speed_max"] < 315.0
            settling.append(result["settling_time"])
            beyond.append(result["overshoot"])
            resting.append(result["steady_state"])
    assert len(beyond) == 10
    assert max(beyond + resting) <= 3
    assert max(settling) < 1.5
    assert sorted(settling)[6] < 0.5  # probability that four of ten moves are above: 0.5 %
    for counts in (sorted(beyond), sorted(resting)):
        assert counts[7] <= 2  # probability that three of ten moves are above: 1 %


def test_output_depends_only_on_the_seed(capsys: pytest.CaptureFixture[str]) -> None:
    texts = []
    for seed in ("5", "5", "6"):
        assert main(["move", "--seed", seed, "--axis", "1", "--turns", "0.5", "--json"]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] != texts[2]


def test_a_too_short_recording_of_a_move_is_not_settled(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["move", "--turns", "20", "--time", "0.1"]) == 1
    assert "not settled" in capsys.readouterr().out


def test_the_plot_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "move.png"
    assert main(["move", "--turns", "0.1", "--time", "0.3", "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_info_shows_the_plant_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text("[axis2]\ninertia = 3.0e-5\n")
    assert main(["info", "--plant", str(plant), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["axes"][1]["inertia"] == 3.0e-5
    assert main(["info"]) == 0
    assert "capacitance" in capsys.readouterr().out


def test_bench_prints_real_time_factor(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--time", "0.2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["real_time_factor"] > 0.0


@pytest.mark.parametrize(
    ("content", "message"),
    [("[axis1]\ninertia = -1", "inertia"), ("[axis9]\nr_s = 1", "axis9"), ("not toml", "plant")],
)
def test_an_invalid_plant_file_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, message: str
) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text(content)
    assert main(["move", "--plant", str(plant)]) == 2
    assert message in capsys.readouterr().err


INPUTS = [
    "info --plant",
    "info --elf",
    "export --fmu x.fmu --config",
    "export --fmu x.fmu --plant",
    "identify --config",
    "identify --recording",
    "sweep move --vary servo.axis1.motor.r_s=1,2 --config",
    "diagnose --thresholds",
    "core-speed --core",
    "core-speed --measured",
]


@pytest.mark.parametrize("words", INPUTS)
@pytest.mark.parametrize("content", [None, b"[", b"x = 1\n", b"\xff\xfe"])
def test_an_input_that_cannot_be_used_is_one_line_with_its_name(
    words: str,
    content: bytes | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(ELF_VARIABLE, "")  # restored at the end: the option sets it
    file = tmp_path / "[1] #2"
    if content is not None:
        file.write_bytes(content)
    assert main([*words.split(), str(file)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("servo-sim: ")
    assert str(file) in error
    assert error.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} <= {file.name}


def test_a_locked_shaft_is_reported() -> None:
    with Board(PlantConfig.load(), seed=2) as board:
        board.lock_shaft(1)
        with pytest.raises(SimulationError, match="axis2: ROTOR_SEARCH"):
            enable(board)


def test_only_the_named_axis_moves() -> None:
    with Board(seed=7) as board:
        enable(board)
        before = board.read_words("axis1.position")[0]
        results, log = move(board, {1: turns(-2.0)}, 0.8)
        assert [r.axis for r in results] == ["axis2"]
        assert abs(results[0].reached + 8000) <= 2
        assert abs(int(log["axis1.position"][-1]) - before) <= 2


@pytest.mark.parametrize(
    ("value", "text"),
    [("0", "'0' is too small; write a number above 0"), ("-1", "'-1' is too small")]
    + [(value, f"'{value}' is not a finite number") for value in ("nan", "inf", "soon")],
)
@pytest.mark.parametrize("verb", ["move", "bench"])
def test_an_invalid_time_is_refused(verb: str, value: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([verb, "--time", value])
    assert end.value.code == 2
    assert text in capsys.readouterr().err


def test_an_interruption_is_quiet(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("servo_twin.cli.enable", interrupted)
    assert main(["bench"]) == 130
    assert capsys.readouterr().err == ""
