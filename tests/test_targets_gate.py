"""The comparison of the targets detects and names changes in a copy of the sources."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from targets.calls import Call, parse_console, parse_log
from targets.casts import removals, verdict
from targets.comparison import Expectation, check, combined, first_difference
from targets.machines import TARGETS, Avr, AvrProgram, Host, Target
from targets.recording import Arithmetic, Recorder, Recording
from targets.sources import Sources
from targets.toolchain import TargetError

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


def test_casts_are_found_in_code_only(tmp_path: Path) -> None:
    file = tmp_path / "firmware" / "math" / "one.c"
    file.parent.mkdir(parents=True)
    file.write_text(
        "int32_t f(int16_t a); /* (int32_t)a */\n"
        'int32_t f(int16_t a) { g("(int32_t)a"); return (int32_t)a << INT16_C(2); }\n',
        encoding="utf-8",
    )
    found = list(removals(Sources(tmp_path), ["math"]))
    assert [(one.line, one.removed, one.rest) for one in found] == [(2, "(int32_t)", ""), (2, "INT16_C(2)", "2")]
    text = file.read_text(encoding="utf-8")
    cuts = [text[: one.start] + one.rest + text[one.end :] for one in found]
    assert [cut.splitlines()[1].split("return ")[1] for cut in cuts] == ["a << INT16_C(2); }", "(int32_t)a << 2; }"]


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


def test_sanitizers_detect_an_overflow(
    c_sources: Sources, arithmetic: Arithmetic, needs: Needs, tmp_path: Path
) -> None:
    """The digest may be right although the behaviour is undefined."""
    sanitized = next(target for target in TARGETS if "sanitizers" in target.name)
    needs(sanitized)
    sources = edited(c_sources, tmp_path, "sensing/mt_speed.c", "UINT32_C(0) - (uint32_t)speed", "(uint32_t)(-speed)")
    plain, checked = check([HOST, sanitized], [arithmetic], sources, tmp_path / "build")
    assert plain.problems == ()
    assert "negation of -2147483648 cannot be represented" in "\n".join(checked.problems)


def test_truncated_output_is_an_error() -> None:
    with pytest.raises(ValueError, match="did not terminate normally"):
        parse_console("=12345678\n")
    assert parse_console("=12345678\nend 9ABCDEF0\n").digest == 0x9ABCDEF0


def test_compiler_error_is_reported(c_sources: Sources, recordings: list[Recording], tmp_path: Path) -> None:
    sources = edited(c_sources, tmp_path, "drive/axis.c", "#define U_DC_FILTER_SHIFT 4", "#define U_DC_FILTER_SHIFT")
    (report,) = check([HOST], recordings[:1], sources, tmp_path / "build")
    assert report.digest is None
    assert report.problems[0].startswith("does not build: gcc ended with status 1")


def test_recorder_wraps_every_function_of_the_board(c_sources: Sources, tmp_path: Path) -> None:
    """Functions that are not recorded could not be replayed."""
    sources = edited(
        c_sources,
        tmp_path / "copy",
        "hal/hal.h",
        "void hal_watchdog_service(hal_t *hal);",
        "void hal_watchdog_service(hal_t *hal);\nvoid hal_new(hal_t *hal);",
    )
    axis = sources.firmware / "drive" / "axis.c"
    text = axis.read_text(encoding="utf-8")
    axis.write_text(
        text.replace("    filter_bus(axis);\n", "    filter_bus(axis);\n    hal_new(axis->hal);\n", 1), "utf-8"
    )
    with pytest.raises(TargetError, match="__wrap_hal_new"):
        Recorder(sources, tmp_path)


# ---- the recorder's log ---------------------------------------------------------------------------------------------


def test_log_and_console_agree(c_sources: Sources, recordings: list[Recording], tmp_path: Path) -> None:
    """The recorder stores each call as a replay prints it."""
    recording = by_name(recordings, "server")
    program = HOST.build(c_sources, tmp_path)
    calls = parse_console(program.run(recording.printing(0, recording.periods))).calls
    assert list(calls) == recording.calls()
    assert any(call.snapshot for call in calls)


def test_log_contains_several_calls() -> None:
    words = [7, 1, 1, 0, 2, 0x0101, 0xFFFF, 1, 5, 0x5678, 0x1234, 8, 1, 4, 1, 0, 0]
    first, second = parse_log(words)
    assert first == Call(0x10007, 1, 0, 0, 0, (0x0101, 0xFFFF), ((5, 0x12345678),))
    assert second == Call(0x10008, 4, 1, 0, 0, ())
    assert (first.place, second.place) == ("period 65543 (4096.44 ms), m1", "period 65544 (4096.50 ms), edge of axis2")
