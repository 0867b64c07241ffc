"""Figures of the timing: a right trace agrees, each error violates its own row."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_twin.board import TRACE_ENTRY as ENTRY
from servo_twin.validation.experiments.outcome import Row
from servo_twin.validation.timing import deadlines, picture
from servo_twin.validation.timing.chip_map import LOOPS, SLOTS, START_STEPS, VECTOR_M1, VECTOR_M2, VECTOR_START
from servo_twin.validation.timing.figures import pwm_cycle, start
from servo_twin.validation.timing.trace import ChipTrace, Kind

FIRMWARE = Path(__file__).parents[2] / "firmware"
PERIOD = 6250
HALF = PERIOD // 2
COUNT = 40  # periods
FIRST, NEXT = 50, 30  # clocks from a trigger to the first pair, and from pair to pair
DEAD = 100
MCTRL = (0xE6C4, 0xE7C4)
RELEASE, LENGTH = 1000, 1200  # of a loop: clocks from its begin to the release of the duties, and to its end
M1_BEGIN = 260  # from the start of the counter
Entry = tuple[int, int, int, int]
Mistake = Callable[[list[Entry]], list[Entry]]


def ideal() -> list[Entry]:
    """The sequence of F34; phase a at a quarter, b at a half, c at three quarters of the period."""
    entries: list[Entry] = []

    def add(clock: int, kind: Kind, a: int, b: int = 0) -> None:
        entries.append((clock, int(kind), a, b))

    for k in range(COUNT):
        for module, origin in ((0, k * PERIOD), (1, k * PERIOD + HALF)):
            for sm, high in enumerate((PERIOD // 4, PERIOD // 2, 3 * PERIOD // 4)):
                submodule = 4 * module + sm
                add(origin, Kind.CYCLE, submodule, 0x10000 - HALF)
                up, down = origin + (PERIOD - high) // 2, origin + (PERIOD + high) // 2
                add(up, Kind.GATES, submodule, 0)
                add(up + DEAD, Kind.GATES, submodule, 1)
                add(down, Kind.GATES, submodule, 0)
                add(down + DEAD, Kind.GATES, submodule, 2)
                add(origin + HALF, Kind.LOAD, submodule)
            trigger = origin + 60
            add(trigger, Kind.SYNC, 0, 1)
            for pair in range(3):
                clock = trigger + FIRST + pair * NEXT
                for converter in range(2):
                    add(clock, Kind.SAMPLE, 8 * converter + 3 * module + pair, pair)
            vector, begin = (VECTOR_M1, origin + M1_BEGIN) if module == 0 else (VECTOR_M2, origin + 232)
            if module == 1:
                add(origin + 230, Kind.SCAN_END, 0)
            add(begin, Kind.ENTER, vector, 1)
            add(begin + RELEASE, Kind.WRITE, MCTRL[module], 0x0707)
            add(begin + LENGTH, Kind.LEAVE, vector)
    return entries


def trace(entries: list[Entry]) -> ChipTrace:
    return ChipTrace(np.array(sorted(entries, key=lambda entry: entry[0]), dtype=ENTRY))


def wrong(rows: list[Row]) -> set[str]:
    return {row.name for row in rows if not row.agrees}


def test_correct_timing_agrees() -> None:
    rows = pwm_cycle(trace(ideal()))
    assert wrong(rows) == set()
    by_name = {row.name: row.measured for row in rows}
    assert by_name["motor 2 behind motor 1, maximum"] == pytest.approx(180.0)
    assert by_name["motor 1: currents after the centre, maximum"] == pytest.approx(
        (60 + FIRST - DEAD / 2) * 0.01, abs=0.01
    )


def shift(kind: Kind, marks: set[int], clocks: int) -> Mistake:
    """Shift the entries of this kind whose first argument is one of `marks`."""
    return lambda entries: [
        (clock + clocks if which == kind and a in marks else clock, which, a, b) for clock, which, a, b in entries
    ]


def without(kind: Kind, a: int) -> Mistake:
    return lambda entries: [entry for entry in entries if not (entry[1] == kind and entry[2] == a)]


def longer(vector: int, clocks: int) -> Mistake:
    return shift(Kind.LEAVE, {vector}, clocks)


@pytest.mark.parametrize(
    ("mistake", "row"),
    [
        (shift(Kind.CYCLE, {4, 5, 6}, 10), "motor 2 behind motor 1, maximum"),
        (shift(Kind.CYCLE, {1}, 1), "motor 1: counters apart"),
        (shift(Kind.SAMPLE, {0, 8}, 150), "motor 1: currents after the centre, maximum"),
        (shift(Kind.SAMPLE, {0, 8}, -70), "motor 1: currents after the centre, minimum"),
        (shift(Kind.SAMPLE, {4, 12}, 150), "motor 1: offsets after the centre, maximum"),
        (shift(Kind.SAMPLE, {11}, 3), "scans with both converters together"),
        (without(Kind.SAMPLE, 4), "scans with six pairs in order"),
        (shift(Kind.SAMPLE, {0, 1, 2, 8, 9, 10}, 2000), "pause after the third pair, minimum"),
        (shift(Kind.ENTER, {VECTOR_M1}, -100), "M1 begins after its data, minimum"),
        (shift(Kind.SCAN_END, {0}, 100), "M2 begins after its data, minimum"),
        (longer(VECTOR_M2, 2000), "M1 and M2 at the same time"),
        (without(Kind.ENTER, VECTOR_M2), "M2 per PWM period"),
        (shift(Kind.SAMPLE, {3, 11}, 200), "periods with t0, t1, t2, t3 in order"),
    ],
)
def test_every_error_is_in_its_row(mistake: Mistake, row: str) -> None:
    assert row in wrong(pwm_cycle(trace(mistake(ideal()))))


def test_an_empty_trace_agrees_with_nothing() -> None:
    rows = pwm_cycle(trace([]))
    assert wrong(rows) >= {row.name for row in rows} - {"M1 and M2 at the same time"}


# ---- deadlines -------------------------------------------------------------------------------------------------------


def margins(entries: list[Entry]) -> dict[str, float | None]:
    return {row.name: row.measured for row in deadlines.rows(trace(entries), M1_BEGIN)}


def test_margin_from_sample_to_load() -> None:
    """Every kind of handler (slow loop, protection, monitors, supervision, latch) in both loops."""
    due = HALF - 60 - FIRST
    for name, begin in (("M1", M1_BEGIN), ("M2", 232)):
        remaining = HALF - begin - RELEASE
        for kind in SLOTS.values():
            assert margins(ideal())[f"{name} {kind}, minimum margin"] == pytest.approx(100.0 * remaining / due), (
                name + kind
            )
    assert margins(ideal())["core busy"] == pytest.approx(100.0 * 2 * LENGTH / PERIOD, abs=1.0)
    assert wrong(deadlines.rows(trace(ideal()), M1_BEGIN)) == set()


def test_picture_shows_the_margin_of_each_loop() -> None:
    """A missed load is drawn as a negative bar of its delay."""
    for loop, begin in zip(LOOPS, (M1_BEGIN, 232), strict=True):
        drawn = picture.margins(trace(ideal()), loop)
        assert drawn.shape[0] >= COUNT - 2
        assert set(np.diff(drawn)[:, 0]) == {HALF - begin - RELEASE}
    late = shift(Kind.WRITE, {MCTRL[0]}, HALF - M1_BEGIN - RELEASE + 1)(longer(VECTOR_M1, HALF)(ideal()))
    assert set(np.diff(picture.margins(trace(late), LOOPS[0]))[:, 0]) == {-1}


def test_slots_are_those_of_the_firmware() -> None:
    """Compared with the cases of its two switch statements."""
    text = (FIRMWARE / "app" / "servo.c").read_text()
    values = {"SERVO_SLOW_PERIODS": "8"} | dict(re.findall(r"#define (SLOT_\w+) (\w+|\(.*?\))(?: |$)", text, re.M))

    def value(expression: str) -> int:
        while names := re.findall(r"[A-Z]\w+", expression):
            expression = expression.replace(names[0], values[names[0]])
        return int(eval(re.sub(r"(\d)U", r"\1", expression).replace("/", "//")))

    assert {value(case) for case in re.findall(r"case (SLOT_\w+(?: \+ 1U)?):", text)} == set(SLOTS)


def at_period(slot: int, mistake: Mistake) -> Mistake:
    """Apply a mistake only in one PWM period of each slow tick; the first M1 is that of period 1."""

    def do(entries: list[Entry]) -> list[Entry]:
        def chosen(entry: Entry) -> bool:
            return (entry[0] // PERIOD + 1) % 8 == slot

        return [*(e for e in entries if not chosen(e)), *mistake([e for e in entries if chosen(e)])]

    return do


def test_missed_load_is_a_negative_margin() -> None:
    """Duties released just after their load in one kind of handler: only its row fails."""
    late = at_period(4, shift(Kind.WRITE, {MCTRL[0]}, HALF - M1_BEGIN - RELEASE + 1))
    longer_m1 = at_period(4, longer(VECTOR_M1, HALF - M1_BEGIN - LENGTH + 10))
    entries = late(longer_m1(ideal()))
    assert margins(entries)["M1 with current monitors, minimum margin"] == pytest.approx(-100.0 / (HALF - 60 - FIRST))
    assert wrong(deadlines.rows(trace(entries), M1_BEGIN)) == {"M1 with current monitors, minimum margin"}


def test_late_begin_reduces_the_margin() -> None:
    marks = {VECTOR_M2, MCTRL[1]}
    entries = [(c + 1400 if a in marks and k != Kind.SAMPLE else c, k, a, b) for c, k, a, b in ideal()]
    assert "M2 with protection, minimum margin" in wrong(deadlines.rows(trace(entries), M1_BEGIN))


def without_duties(entries: list[Entry]) -> list[Entry]:
    """No release in any M1; in one kind of handler M1 lasts beyond the load."""
    return at_period(4, longer(VECTOR_M1, HALF))(without(Kind.WRITE, MCTRL[0])(entries))


def test_duties_that_are_never_released_are_late() -> None:
    assert "M1 with current monitors, minimum margin" in wrong(deadlines.rows(trace(without_duties(ideal())), M1_BEGIN))


def test_a_loop_without_outputs_has_no_deadline() -> None:
    """After the outputs are off, if other handlers of its kind have a deadline."""
    outputs = LOOPS[0].outputs
    entries = [entry for entry in ideal() if entry[0] < 16 * PERIOD]
    later = [(c + 16 * PERIOD, k, a, b) for c, k, a, b in without_duties(entries)]
    off = (16 * PERIOD, int(Kind.WRITE), outputs, 0)
    on = (16 * PERIOD, int(Kind.WRITE), outputs, 0x770)
    assert wrong(deadlines.rows(trace([*entries, off, *later]), M1_BEGIN)) == set()
    assert "M1 with current monitors, minimum margin" in wrong(deadlines.rows(trace([*entries, on, *later]), M1_BEGIN))


def test_a_nested_interrupt_is_counted_once() -> None:
    entries = ideal()
    nested = [
        extra
        for clock, kind, a, _ in entries
        if kind == Kind.ENTER and a == VECTOR_M1
        for extra in ((clock + 100, int(Kind.ENTER), 52, 2), (clock + 300, int(Kind.LEAVE), 52, 0))
    ]
    assert deadlines.busy(trace(entries + nested)) == deadlines.busy(trace(entries))


def test_a_trace_without_handlers_has_only_the_row_of_the_core() -> None:
    assert list(margins([])) == ["core busy"]


def beginning() -> list[Entry]:
    """Power-on: the start interrupt between motor 2's sampling point and the end of the period, then the sequence."""
    begin = -500
    entries = [(begin + 600, int(Kind.ENTER), VECTOR_START, 1)]
    entries += [
        (begin + 610 + 2 * k, int(Kind.WRITE), address, value) for k, (_, address, value) in enumerate(START_STEPS)
    ]
    entries.append((begin + 700, int(Kind.LEAVE), VECTOR_START, 0))
    return entries + [(clock + 1000, kind, a, b) for clock, kind, a, b in ideal()]


