"""Cost of the firmware: the committed table is up to date, and the counts are those of the code."""

from __future__ import annotations

import dataclasses
import re
import warnings
from pathlib import Path

import pytest
from bench.firmware import TABLE, difference
from firmware_cost.calibration import fit
from firmware_cost.instructions import (
    COUNTING,
    FAST,
    OBSERVED_PHASE,
    PHASES,
    SLOW,
    Setup,
    cost_program,
    count,
    image,
    parse,
)
from firmware_cost.measurement import REFERENCE, Measurement, measure, plain
from firmware_cost.programs import TARGET, Programs
from firmware_cost.sizes import SERVER, VARIABLES, Size, sizes
from firmware_cost.stages import PERIODS, PHASE
from firmware_cost.table import FAST_AIM, SENSORLESS_AIM, compiler_of, core_errors, largest_mean, table
from servo_twin._core_time import load_weights
from targets.machines import QemuProgram, missing_text
from targets.sources import Sources
from targets.toolchain import TargetError, run

pytestmark = pytest.mark.slow

CALL_AND_RETURN = 4
"""Largest number of instructions that the clock counts in addition to the trace: call and return."""


@pytest.fixture(scope="module")
def needs_tools() -> None:
    if not TARGET.available():
        pytest.skip(missing_text(TARGET))


