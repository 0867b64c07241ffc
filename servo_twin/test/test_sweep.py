"""``servo-sim sweep``: values varied over many boards, results kept after an interruption, repeated trials."""

from __future__ import annotations

import csv
import importlib
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_msgs_py.runtime.claim import claimed
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments.outcome import Bound, Row
from servo_twin.validation.experiments.rig import at_level, fresh_board, prepared
from servo_twin.validation.sweep.command import sweep_of
from servo_twin.validation.sweep.space import Space, SpaceError, Varied, shuffled
from servo_twin.validation.sweep.store import RESULTS, Store, StoreError
from servo_twin.validation.sweep.summary import Summary
from servo_twin.validation.sweep.trial import Figure, Trial
from servo_twin.validation.sweep.variant import Base

from servo_twin import cli

PLANT = PlantConfig.load()
VARY = ("--vary", "plant.axis1.inertia=*0.5..2 log", "--vary", "plant.bus.u_source=20..28")


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "sweep.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# ---- varied values ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "ends"),
    [("a=1..3", (1.0, 3.0)), ("a=1..100 log", (1.0, 100.0)), ("a=1,2,5", (1.0, 5.0)), ("a=-2..2/5", (-2.0, 2.0))],
)
def test_ranges_and_lists_are_read(text: str, ends: tuple[float, float]) -> None:
    one = Varied.parse(text)
    assert (one.quantile(0.0), one.quantile(1.0)) == pytest.approx(ends)
    assert all(ends[0] <= one.quantile(k / 100) <= one.quantile((k + 1) / 100) + 1e-12 for k in range(100))