def test_correct_start_agrees() -> None:
    assert wrong(start(trace(beginning()))) == set()


@pytest.mark.parametrize(
    ("mistake", "row"),
    [
        (without(Kind.ENTER, VECTOR_START), "start interrupt"),
        (lambda e: [*e, (90_000, 8, VECTOR_START, 1), (90_010, 9, VECTOR_START, 0)], "start interrupt"),
        (without(Kind.WRITE, START_STEPS[2][1]), "steps of the start in order"),
        (shift(Kind.WRITE, {START_STEPS[3][1]}, -20), "steps of the start in order"),
        (lambda e: [*e, (500, int(Kind.SAMPLE), 3, 0)], "first pair that is sampled"),
        (lambda e: [*e, (1, int(Kind.ENTER), VECTOR_M1, 1)], "M1 or M2 before the start"),
        (lambda e: [*e, (900, int(Kind.ENTER), VECTOR_M2, 1)], "M1, M2, M1, ... from the start on"),
    ],
)
def test_error_of_the_start_is_in_its_row(mistake: Mistake, row: str) -> None:
    assert row in wrong(start(trace(mistake(beginning()))))


def test_intervals_that_began_before_the_recording_are_left_out() -> None:
    gates: NDArray[np.void] = np.array(
        [(10, 3, 0, 1), (20, 3, 0, 0), (30, 3, 0, 1), (45, 3, 0, 0), (50, 3, 0, 1)], dtype=ENTRY
    )
    assert ChipTrace(gates).intervals(0, 0).tolist() == [[30, 45]]
    assert ChipTrace(gates[:0]).intervals(0, 0).shape == (0, 2)


def test_handlers_are_paired() -> None:
    runs = np.array([(5, 9, 85, 0), (10, 8, 85, 1), (20, 9, 85, 0), (30, 8, 85, 1)], dtype=ENTRY)
    assert ChipTrace(runs).handlers(85).tolist() == [[10, 20]]
