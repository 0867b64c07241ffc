"""The measurement as a committed Markdown table, so that the cost of a change is visible in its diff."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

from servo_twin._core_time import UNITS

from firmware_cost.calibration import fit
from firmware_cost.instructions import FAST, KINDS, OBSERVED_PHASE, PERIODS, PHASES, SLOW, Count, Counts, Kind, Setup
from firmware_cost.measurement import REFERENCE, Measurement
from firmware_cost.programs import OPTIMISATIONS
from firmware_cost.recorder import FOUR
from firmware_cost.sizes import Size
from firmware_cost.stages import PHASE

FAST_AIM: Final = 400
SENSORLESS_AIM: Final = 550
SENSORLESS_MAX: Final = 561
"""Longest run; the aim is missed by up to 2 % since the gains of the observer may change while it runs."""
_CORE_ERROR: Final = 0.10  # largest mean relative error of the charges of the virtual core
_CORE_ERROR_MAX: Final = 0.20  # largest relative error of a mean or a maximum
SLOW_AIM: Final = 600
CONTROL_AIM: Final = 10_000
RECORDER_AIM: Final = 60
MOVING: Final = PHASES[:-1]
"""Phases of normal operation, without the voltage limit."""

_HEAD: Final = """\
# What the firmware costs

Two axes that move in every mode, on a Cortex-M3; instructions are counted, not timed. `make bench-firmware UPDATE=1`
writes this table if the weights of the virtual core and the aims of the fast loop hold; a test compares the
fingerprint. What a change costs shows up as a diff here.
"""
_ORIGIN: Final = re.compile(r"^Compiler: (.*)\. Fingerprint of programs and weights: (.*)\.$", re.MULTILINE)
_PARTS_SHOWN: Final = 0.5  # [instructions]; smaller parts are only in the sum


def table(measurement: Measurement) -> str:
    """Text of the committed table."""
    sections = [
        _HEAD,
        f"Compiler: {measurement.compiler}. Fingerprint of programs and weights: {measurement.fingerprint}.\n",
        _against_others(measurement),
        *(_instructions(level, measurement.counts[level]) for level in OPTIMISATIONS),
        _instructions(f"{REFERENCE}, every feature on", measurement.all_features),
        _instructions(f"{REFERENCE}, without encoders", measurement.sensorless),
        _recorder(measurement),
        _virtual_core(measurement),
        _parts(measurement),
        _bytes(measurement),
    ]
    return "\n".join(sections)


def origin_of(text: str) -> tuple[str, str]:
    """Compiler and fingerprint of a table; empty if they are not named."""
    found = _ORIGIN.search(text)
    return (found[1], found[2]) if found else ("", "")


def problems(measurement: Measurement) -> list[str]:
    """What is wrong: weights of the virtual core that do not fit, an aim of the fast loop that is missed."""
    result = []
    errors = core_errors(measurement)
    mean = [abs(error) for pair in errors.values() for error in pair]
    if sum(mean) / len(mean) > _CORE_ERROR or max(mean) > _CORE_ERROR_MAX:
        result.append(
            f"the virtual core charges {100 * sum(mean) / len(mean):.0f} % too much or too little on average, "
            f"{100 * max(mean):.0f} % at most"
        )
    known: dict[Setup, Counts] = {
        setup: counts for setup, counts in measurement.by_setup.items() if setup != Setup.ALL_FEATURES
    }
    charged = measurement.charging.charged(fit(measurement.charge, known))
    unseen = [
        abs(error)
        for (setup, _, _), (error, _) in core_errors(replace(measurement, charged=charged)).items()
        if setup == Setup.ALL_FEATURES
    ]
    if sum(unseen) / len(unseen) > _CORE_ERROR or max(unseen) > _CORE_ERROR_MAX:
        result.append(f"weights without the runs with all features are up to {100 * max(unseen):.0f} % off in these")
    fast = largest_mean(measurement.counts[REFERENCE], FAST)
    if fast > FAST_AIM:
        result.append(f"the fast loop takes {fast:.0f} instructions instead of {FAST_AIM}")
    observed = measurement.sensorless[OBSERVED_PHASE, FAST].maximum
    if observed > SENSORLESS_MAX:
        result.append(f"the fast loop without encoder takes {observed} instructions instead of {SENSORLESS_MAX}")
    if observed < fast + 50:
        result.append("the observer does not run without encoder")
    return result


def largest_mean(counts: Counts, kind: Kind, phases: Iterable[str] = MOVING) -> float:
    """Largest mean among some phases."""
    return max(counts[phase, kind].mean for phase in phases)


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _against_others(measurement: Measurement) -> str:
    counts = measurement.counts[REFERENCE]
    sizes = measurement.sizes[REFERENCE]
    mean, maximum = _per_period(counts)
    sensorless = measurement.sensorless[OBSERVED_PHASE, FAST]
    rows = [
        ("fast loop with encoder, everything included", *_with_aim(largest_mean(counts, FAST), FAST_AIM)),
        ("the same at the voltage limit", f"{counts[PHASES[-1], FAST].mean:.0f}", ""),
        ("fast loop without encoder: observer and PLL", *_with_aim(sensorless.mean, SENSORLESS_AIM)),
        ("slow loop, position mode", *_with_aim(counts["position", SLOW].mean, SLOW_AIM)),
        ("slow loop, speed mode", *_with_aim(counts["speed", SLOW].mean, SLOW_AIM)),
        (f"recorder, {FOUR}", *_with_aim(measurement.recorder[FOUR].mean, RECORDER_AIM)),
        ("control code of two axes, bytes", *_with_aim(sizes.control.text, CONTROL_AIM)),
        ("the same with the FreeMASTER server, bytes", f"{sizes.complete.text}", ""),
        ("both interrupts of a PWM period, mean", f"{mean:.0f}", "DRM: 6250 cycles for the period at 100 MHz"),
        ("both interrupts of a PWM period, max", f"{maximum}", "the same"),
    ]
    others = [
        ("plain Q15 loop: sin/cos, Clarke, Park, 2 PI, inverse Park, SVM", "270", "349", ""),
        ("EFeru `BLDC_controller_step`, FOC", "525", "687", "5.66 kB"),
        ("plain Q15 loop with Luenberger observer, PLL, bus compensation", "617", "808", ""),
        ("ST, sensorless, 3 shunts, 72 MHz", "", "1476", "13.5 kB without user interface"),
    ]
    return (
        f"## Against the aims and against others, {REFERENCE}\n\n"
        + _rows(("instructions, where nothing else is said", "measured", "aim or budget"), rows)
        + "\nOther people's loops on a Cortex-M3, one motor:\n\n"
        + _rows(("", "instructions", "cycles", "code"), others)
    )


def core_errors(measurement: Measurement) -> dict[tuple[Setup, str, Kind], tuple[float, float]]:
    """Relative error of the charges of the virtual core: of the mean, and of the maximum."""
    result: dict[tuple[Setup, str, Kind], tuple[float, float]] = {}
    for setup, counts in measurement.by_setup.items():
        for (phase, kind), count in counts.items():
            charged = measurement.charged[setup][phase, kind]
            maximum = charged.maximum / UNITS / count.maximum - 1.0
            result[setup, phase, kind] = (charged.mean / UNITS / count.mean - 1.0, maximum)
    return result


def _virtual_core(measurement: Measurement) -> str:
    errors = core_errors(measurement)
    lines = []
    for setup, counts in measurement.by_setup.items():
        for phase in dict.fromkeys(phase for phase, _ in counts):
            found = [errors[setup, phase, kind] for kind in KINDS]
            mean, maximum = (max((each[k] for each in found), key=abs) for k in (0, 1))
            typical = sum(abs(each[0]) for each in found) / len(found)
            lines.append(
                [f"{_about(setup)}{phase}", f"{100 * typical:.1f}", f"{100 * mean:+.1f}", f"{100 * maximum:+.1f}"]
            )
    return (
        f"## The virtual core against these counts, {REFERENCE}\n\n"
        "By how many percent it charges too much, over both loops and both interrupts in each of the eight periods.\n\n"
        + _rows(["", "mean of the sizes", "worst mean", "worst of the longest runs"], lines)
    )


def _about(setup: Setup) -> str:
    return "" if setup == Setup.CONFIGURED else f"{setup.name.lower().replace('_', ' ')}, "


def _with_aim(measured: float, aim: int) -> tuple[str, str]:
    """A figure and its aim."""
    verdict = "" if measured <= aim else f", missed by {100.0 * (measured / aim - 1.0):.0f} %"
    return f"{measured:.0f}", f"at most {aim}{verdict}"


def _per_period(counts: Counts) -> tuple[float, int]:
    """Instructions of both interrupts in a PWM period: largest mean of a phase, and maximum."""

    maximum = max(
        counts[phase, 2 * k].maximum + counts[phase, 2 * k + 1].maximum for phase in PHASES for k in range(PERIODS)
    )
    return max(_both(counts, phase) for phase in PHASES), maximum


def _both(counts: Counts, phase: str) -> float:
    """Mean instructions of both interrupts in a PWM period."""
    return sum(counts[phase, kind].mean for kind in range(2 * PERIODS)) / PERIODS


def _instructions(title: str, counts: Counts) -> str:
    def cell(count: Count) -> str:
        return f"{count.minimum} {count.mean:.1f} {count.maximum}"

    def longest(phase: str, second: int) -> str:
        kind = max(range(second, 2 * PERIODS, 2), key=lambda kind: counts[phase, kind].maximum)
        return f"{counts[phase, kind].maximum} ({kind // 2})"

    head = ("min, mean, max", "fast loop", "slow loop", "longest M1 (period)", "longest M2 (period)", "mean M1 + M2")
    rows = [
        (
            phase,
            *(cell(counts[phase, kind]) for kind in (FAST, SLOW)),
            *(longest(phase, second) for second in (0, 1)),
            f"{_both(counts, phase):.1f}",
        )
        for phase in PHASES
        if (phase, FAST) in counts
    ]
    return f"## Instructions, {title}\n\n" + _rows(head, rows)


def _recorder(measurement: Measurement) -> str:
    rows = [(case, str(one.minimum), f"{one.mean:.1f}", str(one.maximum)) for case, one in measurement.recorder.items()]
    text = "What a call adds to the interrupt of its loop; both axes together have one recorder.\n\n"
    return f"## Recorder, {REFERENCE}\n\n" + text + _rows(("instructions", "min", "mean", "max"), rows)


def _parts(measurement: Measurement) -> str:
    fast, slow = measurement.stages.fast, measurement.stages.slow
    names = sorted({*fast, *slow}, key=lambda name: (-fast.get(name, 0.0), -slow.get(name, 0.0), name))
    shown = [name for name in names if max(fast.get(name, 0.0), slow.get(name, 0.0)) >= _PARTS_SHOWN]
    rows = [(f"`{name}`", f"{fast.get(name, 0.0):.1f}", f"{slow.get(name, 0.0):.1f}") for name in shown]
    rows.append(("sum", f"{sum(fast.values()):.1f}", f"{sum(slow.values()):.1f}"))
    text = f"Mean per source file at the start of a {PHASE} move; `native/bench_board` stands for the registers.\n\n"
    return f"## Where they go, {REFERENCE}\n\n" + text + _rows(("part", "fast loop", "slow loop"), rows)


def _bytes(measurement: Measurement) -> str:
    def cell(size: Size) -> str:
        return f"{size.text} + {size.rodata}"

    sizes = [measurement.sizes[level] for level in OPTIMISATIONS]
    rows = [("complete, with the FreeMASTER server", *(cell(one.complete) for one in sizes))]
    rows.append(("without the server: control code", *(cell(one.control) for one in sizes)))
    rows += [
        (f"of the complete one: `{room}`", *(cell(one.rooms.get(room, Size())) for one in sizes))
        for room in sizes[0].rooms
    ]
    memory = [("complete", *(str(one.complete.data + one.complete.bss) for one in sizes))]
    memory.append(("without the server", *(str(one.control.data + one.control.bss) for one in sizes)))
    return (
        "## Bytes of both axes\n\nInstructions + constants; the board below `hal/hal.h` is not in it.\n\n"
        + _rows(("", *OPTIMISATIONS), rows)
        + "\nMemory:\n\n"
        + _rows(("", *OPTIMISATIONS), memory)
    )
