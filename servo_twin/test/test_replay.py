"""Replay of recorded runs: the first divergence and its cause, and what a recording lacks."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.board_description import DEFAULT_BOARD
from servo_msgs_py.run_file.reader import RunReader
from servo_msgs_py.run_file.run_info import RunInfo, VirtualBoard
from servo_tuning.reading import SERVO_TOML
from servo_twin.board import ELF_MARK, Board, build_of
from servo_twin.diagnosis.board_pair import Motion
from servo_twin.plant import PlantConfig
from servo_twin.runs.command import main
from servo_twin.runs.recorded import Contents, RunError
from servo_twin.runs.replay import WhatIf, model_of
from servo_twin.servo_config import ServoConfig, servo_table
from servo_twin.validation.simulated_run import SimulatedRun
from servo_twin.view.recording import read_scalars

import servo_twin
from servo_msgs_py import topics

SEED = 7


def record(
    path: Path,
    seconds: float = 4.0,
    change: Callable[[SimulatedRun], None] | None = None,
    after: float = 0.0,
    plant: PlantConfig | None = None,
    seed: int = SEED,
    **options: Any,
) -> int:
    """Record a run: enable, motion, a change, motion; returns the tick of the change."""
    with SimulatedRun(path, Board(plant, seed=seed, level="ideal"), seed=seed, **options) as run:
        run.enable()
        motion = Motion(run, seed)
        list(motion.run(seconds))
        tick = run.real.tick
        if change is not None:
            change(run)
        list(motion.run(after))
        return tick


def replay(path: Path, capsys: pytest.CaptureFixture[str], *options: str, status: int) -> Any:
    assert main(["replay", str(path), "--json", *options]) == status
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def equal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "equal.mcap"
    record(path, loss=0.01)
    return path


def test_an_equal_board_repeats_the_run_bit_for_bit(equal: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = replay(equal, capsys, status=0)
    assert result["identical"]
    assert not result["departures"]
    (stretch,) = result["stretches"]
    assert stretch["exact"]
    assert stretch["from"]["time"] < 0.02
    assert stretch["to"]["time"] > 4.0
    assert result["verdict"].startswith("identical bit for bit over")


def test_parameters_written_in_motion_are_repeated_at_their_tick(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def limit(run: SimulatedRun) -> None:
        run.write("param.i_q_limit", [0.6, 0.8])
        run.sample()
        run.report_parameters()

    record(tmp_path / "run.mcap", change=limit, after=2.0)
    result = replay(tmp_path / "run.mcap", capsys, status=0)
    (stretch,) = result["stretches"]
    assert stretch["exact"]
    assert stretch["to"]["time"] > 6.0


def test_the_first_sample_after_a_change_is_named_with_its_cause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def rub(run: SimulatedRun) -> None:
        run.board.set_plant("axis2.friction", 2.1 * run.board.plant.axes[1].friction)

    tick = record(tmp_path / "run.mcap", change=rub, after=4.0)
    result = replay(tmp_path / "run.mcap", capsys, status=1)
    assert result["first"]["exact"]
    assert 0 < result["first"]["tick"] - tick <= 18 * 8
    (finding,) = result["findings"]
    assert (finding["axis"], finding["changes"]) == ("axis2", ["friction"])
    assert result["before"]["axis2.friction"]["value"] == pytest.approx(1.0, abs=0.05)
    assert result["after"]["axis2.friction"]["value"] == pytest.approx(2.1, abs=0.1)
    ticks = [one["differs"]["tick"] for one in result["departures"]]
    assert ticks == sorted(ticks)
    assert result["departures"][0]["variable"].startswith("axis2.")
    assert main(["replay", str(tmp_path / "run.mcap")]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(f"from tick {result['first']['tick']}, ")
    assert "axis2 friction 2.1" in last


def test_a_fault_does_not_hide_the_change_that_caused_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def magnetise(run: SimulatedRun) -> None:
        run.board.set_plant("axis1.psi_m", 1.55 * run.board.plant.axes[0].psi_m)

    record(tmp_path / "late.mcap", change=magnetise, after=8.0, seed=12)
    result = replay(tmp_path / "late.mcap", capsys, status=1)
    assert "axis1.faults" in {one["variable"] for one in result["departures"]}
    (finding,) = result["findings"]
    assert (finding["axis"], finding["changes"]) == ("axis1", ["flux"])
    record(tmp_path / "early.mcap", change=magnetise, after=2.0, seed=8)  # 0.09 s after the change
    result = replay(tmp_path / "early.mcap", capsys, status=1)
    assert not result["findings"]
    assert result["controller"] is None
    assert "fault ANGLE_MISMATCH of axis1" in result["verdict"]


def test_a_board_of_unknown_kind_is_compared_within_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "run.mcap", info=False)
    result = replay(tmp_path / "run.mcap", capsys, "--seed", "3", status=0)
    assert not result["stretches"][0]["exact"]
    assert any("no /servo/run_info" in note for note in result["notes"])


def test_a_heavy_shaft_is_named_within_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = PlantConfig.load()
    record(tmp_path / "run.mcap", 8.0, plant=plant.with_axis(0, inertia=1.3 * plant.axes[0].inertia), info=False)
    result = replay(tmp_path / "run.mcap", capsys, status=1)
    (finding,) = result["findings"]
    assert (finding["axis"], finding["changes"]) == ("axis1", ["inertia"])
    assert result["after"]["axis1.inertia"]["value"] == pytest.approx(1.3, abs=0.05)


def test_what_if_the_friction_were_larger(equal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text(f"[axis1]\nfriction = {2.0 * PlantConfig.load().axes[0].friction}\n")
    result = replay(equal, capsys, "--plant", str(plant), status=1)
    assert result["after"]["axis1.friction"]["value"] == pytest.approx(0.5, abs=0.1)


def test_what_if_the_speed_loop_were_slower(equal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "servo.toml"
    text = SERVO_TOML.read_text()
    config.write_text(text.replace("speed_bandwidth   = 75.0", "speed_bandwidth   = 60.0"))
    result = replay(equal, capsys, "--config", str(config), status=1)
    assert result["first"]["time"] > 0.1  # not before the axes are enabled
    assert result["controller"] == "axis1"
    assert "the controller of axis1 differs (configuration or parameter)" in result["verdict"]
    replay(equal, capsys, "--config", str(SERVO_TOML), status=0)


@pytest.mark.slow
def test_a_changed_member_of_the_configuration_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, place = ServoConfig.of_table(servo_table()), list(AxisConfigTable.load().members).index("position_gain")
    blocks = [list(block) for block in config.blocks]
    blocks[1][place] = round(1.3 * blocks[1][place])
    servo = replace(config, blocks=tuple(map(tuple, blocks)))
    with SimulatedRun(tmp_path / "run.mcap", Board(seed=SEED, level="ideal", servo=servo), seed=SEED) as run:
        run.enable()
        list(Motion(run, SEED).run(4.0))
    result = replay(tmp_path / "run.mcap", capsys, status=1)
    found = result["configuration"]
    assert (result["controller"], found["axis"], found["member"]) == ("axis2", "axis2", "position_gain")
    assert found["found"] == pytest.approx(1.3 * found["recorded"], rel=0.03)
    assert "the configuration differs, axis2 position_gain 1.3 times" in result["verdict"]


@pytest.mark.parametrize(
    ("without", "note"),
    [
        (topics.PARAMETERS, "the defaults are assumed"),
        (topics.TUNING, "the one compiled in is assumed"),
    ],
)
def test_what_is_missing_is_said_and_the_rest_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], without: str, note: str
) -> None:
    record(tmp_path / "run.mcap", 1.0, without=[without])
    result = replay(tmp_path / "run.mcap", capsys, status=0)
    assert any(f"/servo/{without}" in text and note in text for text in result["notes"])


def test_without_commands_only_the_time_before_them_is_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run.mcap", 3.0, without=[topics.COMMANDS_APPLIED])
    result = replay(tmp_path / "run.mcap", capsys, status=0)
    assert result["compared"]["seconds"] < 0.2
    assert any("missing reports of 1 applied command" in note for note in result["notes"])


def test_a_recording_without_telemetry_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "run.mcap", 0.5, without=[topics.SNAPSHOT])
    assert main(["replay", str(tmp_path / "run.mcap")]) == 2
    assert "contains no telemetry of a board (/servo/snapshot) but /servo/" in capsys.readouterr().err
    assert main(["replay", str(tmp_path / "none.mcap")]) == 2


def test_ticks_count_when_the_clock_of_the_recording_jumps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def jump(run: SimulatedRun) -> None:
        run.jump_ns = -3_600_000_000_000

    record(tmp_path / "run.mcap", 1.0, jump, 1.0)
    result = replay(tmp_path / "run.mcap", capsys, status=0)
    assert len(result["stretches"]) == 1
    assert result["stretches"][0]["exact"]
    assert any("the clock of the recording jumps by -3600.0 s" in note for note in result["notes"])


def test_a_lost_command_ends_a_stretch_and_the_next_one_begins_at_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def lose(run: SimulatedRun) -> None:
        run.real.write("cmd.quick_stop", [1, 0], 1)  # not reported
        run.sample()
        run.write("cmd.quick_stop", [1.0, 1.0])
        for _ in range(150):
            run.sample()
        run.write("cmd.enable", [1.0, 1.0])

    record(tmp_path / "run.mcap", 1.0, lose, 1.0)
    result = replay(tmp_path / "run.mcap", capsys, status=0)
    first, *later = result["stretches"]
    assert first["exact"]
    assert "missing reports" in first["end"]
    assert later
    assert not any(one["exact"] for one in later)


def test_both_runs_and_the_residual_are_written(
    equal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = {suffix: tmp_path / f"replay{suffix}" for suffix in (".mcap", ".rrd", ".json")}
    options = [option for path in outputs.values() for option in ("-o", str(path))]
    result = replay(equal, capsys, *options, status=0)
    assert json.loads(outputs[".json"].read_text()) == result
    counts = Counter(record.topic for record in RunReader(outputs[".mcap"]).records())
    assert counts["/servo/snapshot"] == counts["/twin/snapshot"] == result["compared"]["samples"]
    assert counts["/twin/residual"] > 100
    times, residuals = read_scalars(outputs[".rrd"], "/plot/axis1/residual/position")
    assert len(times) == result["compared"]["samples"]
    assert not residuals.any()
    assert main(["replay", str(equal), "-o", "run.txt"]) == 2


def test_another_build_is_taken_from_its_checkout(
    equal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkout = Path(servo_twin.__file__).parents[2]
    assert replay(equal, capsys, "--firmware", str(checkout), status=0)["other_build"] == ""
    other = tmp_path / "_native.so"
    own = Path(build_of(DEFAULT_BOARD, "ideal").file).read_bytes()
    other.write_bytes(own + b"other")  # the same code with another hash
    result = replay(equal, capsys, "--firmware", str(other), status=0)
    assert result["verdict"].startswith("another build; identical bit for bit")
    assert result["notes"][0] == result["other_build"]
    assert main(["replay", str(equal), "--firmware", str(tmp_path)]) == 2
    assert "run `make build` there" in capsys.readouterr().err


def test_a_run_of_another_board_is_refused() -> None:
    info = RunInfo(board={"name": "servo/mine", "hardware": "mine"})
    with pytest.raises(RunError, match="'mine' is not the board"):
        model_of(Contents("/servo", Counter(), info, {}, ()), WhatIf())


def test_a_run_of_another_program_is_named() -> None:
    virtual = VirtualBoard(level="registers", build=f"{build_of(DEFAULT_BOARD, 'registers').build}{ELF_MARK}{'a' * 64}")
    found = model_of(Contents("/servo", Counter(), RunInfo(virtual_board=virtual), {}, ()), WhatIf()).other_build
    assert found is not None
    assert "another program (aaaaaaaa, here the compiled firmware); --elf" in found
