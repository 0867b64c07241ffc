"""Figures, pack and report of a commissioning."""

from __future__ import annotations

import json
import math
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.commissioning.checks import identified, turned
from servo_bridge.commissioning.figure import Figure, ImplausibleError, require
from servo_bridge.commissioning.pack import PROGRESS, Done, Pack, PackError
from servo_bridge.commissioning.report import page

SUBJECT: Final = {"axis": "axis1", "board": "servo 1", "voltage": 24.0}
DONE: Final = Done([Figure("offset", 0.1, "A", -0.2, 0.2, "shunts"), Figure("lag", 0.0)], ["a < b"], ["one.png"])

figures = st.builds(
    Figure,
    st.text(),
    st.floats(allow_infinity=True, allow_nan=True),
    st.text(),
    st.just(-math.inf) | st.floats(allow_nan=False, allow_infinity=False),
    st.just(math.inf) | st.floats(allow_nan=False, allow_infinity=False),
    st.text(),
)


@given(figures)
def test_a_figure_survives_its_document_and_is_judged_alike(figure: Figure) -> None:
    again = Figure.of_document(json.loads(json.dumps(figure.document(), allow_nan=False)))
    assert again.plausible == figure.plausible
    if math.isfinite(figure.value):
        assert again == figure


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.21, 0.21])
def test_the_first_implausible_figure_is_named_with_range_and_remedy(value: float) -> None:
    wrong = Figure("offset", value, "A", -0.2, 0.2, "check the shunts")
    with pytest.raises(ImplausibleError, match=r"offset is .* A, not -0\.2 \.\. 0\.2: check the shunts"):
        require([*DONE.figures, wrong, Figure("other", math.nan)])
    require(DONE.figures)


@pytest.mark.parametrize(("turns", "plausible"), [(1.0, True), (-1.0, False), (2.0, False), (0.0, False), (1.15, True)])
def test_one_turn_by_hand_shows_lines_and_direction(turns: float, plausible: bool) -> None:
    assert all(figure.plausible for figure in turned(5.0, 5.0 + turns * math.tau)) == plausible


@pytest.mark.parametrize(
    ("name", "value"), [("gain_ratio", 0.8), ("offset_alpha", 0.3), ("offset_beta", -0.3), ("delay", 1e-4)]
)
def test_every_estimate_of_the_board_is_judged(name: str, value: float) -> None:
    good = {"gain_ratio": 1.0, "offset_alpha": 0.0, "offset_beta": 0.0, "delay": 31e-6, "r_s": 5.0}
    found = {key: {"value": number} for key, number in good.items()}
    require(identified(found, 8.25, 62.5e-6))
    with pytest.raises(ImplausibleError):
        require(identified({**found, name: {"value": value}}, 8.25, 62.5e-6))


def test_a_pack_is_continued_with_the_same_subject_only(tmp_path: Path) -> None:
    Pack.opened(tmp_path / "pack", SUBJECT).keep("supply", DONE)
    again = Pack.opened(tmp_path / "pack", dict(SUBJECT))
    assert again.done == {"supply": DONE}
    with pytest.raises(PackError, match=r"voltage was 24\.0, now 12\.0; write another folder with --out"):
        Pack.opened(tmp_path / "pack", {**SUBJECT, "voltage": 12.0})
    again.forget(["supply", "tune"])
    assert Pack.opened(tmp_path / "pack", SUBJECT).done == {}


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"steps": {}}', '{"subject": {}, "steps": []}', '{"subject": {}, "steps": {"a": {}}}']
)
def test_a_damaged_pack_is_refused_with_its_name(tmp_path: Path, text: str) -> None:
    (tmp_path / PROGRESS).write_text(text, encoding="utf-8")
    with pytest.raises(PackError, match=rf"{PROGRESS} is damaged .*remove this one"):
        Pack.opened(tmp_path, SUBJECT)


class _Page(HTMLParser):
    """Text of a page, and its pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.pictures: list[str | None] = []

    def handle_data(self, data: str) -> None:
        self.texts.append(data.strip())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            self.pictures.append(dict(attrs)["src"])


def test_the_report_shows_figures_texts_pictures_and_why_it_ended(tmp_path: Path) -> None:
    pack = Pack(tmp_path, {**SUBJECT, "board": "<b>servo</b>"}, {"supply": DONE})
    parser: Any = _Page()
    parser.feed(page(pack, "supply: 3 V < 24 V"))
    for text in ("<b>servo</b>", "supply", "offset", "-0.2 .. 0.2", "a < b", "supply: 3 V < 24 V"):
        assert text in parser.texts, text
    assert parser.pictures == ["one.png"]