def test_quantiles_are_those_of_the_distribution() -> None:
    assert Varied.parse("a=1..100 log").quantile(0.5) == pytest.approx(10.0)
    assert Varied.parse("a=5+-2").quantile(0.5) == pytest.approx(5.0)
    assert Varied.parse("a=5+-2").quantile(0.8413) == pytest.approx(7.0, abs=1e-2)
    assert Varied.parse("a=1..16/5 log").levels == pytest.approx((1.0, 2.0, 4.0, 8.0, 16.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a", "write NAME=VALUES"),
        ("a=", "write NAME=VALUES"),
        ("a=3..1", "lower end is not below"),
        ("a=0..1 log", "requires values above 0"),
        ("a=0..1/1", "at least two"),
        ("a=1,x", "is not valid for VALUES"),
        ("a=nan", "not finite"),
        ("a=1+-0", "not above 0"),
    ],
)
def test_invalid_values_are_reported(text: str, message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        Varied.parse(text)


@given(st.integers(1, 3000), st.text(max_size=5))
def test_a_random_permutation_has_every_index_once(count: int, key: str) -> None:
    assert sorted(shuffled(k, count, key) for k in range(count)) == list(range(count))


def test_a_latin_hypercube_uses_every_part_of_each_range_once() -> None:
    space = Space.of([Varied.parse("a=0..1"), Varied.parse("b=10..20")], None, 500, 3)
    points = [space.point(k) for k in range(500)]
    for name, low, width in (("a", 0.0, 1.0), ("b", 10.0, 10.0)):
        cells = [math.floor((point[name] - low) / width * 500) for point in points]
        assert sorted(cells) == list(range(500))
    a, b = (np.array([point[name] for point in points]) for name in ("a", "b"))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.15


def test_a_grid_has_every_combination_once() -> None:
    space = Space.of([Varied.parse("a=1,2"), Varied.parse("b=1..3/3")], None, None, 0)
    points = {(p["a"], p["b"]) for p in map(space.point, range(space.count))}
    assert points == {(a, b) for a in (1.0, 2.0) for b in (1.0, 2.0, 3.0)}


def test_points_follow_from_the_seed() -> None:
    varied = [Varied.parse("a=0..1")]
    for method in ("latin", "random"):
        one, same, other = (Space.of(varied, method, 20, seed) for seed in (1, 1, 2))
        assert [one.point(k) for k in range(20)] == [same.point(k) for k in range(20)]
        assert [one.point(k) for k in range(20)] != [other.point(k) for k in range(20)]


@pytest.mark.parametrize(
    ("texts", "method", "count", "message"),
    [
        ([], None, 1, "no varied values"),
        (["a=1,2", "a=3,4"], None, None, "varied twice: a"),
        (["a=0..1"], "grid", None, "write a=LOW..HIGH/STEPS"),
        (["a=1,2"], "grid", 5, "omit the count"),
        (["a=0..1"], None, None, "requires --count"),
    ],
)
def test_an_invalid_space_is_refused(texts: list[str], method: Any, count: int | None, message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        Space.of([Varied.parse(text) for text in texts], method, count, 1)


# ---- variants --------------------------------------------------------------------------------------------------------

SERVO: dict[str, Any] = {
    "board": {"dead_time": 1e-6},
    "axis1": {"motor": {"r_s": 0.5}},
    "axis2": {"motor": {"r_s": 0.6}, "limits": {"current": 3.0}},
    "defaults": {"limits": {"current": 4.0, "speed": 100.0}},
}
BASE = Base(PLANT, SERVO)


def test_factors_are_relative_to_the_nominal_value() -> None:
    one = BASE.resolved(Varied.parse("plant.axis2.inertia=*0.5..2 log"))
    assert (one.quantile(0.0), one.quantile(1.0)) == pytest.approx((0.6e-5, 2.4e-5))
    assert BASE.resolved(Varied.parse("servo.axis1.limits.current=*2,3")).levels == (8.0, 12.0)
    assert BASE.resolved(Varied.parse("servo.axis2.limits.current=*2,3")).levels == (6.0, 9.0)


def test_a_plant_gets_its_values() -> None:
    plant = BASE.variant({"plant.axis2.inertia": 3e-5, "plant.bus.u_source": 20.0, "plant.ambient": 40.0}).plant
    assert (plant.axes[1].inertia, plant.bus.u_source, plant.ambient) == (3e-5, 20.0, 40.0)
    assert plant.axes[0] == PLANT.axes[0]


def test_one_axis_of_servo_toml_is_varied_and_the_other_keeps_the_default() -> None:
    servo = BASE.variant({"servo.axis1.limits.current": 2.0}).servo
    assert servo["axis1"]["limits"] == {"current": 2.0}
    assert servo["defaults"]["limits"]["current"] == 4.0
    assert "limits" not in SERVO["axis1"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("axis1.inertia", "must start with plant., servo. or param."),
        ("plant.axis1.inertya", r"plant\.axis1 has no 'inertya'; names: inertia"),
        ("plant.axis3.inertia", "plant has no 'axis3'"),
        ("plant.axis1.theta_start", "is not a number"),
        ("servo.axis1.limits.curent", "names: current"),
        ("param.i_q_limt[0]", "did you mean param.i_q_limit"),
        ("param.i_q_limit", "index of the axis missing"),
        ("param.i_q_limit[2]", r"elements 0 \.\. 1, not 2"),
    ],
)
def test_an_unknown_name_is_reported_with_similar_names(name: str, message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        BASE.resolved(Varied.parse(f"{name}=1,2"))


def test_boards_get_configuration_and_parameters() -> None:
    table = sweep_of(cli.parser().parse_args(["sweep", "move", "--vary", "servo.axis1.control.speed_bandwidth=30,60"]))
    variant = Base(PLANT, table.base.servo).variant(
        {"servo.axis1.control.speed_bandwidth": 30.0, "param.i_q_limit[1]": 1.5}
    )
    with at_level("ideal"):
        with Board(PLANT, level="ideal") as plain, prepared(variant.prepare), fresh_board(PLANT, 1) as board:
            assert board.read_words("config.checksum")[0] != plain.read_words("config.checksum")[0]
            assert board.read_words("config.checksum")[1] == plain.read_words("config.checksum")[1]
            assert board.read("param.i_q_limit") == pytest.approx([4.0, 1.5], abs=1e-3)
        with fresh_board(PLANT, 1) as board:
            assert board.read("param.i_q_limit") == pytest.approx([4.0, 4.0], abs=1e-3)


def test_a_value_that_the_board_refuses_is_a_problem() -> None:
    prepare = BASE.variant({"param.i_q_limit[0]": 100.0}).prepare
    with at_level("ideal"), prepared(prepare), pytest.raises(SimulationError, match=r"param.i_q_limit"):
        fresh_board(PLANT, 1)


# ---- figures ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("measured", "bound", "slack"),
    [
        (5.0, Bound(), None),
        (5.0, Bound(maximum=10.0), 0.5),
        (15.0, Bound(maximum=10.0), -0.5),
        (5.0, Bound(4.0, 10.0), 0.25),
        (-1.0, Bound(0.0, 0.0), -1.0),
        (None, Bound(), -math.inf),
        (math.nan, Bound(maximum=1.0), -math.inf),
    ],
)
def test_slack_is_the_distance_to_the_nearer_end(measured: float | None, bound: Bound, slack: float | None) -> None:
    figure = Figure.of(Row("a", "", measured, "", bound))
    assert figure.slack == (slack if slack is None else pytest.approx(slack))
    assert figure.inside is (slack is None or slack >= 0.0)


def test_worst_trials_are_named_first() -> None:
    trials = [Trial(k, {}, {"a": Figure(float(v), "", 10.0 - v)}) for k, v in enumerate([9, 14, 2, 11, 20, 3])]
    summary = Summary([*trials, Trial(6, {}, {}, "no rotor"), Trial(7, {}, {}, "no rotor")])
    figure = summary.figures["a"]
    assert figure.worst_trials() == [4, 1, 3]
    assert (figure.outside, figure.minimum, figure.maximum) == (3, 2.0, 20.0)
    assert figure.mean == pytest.approx(59 / 6)
    assert summary.problems == {"no rotor": (2, 6)}
    text = "\n".join(summary.lines("again"))
    assert "again 4  # a" in text
    assert "2 trials: no rotor\n    again 6" in text


# ---- results on disk -------------------------------------------------------------------------------------------------


def trial(number: int) -> Trial:
    return Trial(number, {"x": 0.1 * number}, {"f": Figure(1.0 / (number + 1), "s", None)})


def test_results_are_read_in_order(tmp_path: Path) -> None:
    with Store(tmp_path, {"a": 1}, 5, resume=False) as store:
        for number in (3, 0, 4):
            store.add(trial(number))
    os.truncate(tmp_path / RESULTS, 10**12)  # an incomplete line of any length
    with Store(tmp_path, {"a": 1}, 5, resume=True) as store:
        assert store.missing == [1, 2]
        store.add(trial(1))
        assert list(store) == [trial(k) for k in (0, 1, 3, 4)]


@given(st.integers(1, 400))
def test_truncated_line_loses_only_its_result(cut: int) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Store(folder, {}, 4, resume=False) as store:
            for number in range(4):
                store.add(trial(number))
        path = folder / RESULTS
        whole = path.read_bytes()
        path.write_bytes(whole[: max(len(whole) - cut, whole.index(b"\n") + 1)])
        kept = path.read_bytes().count(b"\n") - 1
        with Store(folder, {}, 4, resume=True) as store:
            assert list(store) == [trial(k) for k in range(kept)]
            for number in store.missing:
                store.add(trial(number))
            assert list(store) == [trial(k) for k in range(4)]


def test_a_result_that_is_interrupted_while_it_is_written_is_missing(tmp_path: Path) -> None:
    class Interrupted(Trial):
        def as_dict(self) -> dict[str, Any]:
            raise KeyboardInterrupt

    with Store(tmp_path, {}, 2, resume=False) as store:
        store.add(trial(0))
        with pytest.raises(KeyboardInterrupt):
            store.add(Interrupted(1, {}, {}))
        assert list(store) == [trial(0)]
        assert store.missing == [1]


def test_results_of_another_sweep_are_not_changed(tmp_path: Path) -> None:
    with Store(tmp_path, {"a": 1}, 5, resume=False) as store:
        store.add(trial(1))
    before = (tmp_path / RESULTS).read_bytes()
    with pytest.raises(StoreError, match="continue with --resume"):
        Store(tmp_path, {"a": 1}, 5, resume=False)
    with pytest.raises(StoreError, match="another sweep"):
        Store(tmp_path, {"a": 2}, 5, resume=True)
    assert (tmp_path / RESULTS).read_bytes() == before


# ---- the command -----------------------------------------------------------------------------------------------------


def sweep(*words: str) -> int:
    return cli.main(["sweep", "move", "--level", "ideal", *words])


def test_a_sweep_makes_table_picture_and_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep(*VARY, "--count", "6", "--workers", "2", "--out", str(tmp_path), "--parquet") == 0
    rows = rows_of(tmp_path)
    assert [row["trial"] for row in rows] == [str(k) for k in range(6)]
    assert all(0.4e-5 <= float(row["plant.axis1.inertia"]) <= 1.6e-5 for row in rows)
    assert all(float(row["axis1 settling time"]) > 0.0 for row in rows)
    assert (tmp_path / "sweep.png").stat().st_size > 10_000
    parquet: Any = importlib.import_module("pyarrow.parquet")
    table = parquet.read_table(tmp_path / "sweep.parquet").to_pylist()
    assert [row["axis1 settling time"] for row in table] == [float(row["axis1 settling time"]) for row in rows]
    assert "6 of 6 trials" in capsys.readouterr().out


def test_printed_command_repeats_a_trial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["sweep", "position", "--level", "ideal", "--vary", "plant.axis1.friction=*1,60", "--out", str(tmp_path)]
    cli.main(words)
    printed = capsys.readouterr().out
    command = next(line for line in printed.splitlines() if "--trial 1" in line)
    program, *again = shlex.split(command, comments=True)
    assert program == "servo-sim"
    assert cli.main(again) == 1
    text = capsys.readouterr()
    assert "plant.axis1.friction = 0.12" in text.out


def test_invalid_options_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        (["--vary", "plant.axis1.inertya=1,2"], "names: inertia"),
        ([*VARY, "--count", "5", "--trial", "5"], "no trial 5; trials: 0 .. 4"),
        (["--vary", "servo.axis1.motor.r_s=1,2", "--config", "none.toml"], "no such file: none.toml"),
    ):
        assert sweep(*words, "--out", str(tmp_path / "none")) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_results_of_a_running_sweep_are_not_changed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with claimed(tmp_path / RESULTS):
        assert sweep(*VARY, "--count", "5", "--out", str(tmp_path), "--resume") == 2
    assert f"{tmp_path / RESULTS} is used by another running program" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_interrupted_sweep_keeps_its_results_and_continues(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "servo_twin.cli", "sweep", "move", "--level", "ideal", *VARY, "--count", "100000"]
    command += ["--workers", "2", "--out", str(tmp_path)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60.0
    file = tmp_path / RESULTS
    while not (file.exists() and file.read_bytes().count(b"\n") > 5) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60.0)
    assert process.returncode == 130, err
    assert "and --resume" in out
    kept = rows_of(tmp_path)
    assert len(kept) >= 5

    head = json.loads(file.read_text().splitlines()[0])
    assert head["space"]["count"] == 100000
    process = subprocess.Popen([*command, "--resume"], stdout=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 60.0
    while file.read_bytes().count(b"\n") <= len(kept) + 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60.0)
    after = {row["trial"]: row for row in rows_of(tmp_path)}
    assert len(after) > len(kept)
    assert all(after[row["trial"]] == row for row in kept)
