"""The same bits on every machine: recorded runs of the whole firmware, replayed on each target."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from servo_msgs_py.catalogue import Catalogue
from targets.__main__ import main
from targets.comparison import Expectation, Report, check
from targets.history import MAIN_TRANSITIONS, RUN_TRANSITIONS, History, histories
from targets.line_coverage import missed_lines
from targets.machines import TARGETS, Target
from targets.recording import Arithmetic, Recorder, Recording
from targets.scenarios import SCENARIOS
from targets.sources import Sources

Needs = Callable[[Target], None]

REFUSALS = ("return FM_PASSWORD_NEEDED;", "return RESULT_LEVEL;")
"""Of a client that has not logged in: the configuration of the runs has no passwords."""

NOT_ON_A_TARGET = {
    # The replay is one thread: no interrupt comes while the server copies.
    "latch_commands",
    "publish_snapshot",
    "event_log_watch",
    # For hosts that have no serial line.
    "servo_read",
    "servo_write",
    "freemaster_read",
    "freemaster_write",
    # No command of this application takes longer than its first look.
    "freemaster_finish_command",
    "app_command_finish",
    # DRM 4.5 lists the transition, but no flag leads there.
    "stop_init",
    # 25 s of waiting are too long for a recording.
    "wait_for_rest",
    # With an encoder READY lasts one tick, but for after those 25 s.
    "encoder_monitor_suspect",
    "check_shorted",
    # No limit can be written that is wider than the configured one.
    "omega_n_ts_under",
    # Refuse what the table of variables and the number of scope slots rule out.
    "fill",
    "scope_read",
    # The paths of the recordings meet no limit switch, and none withdraws the drive from a held search.
    "motion_leave_path",
    "align_slow",
    # The recorder's board has no switches, and 2 s are too long for a recording.
    "approach",
    "back_off",
    "run_leg",
    # The recorder's board has a data flash that keeps what is written, and sets of one version of the firmware.
    "copy_rank",
    "storage_begin",
    "take_request",
    "is_done",
    "storage_step",
    "stored_check",
    # The recorder's board leaves no interrupt out.
    "count_late_loops",
    "servo_m1_isr",
    "servo_m2_isr",
}
"""Functions with lines that no recorded run can reach, and why."""


# ---- the targets ----------------------------------------------------------------------------------------------------


SLOW = 50.0
"""Weight of a target from which on its test takes more than a few seconds."""


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(target, id=target.name, marks=[pytest.mark.slow] if target.weight > SLOW else [])
        for target in TARGETS
    ],
)
def test_a_target_agrees_in_every_word(
    target: Target, needs: Needs, expected: list[Expectation], c_sources: Sources, tmp_path: Path
) -> None:
    """Every word out of the core and every published snapshot of every run, and the arithmetic beyond them."""
    needs(target)
    (report,) = check([target], expected, c_sources, tmp_path)
    assert not report.problems, "\n".join(report.problems)
    assert report.agrees


def test_the_machines_differ() -> None:
    """Three families of processors, among them one whose `int` has 16 bits; at least three optimisations on one."""
    names = [target.name for target in TARGETS]
    assert {name.split()[0] for name in names} == {"gcc", "clang", "cortex-m3", "avr"}
    assert sum(name.startswith("cortex-m3") for name in names) >= 3


# ---- what the runs contain ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def catalogue() -> Catalogue:
    return Catalogue.load()


@pytest.fixture(scope="module")
def lives(recordings: list[Recording], catalogue: Catalogue) -> dict[int, History]:
    return histories(recordings, catalogue)


@pytest.mark.parametrize("axis", [1, 2])
def test_runs_pass_every_state(lives: dict[int, History], catalogue: Catalogue, axis: int) -> None:
    assert lives[axis].states == set(catalogue.enums["state_t"])
    assert lives[axis].substates == set(catalogue.enums["substate_t"])


def test_runs_pass_every_transition(lives: dict[int, History]) -> None:
    """And no other."""
    assert lives[1].transitions | lives[2].transitions == MAIN_TRANSITIONS
    assert lives[1].run_transitions | lives[2].run_transitions == RUN_TRANSITIONS


def test_runs_end_every_state_by_a_fault(lives: dict[int, History]) -> None:
    everywhere = {"INIT", "STOP", "CALIB", "ALIGN", "SPIN", "FREEWHEEL", "STARTUP"}
    assert lives[1].faulted_from | lives[2].faulted_from >= everywhere


def test_runs_raise_every_fault_and_reach_every_limit(lives: dict[int, History], catalogue: Catalogue) -> None:
    assert lives[1].faults | lives[2].faults == {flag.name for flag in catalogue.flags["faults"]}
    assert lives[1].limits | lives[2].limits == {flag.name for flag in catalogue.flags["limits"]}


def test_runs_use_every_mode_and_switch_every_feature(recordings: list[Recording], catalogue: Catalogue) -> None:
    written = [pair for recording in recordings for pair in recording.written]
    modes = {raw for name, values in written if name == "cmd.mode" for raw in values}
    assert modes == set(catalogue.enums["control_mode_t"].values())
    features = [raw for name, values in written if name == "param.features" for raw in values]
    for flag in catalogue.flags["features"]:
        assert {bool(raw & flag.mask) for raw in features} == {False, True}, flag.name


def test_runs_reach_every_line(c_sources: Sources, expected: list[Expectation], tmp_path: Path) -> None:
    """A part of the core that no run reaches would be the same on no machine for all we know."""
    missed = missed_lines(c_sources, [one.image for one in expected], tmp_path)
    missed = [line for line in missed if not line.text.strip().startswith(REFUSALS)]
    assert "\n".join(str(line) for line in missed if line.function not in NOT_ON_A_TARGET) == ""
    assert {line.function for line in missed} == NOT_ON_A_TARGET, "the list names functions that are reached"


# ---- recordings -----------------------------------------------------------------------------------------------------


def test_recording_repeats(recorder: Recorder, recordings: list[Recording]) -> None:
    """The same seed gives the same bytes and the same digest, another one does not."""
    for scenario, before in zip(SCENARIOS, recordings, strict=True):
        again = recorder.record(scenario)
        assert (again.image, again.digest, again.checks) == (before.image, before.digest, before.checks)
    assert recorder.record(SCENARIOS[0], seed=2).digest != recordings[0].digest


def test_arithmetic_repeats(recorder: Recorder, arithmetic: Arithmetic) -> None:
    assert recorder.arithmetic() == arithmetic
    assert recorder.arithmetic(seed=2).digest != arithmetic.digest
    assert len(set(arithmetic.checks)) == len(arithmetic.groups)


# ---- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture
def recorded_before(monkeypatch: pytest.MonkeyPatch, recorder: Recorder) -> None:
    """Spare the command its build of the recorder."""
    monkeypatch.setattr("targets.__main__.Recorder", lambda sources, folder: recorder)


@pytest.mark.usefixtures("recorded_before")
def test_command_prints_one_line_per_target(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also for a target whose tools are missing."""
    which = shutil.which
    monkeypatch.setattr("targets.toolchain.shutil.which", lambda name: None if "avr" in name else which(name))
    assert main(["--target", "avr -Os", "--target", "gcc -O0", "--target", "gcc -O3", "--scenario", "server"]) == 0
    recorded, *targets, missing, summary = capsys.readouterr().out.splitlines()
    digest = recorded.split()[4]
    assert [line.split()[:3] for line in targets] == [["gcc", "-O0", digest], ["gcc", "-O3", digest]]
    assert missing.split(maxsplit=3)[:3] == ["avr", "-Os", "skipped"]
    assert missing.endswith("sudo apt-get install gcc-avr avr-libc libsimavr-dev")
    assert summary == "2 targets agree with the recording; 1 skipped"


@pytest.mark.usefixtures("recorded_before")
def test_command_fails_without_all_tools_if_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("targets.toolchain.shutil.which", lambda name: None)
    arguments = ["--target", "avr -Os", "--scenario", "server"]
    assert main(arguments) == 0
    assert main([*arguments, "--all"]) == 1


@pytest.mark.usefixtures("recorded_before")
def test_command_fails_if_a_target_differs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    report = Report(TARGETS[0], 0x1234ABCD, 0x1234ABCD, 1.0, ("server: period 3",))
    monkeypatch.setattr("targets.__main__.check", lambda *_: iter([report]))
    assert main(["--target", TARGETS[0].name, "--scenario", "server"]) == 1
    _, line, problem, summary = capsys.readouterr().out.splitlines()
    assert line.split()[2] == "1234ABCD"
    assert line.endswith("DIFFERS")
    assert problem.strip() == "server: period 3"
    assert summary == "1 targets do not all agree with the recording"
