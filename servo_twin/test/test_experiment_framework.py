"""Common parts of the experiments: bounds, tables, pictures, summary, command line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import EXPERIMENTS, Experiment, levels, rig
from servo_twin.validation.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.validation.experiments.report import draw, table, update_summary

from servo_twin import cli

REFERENCE = "what the reference design says"


def outcome(name: str, *measured: float | None) -> Outcome:
    rows = tuple(Row(f"figure {k}", REFERENCE, value, "rpm", Bound(maximum=1.0)) for k, value in enumerate(measured))
    x = np.linspace(0.0, 1.0, 5)
    return Outcome(name, rows, (Panel("title", "x", "y", (Curve("line", x, x**2),)),), ("a note",))


class TestBounds:
    @pytest.mark.parametrize(
        ("bound", "inside", "outside"),
        [
            (Bound(maximum=2.0), [2.0, -9.0], [2.01, math.nan, None, math.inf]),
            (Bound(minimum=1.0), [1.0, 7.0], [0.99, math.nan, None]),
            (Bound(1.0, 2.0), [1.0, 1.5, 2.0], [0.9, 2.1]),
        ],
    )
    def test_a_bound_holds_inside_and_not_outside(
        self, bound: Bound, inside: list[float], outside: list[float | None]
    ) -> None:
        assert all(bound.holds(value) for value in inside)
        assert not any(bound.holds(value) for value in outside)

    def test_one_row_outside_its_bound_fails_the_outcome(self) -> None:
        assert outcome("a", 0.5, 1.0).agrees
        assert not outcome("a", 0.5, 1.1).agrees
        assert not outcome("a", 0.5, None).agrees


class TestReport:
    def test_table_marks_rows_that_do_not_agree(self) -> None:
        text = table(outcome("a", 0.5, 3.0, None))
        assert text.count("  yes") == 1
        assert text.count("  NO") == 2
        assert REFERENCE in text
        assert "none" in text
        assert "a note" in text

    def test_summary_keeps_other_experiments(self, tmp_path: Path) -> None:
        update_summary(tmp_path, [outcome("a", 0.5), outcome("b", 0.5)])
        path = update_summary(tmp_path, [outcome("a", 9.0)])
        rows = json.loads(path.read_text())
        assert {row["experiment"]: row["agrees"] for row in rows} == {"a": False, "b": True}

    def test_a_picture_is_written_to_a_new_folder(self, tmp_path: Path) -> None:
        draw(outcome("a", 0.5), tmp_path / "new" / "a.png")
        assert (tmp_path / "new" / "a.png").read_bytes().startswith(b"\x89PNG")


class TestLevels:
    @pytest.mark.parametrize(
        ("ideal", "registers", "agrees"), [(0.5, 1.0, True), (0.5, 1.1, False), (-0.5, 1.0, False), (0.5, None, False)]
    )
    def test_two_levels_agree_within_bound_and_difference(
        self, ideal: float, registers: float | None, agrees: bool
    ) -> None:
        """Each level is within the bound, and the levels agree within the permitted difference."""
        pair = levels.pairs(outcome("a", ideal), outcome("a", registers))[0]
        assert pair.agrees is agrees
        assert pair.difference == (None if registers is None else pytest.approx(registers - ideal))

    def test_figure_with_own_tolerance(self) -> None:
        rows = [
            Row("x", REFERENCE, value, "s", Bound(maximum=0.01), apart=apart)
            for value, apart in ((-0.5, 0.1), (-0.1, 0.5))
        ]
        pair = levels.pairs(*(Outcome("a", (row,), ()) for row in rows))[0]
        assert pair.difference_max == 0.5
        assert pair.agrees

    def test_overview_has_the_figure_with_the_largest_difference(self) -> None:
        pairs = levels.pairs(outcome("a", 0.5, 0.1), outcome("a", 0.6, 0.9)) + levels.pairs(
            outcome("b", 1), outcome("b", 1)
        )
        assert levels.overview(pairs).splitlines()[2:] == [
            "| `a` | 2 | 2 | figure 1 | 0.1 rpm | 0.9 rpm | <= 1 |",
            "| `b` | 1 | 1 | none differs |  |  |  |",
            "| all | 3 | 3 | | | | |",
        ]

    def test_documented_overview_adds_up(self) -> None:
        """The table in levels.md is that of ``servo-sim experiment levels``, with every experiment."""
        document = (Path(__file__).parents[1] / "doc" / "levels.md").read_text(encoding="utf-8")
        rows = [
            [cell.strip(" `") for cell in row.split("|")[1:4]] for row in document.splitlines() if row.startswith("| ")
        ]
        head, *entries, total = rows
        assert head == ["experiment", "figures", "agree"]
        assert [name for name, *_ in entries] == [name for name in EXPERIMENTS if name not in levels.NOT_COMPARED]
        assert total == ["all", *(str(sum(int(row[k]) for row in entries)) for k in (1, 2))]


class TestCommand:
    @pytest.fixture(autouse=True)
    def registry(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Two experiments that take no time: one agrees, one does not."""
        seen = {"good": 0.5, "bad": 2.0}
        for name, value in seen.items():

            def run(plant: PlantConfig, seed: int, name: str = name, value: float = value) -> Outcome:
                assert plant.axes
                return outcome(name, value * seed)

            monkeypatch.setitem(EXPERIMENTS, name, Experiment(name, f"{name} things\nmore", run))
        for name in set(EXPERIMENTS) - set(seen):
            monkeypatch.delitem(EXPERIMENTS, name)

    def test_exit_status_depends_on_the_outcome(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert cli.main(["experiment", "good"]) == 0
        assert cli.main(["experiment", "bad"]) == 1
        assert "does not agree: bad: figure 0" in capsys.readouterr().out
        assert cli.main(["experiment", "good", "--seed", "3"]) == 1

    def test_all_writes_the_folder(self, tmp_path: Path) -> None:
        assert cli.main(["experiment", "all", "--out", str(tmp_path)]) == 1
        assert {path.name for path in tmp_path.iterdir()} == {
            "good.png", "good.txt", "bad.png", "bad.txt", "summary.json",
        }  # fmt: skip

    def test_json_is_all_of_the_output(self, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
        picture = tmp_path / "p.png"
        assert cli.main(["experiment", "good", "--json", "--plot", str(picture)]) == 0
        assert json.loads(capsys.readouterr().out)[0]["experiment"] == "good"
        assert picture.is_file()

    @pytest.mark.parametrize("chosen", ["registers", "ideal", None])
    def test_level_of_the_boards(
        self, chosen: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        """The option has precedence over the environment, and the summary contains the level."""
        monkeypatch.setenv("SERVO_TWIN_LEVEL", "ideal" if chosen == "registers" else "registers")

        def run(plant: PlantConfig, seed: int) -> Outcome:
            with rig.fresh_board(plant, seed) as board:
                return outcome("bad", float(board.level != (chosen or "registers")))

        monkeypatch.setitem(EXPERIMENTS, "bad", Experiment("bad", "bad", run))
        option = ["--level", chosen] if chosen else []
        assert cli.main(["experiment", "bad", *option, "--out", str(tmp_path)]) == 0
        assert {row["level"] for row in json.loads((tmp_path / "summary.json").read_text())} == {chosen or "registers"}
        assert f"level {chosen or 'registers'}" in capsys.readouterr().out

    def test_levels_compares_every_figure_at_both_levels(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        def run(plant: PlantConfig, seed: int) -> Outcome:
            return outcome("bad", *([0.25] if rig.level() == "ideal" else [0.75, 0.5]))

        monkeypatch.setitem(EXPERIMENTS, "bad", Experiment("bad", "bad", run))
        assert cli.main(["experiment", "levels", "--out", str(tmp_path)]) == 1
        text = capsys.readouterr().out
        assert "2 of 3 figures agree at both levels" in text
        assert "does not agree: bad: figure 1\n" in text
        rows = {row["figure"]: row for row in json.loads((tmp_path / "levels.json").read_text())}
        assert rows["figure 0"] == {
            "experiment": "bad", "figure": "figure 0", "unit": "rpm",
            "difference": 0.5, "difference_max": 1.0, "agrees": True,
            "ideal": {"measured": 0.25, "bound": "<= 1", "agrees": True},
            "registers": {"measured": 0.75, "bound": "<= 1", "agrees": True},
        }  # fmt: skip
        assert rows["figure 1"]["ideal"] is None
        assert cli.main(["experiment", "levels", "--only", "good", "--out", str(tmp_path)]) == 0

    def test_help_describes_the_experiment(self, capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit):
            cli.main(["experiment", "bad", "--help"])
        assert "bad things" in capsys.readouterr().out

    def test_error_of_a_plant_is_a_result(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        def run(plant: PlantConfig, seed: int) -> Outcome:
            raise SimulationError("axis1: no movement seen")

        monkeypatch.setitem(EXPERIMENTS, "bad", Experiment("bad", "bad", run))
        assert cli.main(["experiment", "all", "--out", str(tmp_path)]) == 1
        assert "axis1: no movement seen" in capsys.readouterr().out
        rows = json.loads((tmp_path / "summary.json").read_text())
        assert {(row["experiment"], row["figure"]) for row in rows} == {("good", "figure 0"), ("bad", "can be run")}
