"""The measurement as a Markdown table, which is kept beside the code: what a change costs is a line of its diff."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final

from firmware_cost.instructions import OBSERVED_PHASE, PHASES, Count, Counts, Kind
from firmware_cost.measurement import REFERENCE, Measurement
from firmware_cost.programs import OPTIMISATIONS
from firmware_cost.sizes import Size
from firmware_cost.stages import PHASE

FAST_AIM: Final = 400
SENSORLESS_AIM: Final = 800
SLOW_AIM: Final = 500
CONTROL_AIM: Final = 10_000
MOVING: Final = PHASES[:-1]
"""What a servo does; the last phase is the voltage limit."""

SLOW_PERIODS: Final = 8
_HEAD: Final = """\
# What the firmware costs

Two axes that move in every mode, on a Cortex-M3; instructions are counted, not timed. `make bench-firmware UPDATE=1`
writes this table, and a test compares it: what a change costs shows up as a diff here.
"""
_COMPILER: Final = re.compile(r"^Compiler: (.*)\.$", re.MULTILINE)
_PARTS_SHOWN: Final = 0.5  # instructions; less is summed up


def table(measurement: Measurement) -> str:
    """Text of the committed table."""
    sections = [
        _HEAD,
        f"Compiler: {measurement.compiler}.\n",
        _against_others(measurement),
        *(_instructions(level, measurement.counts[level]) for level in OPTIMISATIONS),
        _instructions(f"{REFERENCE}, every feature on", measurement.all_features),
        _instructions(f"{REFERENCE}, without encoders", measurement.sensorless),
        _parts(measurement),
        _bytes(measurement),
    ]
    return "\n".join(sections)


def compiler_of(text: str) -> str:
    """The compiler that a table was made with; empty when it does not say."""
    found = _COMPILER.search(text)
    return found[1] if found else ""


def dearest(counts: Counts, kind: Kind, phases: Iterable[str] = MOVING) -> float:
    """Largest mean among some phases."""
    return max(counts[phase, kind].mean for phase in phases)


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _against_others(measurement: Measurement) -> str:
    counts = measurement.counts[REFERENCE]
    sizes = measurement.sizes[REFERENCE]
    mean, most = _per_period(counts)
    sensorless = measurement.sensorless[OBSERVED_PHASE, Kind.FAST]
    rows = [
        ("fast loop with encoder, everything included", *_aimed(dearest(counts, Kind.FAST), FAST_AIM)),
        ("the same at the voltage limit", f"{counts[PHASES[-1], Kind.FAST].mean:.0f}", ""),
        ("fast loop without encoder: observer and PLL", *_aimed(sensorless.mean, SENSORLESS_AIM)),
        ("slow loop, position mode", *_aimed(counts["position", Kind.SLOW].mean, SLOW_AIM)),
        ("slow loop, speed mode", *_aimed(counts["speed", Kind.SLOW].mean, SLOW_AIM)),
        ("control code of two axes, bytes", *_aimed(sizes.control.text, CONTROL_AIM)),
        ("the same with the FreeMASTER server, bytes", f"{sizes.complete.text}", ""),
        ("both interrupts of a PWM period, mean", f"{mean:.0f}", "DRM: 6250 cycles for the period at 100 MHz"),
        ("both interrupts of a PWM period, most", f"{most}", "the same"),
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


def _aimed(measured: float, aim: int) -> tuple[str, str]:
    """A figure and what it ought to be."""
    verdict = "" if measured <= aim else f", missed by {100.0 * (measured / aim - 1.0):.0f} %"
    return f"{measured:.0f}", f"at most {aim}{verdict}"


def _per_period(counts: Counts) -> tuple[float, int]:
    """Instructions of both interrupts in a PWM period: mean over the slow ticks of the dearest phase, and the most."""

    def both(phase: str) -> float:
        usual = counts[phase, Kind.M1].mean + counts[phase, Kind.M2].mean
        slow = counts[phase, Kind.M1_SLOW].mean + counts[phase, Kind.M2_SLOW].mean
        return ((SLOW_PERIODS - 1) * usual + slow) / SLOW_PERIODS

    most = max(counts[phase, Kind.M1_SLOW].most + counts[phase, Kind.M2_SLOW].most for phase in PHASES)
    return max(both(phase) for phase in PHASES), most


def _instructions(title: str, counts: Counts) -> str:
    def cell(count: Count) -> str:
        return f"{count.least} {count.mean:.1f} {count.most}"

    kinds = (Kind.FAST, Kind.SLOW, Kind.M1, Kind.M2, Kind.M1_SLOW, Kind.M2_SLOW)
    head = ("least, mean, most", "fast loop", "slow loop", "M1", "M2", "M1 with slow loop", "M2 with slow loop")
    rows = [(phase, *(cell(counts[phase, kind]) for kind in kinds)) for phase in PHASES if (phase, Kind.FAST) in counts]
    return f"## Instructions, {title}\n\n" + _rows(head, rows)


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
