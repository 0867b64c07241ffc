"""Bit-exact comparison: recorded runs of the whole firmware, replayed on each target."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from servo_msgs_py.catalogue import Catalogue
from targets.comparison import Expectation, check
from targets.history import MAIN_TRANSITIONS, RUN_TRANSITIONS, History, histories
from targets.line_coverage import missed_lines
from targets.machines import TARGETS, Target
from targets.recording import Recording
from targets.sources import Sources

Needs = Callable[[Target], None]

REFUSALS = ("return FM_PASSWORD_NEEDED;", "return RESULT_LEVEL;")
"""Refusals without a login: the configuration of the runs has no passwords."""

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


@pytest.fixture(scope="module")
def catalogue() -> Catalogue:
    return Catalogue.load()


@pytest.fixture(scope="module")
def axis_histories(recordings: list[Recording], catalogue: Catalogue) -> dict[int, History]:
    return histories(recordings, catalogue)


@pytest.mark.parametrize("axis", [1, 2])
def test_runs_pass_every_state(axis_histories: dict[int, History], catalogue: Catalogue, axis: int) -> None:
    assert axis_histories[axis].states == set(catalogue.enums["state_t"])
    assert axis_histories[axis].substates == set(catalogue.enums["substate_t"])


def test_runs_pass_every_transition(axis_histories: dict[int, History]) -> None:
    """They contain no other transition."""
    assert axis_histories[1].transitions | axis_histories[2].transitions == MAIN_TRANSITIONS
    assert axis_histories[1].run_transitions | axis_histories[2].run_transitions == RUN_TRANSITIONS


def test_runs_leave_every_state_by_a_fault(axis_histories: dict[int, History]) -> None:
    everywhere = {"INIT", "STOP", "CALIB", "ALIGN", "SPIN", "FREEWHEEL", "STARTUP"}
    assert axis_histories[1].faulted_from | axis_histories[2].faulted_from >= everywhere


def test_runs_raise_every_fault_and_reach_every_limit(axis_histories: dict[int, History], catalogue: Catalogue) -> None:
    assert axis_histories[1].faults | axis_histories[2].faults == {flag.name for flag in catalogue.flags["faults"]}
    assert axis_histories[1].limits | axis_histories[2].limits == {flag.name for flag in catalogue.flags["limits"]}


def test_runs_use_every_mode_and_switch_every_feature(recordings: list[Recording], catalogue: Catalogue) -> None:
    written = [pair for recording in recordings for pair in recording.written]
    modes = {raw for name, values in written if name == "cmd.mode" for raw in values}
    assert modes == set(catalogue.enums["control_mode_t"].values())
    features = [raw for name, values in written if name == "param.features" for raw in values]
    for flag in catalogue.flags["features"]:
        assert {bool(raw & flag.mask) for raw in features} == {False, True}, flag.name


def test_runs_reach_every_line(c_sources: Sources, expected: list[Expectation], tmp_path: Path) -> None:
    """The comparison is not valid for lines that no run reaches."""
    missed = missed_lines(c_sources, [one.image for one in expected], tmp_path)
    missed = [line for line in missed if not line.text.strip().startswith(REFUSALS)]
    assert "\n".join(str(line) for line in missed if line.function not in NOT_ON_A_TARGET) == ""
    assert {line.function for line in missed} == NOT_ON_A_TARGET, "the list names functions that are reached"


# ---- recordings -----------------------------------------------------------------------------------------------------
