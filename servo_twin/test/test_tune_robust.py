"""``servo-sim tune-robust``: candidates evaluated on the nominal plant and on the worst plant of a set."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.reading import load
from servo_twin.runner import Runner
from servo_twin.validation.sweep.robust import Candidates, Objective, Score, front, search
from servo_twin.validation.sweep.space import Space, Varied
from servo_twin.validation.sweep.trial import Figure, Trial

from servo_twin import cli

SMALL = Objective("f")
LARGE = Objective("f", "maximize")


def score(nominal: float, worst: float, violations: int = 0) -> Score:
    return Score({}, nominal, 0.0, worst, violations)


def trial(value: float | None, slack: float | None = None, problem: str = "") -> Trial:
    return Trial(0, {}, {} if problem else {"f": Figure(value, "", slack)}, problem)


def test_score_of_nominal_and_worst_plant() -> None:
    found = Score.of({"a": 1.0}, SMALL, [trial(2.0), trial(5.0), trial(3.5)])
    assert (found.nominal, found.mean, found.worst, found.violations) == (2.0, 3.5, 5.0, 0)
    assert Score.of({}, LARGE, [trial(2.0), trial(5.0), trial(1.0)]).worst == 1.0


def test_failed_trial_has_an_infinite_score() -> None:
    found = Score.of({}, SMALL, [trial(1.0, -0.1), trial(None, -math.inf), trial(None, problem="a fault")])
    assert found.violations == 3
    assert found.worst == math.inf
    assert Score.of({}, LARGE, [trial(1.0), trial(None, problem="a fault")]).worst == -math.inf


def test_front_has_no_dominated_candidate() -> None:
    scores = [score(1, 9), score(2, 5), score(3, 6), score(4, 3), score(5, 3), score(0, 1, violations=2)]
    kept = front(scores, SMALL, score(9, 9))
    assert [(s.nominal, s.worst) for s in kept] == [(4, 3), (2, 5), (1, 9)]
    kept = front(scores, LARGE, score(0, 0))
    assert [(s.nominal, s.worst) for s in kept] == [(1, 9), (3, 6), (5, 3)]


def _bowl(candidates: Sequence[Mapping[str, float]]) -> list[Score]:
    """Minimum of the worst score at 3, of the nominal score at 1; values above 4 are infeasible."""
    return [Score(dict(c), (c["x"] - 1.0) ** 2, 0.0, (c["x"] - 3.0) ** 2, int(c["x"] > 4.0)) for c in candidates]


def test_search_finds_the_front_reproducibly() -> None:
    tuned = [Varied.parse("x=-10..10")]
    today = _bowl([{"x": 0.0}])[0]
    first, again = (list(search(_bowl, tuned, SMALL, today, 48, 5)) for _ in range(2))
    assert first == again
    assert front(first, SMALL, today)[0].worst < 0.1
    assert sum(s.violations for s in first) < 16  # of 48; without the constraint 14 of 20 draws are forbidden


def test_given_levels_are_used() -> None:
    found = list(search(_bowl, [Varied.parse("x=1,3")], SMALL, score(0, 9), 16, 1))
    assert {s.candidate["x"] for s in found} == {1.0, 3.0}


def test_candidates_are_tested_on_the_nominal_plant_first(monkeypatch: pytest.MonkeyPatch) -> None:
    points: list[dict[str, float]] = []

    def kept(number: int, measure: str, base: object, point: dict[str, float], seed: int, level: str) -> Trial:
        points.append(point)
        return trial(1.0)

    monkeypatch.setattr("servo_twin.validation.sweep.robust.trial_at", kept)
    plants = Space.of([Varied.parse("p=5,6")], None, None, 1)
    work = Candidates("move", None, plants, "ideal", ({"x": 1.0}, {"x": 2.0}))  # type: ignore[arg-type]
    assert len(work.scores(SMALL, Runner(1), "trials")) == 2
    assert points == [{"x": x, **p} for x in (1.0, 2.0) for p in ({}, {"p": 5.0}, {"p": 6.0})]


WORDS = ["tune-robust", "move", "--level", "ideal", "--candidates", "8", "--plants", "2", "--workers", "2"]
TUNE = ["--tune", "servo.axis1.control.position_gain=*1,1.5"]
OVER = ["--over", "plant.axis1.inertia=*0.7..1.5"]


def test_a_tuned_file_is_better_and_can_be_sent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*WORDS, *TUNE, *OVER, "--minimize", "axis1 settling time", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    text = capsys.readouterr().out
    assert "present" in text
    assert "worst figure on 2 other plants:" in text
    configuration = load(tmp_path / "servo.toml", Catalogue.load())
    assert configuration.axes[0]("control.position_gain") == pytest.approx(90.0)
    assert configuration.axes[1]("control.position_gain") != pytest.approx(90.0)
    assert (tmp_path / "tune-robust.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([*TUNE, *OVER, "--minimize", "axis1 settling"], "no figure 'axis1 settling'; figures: both rotors found"),
        (["--tune", "plant.axis1.inertia=1,2", *OVER, "--minimize", "x"], "a plant value cannot be tuned"),
        (["--tune", "servo.axis1.control.position_gain=60+-5", *OVER, "--minimize", "x"], "a range or levels"),
    ],
)
def test_invalid_options_are_reported(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*WORDS, *words, "--out", str(tmp_path / "none")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