@pytest.fixture(scope="module")
def measurement(needs_tools: None, c_sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    return measure(c_sources, tmp_path_factory.mktemp("cost"))


@pytest.fixture(scope="module")
def programs(needs_tools: None, c_sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Programs:
    return Programs.compile(c_sources, tmp_path_factory.mktemp("programs"), REFERENCE)


# ---- the table ------------------------------------------------------------------------------------------------------


def test_committed_table_is_up_to_date(measurement: Measurement) -> None:
    """The table is compared only if it was made with the same compiler."""
    committed = compiler_of(TABLE.read_text(encoding="utf-8"))
    assert committed, f"{TABLE.name} does not name its compiler"
    lines = difference(table(measurement))
    if committed != measurement.compiler:
        text = f"{TABLE.name} was made with {committed}, here is {measurement.compiler}: not compared"
        warnings.warn("\n".join([text, *lines]), stacklevel=1)
        return
    assert not lines, "\n".join(["`make bench-firmware UPDATE=1` updates the table:", *lines])


def test_virtual_core_agrees_with_counted_instructions(measurement: Measurement) -> None:
    """With the committed weights, for every mode, feature set and feedback; mean error up to 10 %, largest 20 %."""
    charged = measurement.charging.charged(load_weights())
    errors = core_errors(dataclasses.replace(measurement, charged=charged))
    assert len(errors) > 100
    mean = [abs(error) for pair in errors.values() for error in pair]
    assert sum(mean) / len(mean) < 0.10
    assert {label: error for label, error in errors.items() if max(map(abs, error)) > 0.20} == {}


def test_weights_are_valid_for_runs_without_fit(measurement: Measurement) -> None:
    known = {Setup.CONFIGURED: measurement.counts[REFERENCE], Setup.WITHOUT_ENCODERS: measurement.sensorless}
    charged = measurement.charging.charged(fit(measurement.charge, known))
    errors = core_errors(dataclasses.replace(measurement, charged=charged))
    unseen = [abs(mean) for (setup, _, _), (mean, _) in errors.items() if setup == Setup.ALL_FEATURES]
    assert sum(unseen) / len(unseen) < 0.10
    assert max(unseen) < 0.20


def test_fast_loop_reaches_its_aim(measurement: Measurement) -> None:
    """Including reconstruction, decoupling, ripple compensation, dead time, SVM, encoder and state machine."""
    if compiler_of(TABLE.read_text(encoding="utf-8")) == measurement.compiler:
        assert largest_mean(measurement.counts[REFERENCE], FAST) <= FAST_AIM


def test_sensorless_fast_loop_reaches_its_aim(measurement: Measurement) -> None:
    """With observer and PLL instead of the encoder."""
    maximum = measurement.sensorless[OBSERVED_PHASE, FAST].maximum
    assert maximum <= 1.02 * SENSORLESS_AIM, "missed by 1 % since the gains of the observer may change while it runs"
    assert maximum > largest_mean(measurement.counts[REFERENCE], FAST) + 50, "the observer runs"


def test_json_has_the_numbers_of_the_table(measurement: Measurement) -> None:
    """JSON and table agree."""
    numbers = plain(measurement)
    for phase in PHASES:
        fast = numbers["instructions"][REFERENCE][phase]["fast loop"]
        assert f"{fast['min']} {fast['mean']:.1f} {fast['max']}" in table(measurement)
    control = numbers["bytes"][REFERENCE]["control"]
    assert f"{control['text']} + {control['rodata']}" in table(measurement)


# ---- instructions ---------------------------------------------------------------------------------------------------


def test_counts_are_reproducible(measurement: Measurement, programs: Programs) -> None:
    assert count(programs) == measurement.counts[REFERENCE]


def test_clock_and_trace_agree(measurement: Measurement, programs: Programs) -> None:
    """The simulated timer and the trace count the same loops."""
    program = QemuProgram(cost_program(programs, loops=True), COUNTING)
    counts = parse(program.run(image(phases=1 << PHASES.index(PHASE), maximum=PERIODS)))
    for kind, parts in ((FAST, measurement.stages.fast), (SLOW, measurement.stages.slow)):
        assert 0 <= counts[PHASE, kind].mean - sum(parts.values()) <= CALL_AND_RETURN


def test_seven_added_instructions_are_counted(measurement: Measurement, c_sources: Sources, tmp_path: Path) -> None:
    """Counting is exact: instructions added to the fast loop appear only there."""
    sources = c_sources.copy(tmp_path / "sources")
    axis = sources.firmware / "drive" / "axis.c"
    text = axis.read_text(encoding="utf-8")
    head = "void axis_fast(axis_t *axis)\n{\n"
    assert text.count(head) == 1
    axis.write_text(text.replace(head, head + '__asm__ volatile(".rept 7\\n nop\\n .endr");\n'), encoding="utf-8")
    more = count(Programs.compile(sources, tmp_path / "build", REFERENCE))
    for key, before in measurement.counts[REFERENCE].items():
        extra = 0 if key[1] == SLOW else 7
        assert (more[key].minimum, more[key].maximum) == (before.minimum + extra, before.maximum + extra)


def test_every_part_of_the_fast_loop_is_executed(measurement: Measurement) -> None:
    """Every part of the fast loop has instructions in the run."""
    parts = {name.split("/")[1] for name, mean in measurement.stages.fast.items() if mean > 1.0}
    assert parts >= {
        *("axis", "run_step", "encoder", "current_sense", "transforms"),
        *("trig", "pi", "current_loop", "svm", "dead_time"),
    }


def test_instruction_counts_vary_in_every_phase(measurement: Measurement) -> None:
    """The counts of the slow loop vary in every phase, and those of the fast loop at the voltage limit."""
    counts = measurement.counts[REFERENCE]
    assert counts["voltage limit", FAST].mean > counts["speed", FAST].mean + 20
    for phase in PHASES[1:]:
        assert counts[phase, SLOW].maximum > counts[phase, SLOW].minimum
        assert counts[phase, FAST].number == 16 * counts[phase, SLOW].number / 2


def test_a_run_that_ends_in_a_fault_is_refused() -> None:
    with pytest.raises(TargetError, match="does not spin"):
        parse("0000 0004 00000001 00000010 00000010 00000010\naxis 0001 0003 0020 00000000 00000000\n")
    with pytest.raises(TargetError, match="did not terminate normally"):
        parse("0000 0004 00000001 00000010 00000010 00000010\n")


# ---- bytes ----------------------------------------------------------------------------------------------------------


def test_sizes_add_up(measurement: Measurement) -> None:
    for one in measurement.sizes.values():
        server = one.rooms[SERVER] + one.rooms[VARIABLES]
        rest = one.complete.text - one.control.text
        assert server.text <= rest <= server.text + 1000  # and library code that only the server needs
        assert one.complete.bss - one.control.bss > 500
        assert one.rooms["math"].rodata >= 2 * 257  # the table of the quarter wave


def test_sizes_agree_with_the_program(programs: Programs, measurement: Measurement) -> None:
    """The map of the linker agrees with the program: all code is application, board or start-up code."""
    assert sizes(programs) == measurement.sizes[REFERENCE]
    elf = programs.folder / "application.elf"
    lines = map(str.split, run(["arm-none-eabi-nm", "-S", elf]).splitlines())
    code = {words[3]: int(words[1], 16) for words in lines if len(words) == 4 and words[2] in "tT"}
    board = re.compile("hal_|bench_|machine_|startup_|main|application_")
    application = sum(size for name, size in code.items() if not board.match(name))
    counted = measurement.sizes[REFERENCE].complete.text
    assert application == pytest.approx(counted, rel=0.06)  # alignment, constants between functions
    assert Size(1, 2, 3, 4) + Size(1, 1, 1, 1) == Size(2, 3, 4, 5)
