"""The comparison of the targets detects and names changes in a copy of the sources."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from targets.casts import removals, verdict
from targets.comparison import Expectation, check, combined, first_difference
from targets.machines import Avr, AvrProgram, Host, Target
from targets.recording import Recorder, Recording
from targets.sources import Sources

pytestmark = pytest.mark.slow

Needs = Callable[[Target], None]

HOST = Host("host", "gcc", ("-O0",), "for these tests", ("gcc",))

CASTS = [
    ("math/frac.h", "frac16_t f16_add(", "(int32_t)"),
    ("math/frac.h", "frac16_t f16_mul(", "(int32_t)"),
    ("control/current_loop.c", "-2 * (int32_t)omega_e", "(int32_t)"),
    ("control/svm.h", "#define SVM_ONE_BY_SQRT3_Q15", "INT32_C(18919)"),
    ("sensing/encoder.c", "(int32_t)(int16_t)count - (int16_t)previous", "(int32_t)"),
    ("drive/current_sense.c", "(uint32_t)code << SENSE_OFFSET_BITS", "(uint32_t)"),
    ("comm/leb128.c", "(uint32_t)(data[at] & 0x7Fu) << shift", "(uint32_t)"),
]
"""File, part of the line, and removed cast, which is not needed with the 32-bit `int` of the host."""


def edited(sources: Sources, folder: Path, file: str, before: str, after: str) -> Sources:
    """Copy of the sources with one change."""
    copy = sources.copy(folder)
    path = copy.firmware / file
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{file} has changed: {before!r}"
    path.write_text(text.replace(before, after), encoding="utf-8")
    return copy


def by_name(recordings: list[Recording], name: str) -> Recording:
    return next(recording for recording in recordings if recording.name == name)


# ---- a missing cast -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def avr(c_sources: Sources, needs: Needs, tmp_path_factory: pytest.TempPathFactory) -> AvrProgram:
    needs(Avr())
    return Avr().build(c_sources, tmp_path_factory.mktemp("avr"))


@pytest.fixture(scope="module")
def short(recorder: Recorder, recordings: list[Recording]) -> list[Expectation]:
    """Short expectations that are sufficient for detection."""
    return [recorder.arithmetic(rounds=30), by_name(recordings, "server")]


@pytest.mark.parametrize(("file", "fragment", "removed"), CASTS, ids=lambda value: value.replace(" ", ""))
def test_missing_cast_is_detected(
    c_sources: Sources,
    avr: AvrProgram,
    short: list[Expectation],
    tmp_path: Path,
    file: str,
    fragment: str,
    removed: str,
) -> None:
    """By the machine with a 16-bit `int`, or by its compiler; the digest of the host is unchanged."""
    (cast,) = [
        one for one in removals(c_sources) if (one.file, one.removed) == (file, removed) and fragment in one.code
    ]
    (tmp_path / "host").mkdir()
    host = HOST.build(cast.apply(c_sources, tmp_path / "copy"), tmp_path / "host")
    assert [first_difference(host, one)[1] for one in short] == [None, None]
    seen = verdict(cast, c_sources, avr, short, tmp_path / "avr")
    assert seen is not None
    assert seen != "the same machine code"


# ---- other mistakes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "before", "after", "expected"),
    [
        (
            "drive/axis.c",
            "#define U_DC_FILTER_SHIFT 4",
            "#define U_DC_FILTER_SHIFT 5",
            r"period \d+ \(\d+\.\d\d ms\), m2: u_dc is 0x[0-9a-f]+, recorded 0x[0-9a-f]+",
        ),
        (
            "control/svm.h",
            "INT32_C(18919)",
            "INT32_C(18918)",
            r"period \d+ \(\d+\.\d\d ms\), m[12]: axis[12] duty \d+ \d+ \d+, recorded axis[12] duty \d+ \d+ \d+",
        ),
        (
            "drive/monitors.h",
            "hal_over_current_active(axis->hal, axis->index) || ",
            "",
            r"period \d+ \(\d+\.\d\d ms\), m[12]: left 1 inputs than were recorded",
        ),
    ],
    ids=["constant", "output", "input"],
)
def test_first_difference_is_named(
    c_sources: Sources, recordings: list[Recording], tmp_path: Path, file: str, before: str, after: str, expected: str
) -> None:
    """The message has the first different call and the difference."""
    (report,) = check([HOST], [recordings[0]], edited(c_sources, tmp_path, file, before, after), tmp_path / "build")
    assert report.digest != combined([recordings[0].digest])
    (problem,) = report.problems
    assert re.fullmatch(f"{recordings[0].name}: {expected}", problem), problem
