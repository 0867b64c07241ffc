"""Bit-exact comparison: recorded runs of the whole firmware, replayed on each target."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from targets.comparison import Expectation, check, combined
from targets.line_coverage import missed_lines
from targets.machines import TARGETS, Host, Target
from targets.recording import Recorder, Recording
from targets.scenarios import SCENARIOS
from targets.sources import Sources

Needs = Callable[[Target], None]

REFUSALS = (
    "return FM_PASSWORD_NEEDED;",
    "return RESULT_LEVEL;",
    "return POINT_REFUSAL_MEASUREMENT;",
    "return POINT_REFUSAL_BUSY;",
)
"""Refusals without a login and during a measurement, because the runs have neither passwords nor measurements, and one
that depends on the instants at which bytes are received."""

NOT_ON_A_TARGET = {
    # The replay has one thread: the server is not interrupted.
    "latch_commands",
    "publish_snapshot",
    "event_log_compare",
    # For hosts without a serial line.
    "servo_read",
    "servo_write",
    "freemaster_read",
    "freemaster_write",
    # All commands of this application are completed at the first request.
    "freemaster_finish_command",
    "app_command_finish",
    # DRM 4.5 lists the transition, but no flag causes it.
    "stop_init",
    # A wait of 25 s is too long for a recording.
    "wait_for_rest",
    # With an encoder READY lasts one tick, except after these 25 s.
    "encoder_monitor_suspect",
    "check_shorted",
    # Refusals that are excluded by the table of variables and the number of scope slots.
    "fill",
    "scope_read",
    # No path of the recordings reaches a limit switch, and none disables the drive in a held search.
    "motion_leave_path",
    "align_slow",
    # The board of the recorder has no switches, and 2 s are too long for a recording.
    "approach",
    "back_off",
    "run_leg",
    # The data flash of the board of the recorder has no errors, and only sets of one version of the firmware.
    "copy_rank",
    "storage_begin",
    "take_request",
    "is_done",
    "storage_step",
    "stored_check",
    # The board of the recorder omits no interrupt.
    "count_late_loops",
    "servo_m1_isr",
    "servo_m2_isr",
}
"""Functions with lines that no recorded run can reach, with the reasons."""


# ---- the targets ----------------------------------------------------------------------------------------------------


SLOW = 50.0
"""Smallest weight of a target whose test is marked as slow."""


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(target, id=target.name, marks=[pytest.mark.slow] if target.weight > SLOW else [])
        for target in TARGETS
    ],
)
def test_target_has_the_outputs_of_the_host(
    target: Target, needs: Needs, expected: list[Expectation], c_sources: Sources, tmp_path: Path
) -> None:
    """All output words and snapshots of every run, and the results of the arithmetic."""
    needs(target)
    (report,) = check([target], expected, c_sources, tmp_path)
    assert not report.problems, "\n".join(report.problems)
    assert report.agrees


# ---- what the runs contain ------------------------------------------------------------------------------------------


def test_runs_reach_every_line(c_sources: Sources, expected: list[Expectation], tmp_path: Path) -> None:
    """The comparison is not valid for lines that no run reaches."""
    missed = missed_lines(c_sources, [one.image for one in expected], tmp_path)
    missed = [line for line in missed if not line.text.strip().startswith(REFUSALS)]
    assert "\n".join(str(line) for line in missed if line.function not in NOT_ON_A_TARGET) == ""
    assert {line.function for line in missed} == NOT_ON_A_TARGET, "the list names functions that are reached"


def test_recording_is_reproducible(recorder: Recorder, recordings: list[Recording]) -> None:
    """The same seed gives the same bytes and digest, another seed does not."""
    again, before = recorder.record(SCENARIOS[0]), recordings[0]
    assert (again.image, again.digest, again.checks) == (before.image, before.digest, before.checks)
    assert recorder.record(SCENARIOS[0], seed=2).digest != before.digest


# ---- differences -----------------------------------------------------------------------------------------------------


HOST = Host("host", "gcc", ("-O0",), "for this test", ("gcc",))


def edited(sources: Sources, folder: Path, file: str, before: str, after: str) -> Sources:
    """Copy of the sources with one change."""
    copy = sources.copy(folder)
    path = copy.firmware / file
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{file} has changed: {before!r}"
    path.write_text(text.replace(before, after), encoding="utf-8")
    return copy


@pytest.mark.slow
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
