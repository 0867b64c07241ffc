"""Instructions of the interrupts and their loops, counted by the clock of the simulated machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final

from targets.machines import QemuProgram
from targets.toolchain import TargetError

from firmware_cost.programs import Programs

COUNTING: Final = ("-icount", "shift=10")
"""QEMU options: the system timer runs 25.6 ticks per instruction (firmware/port/cortex_m3/machine.c)."""

PHASES: Final = ("hold", "position", "speed", "crawl", "torque", "voltage limit")
"""Phases of tests/bench/native/cost.c, in order."""

EVERY_PHASE: Final = (1 << len(PHASES)) - 1
WHOLE_PHASES: Final = 0xFF  # no limit, in units of 16 periods

_LOOPS: Final = ("axis_fast", "axis_slow")
_SPIN: Final = 3


class Setup(IntEnum):
    """Configuration of the phases."""

    CONFIGURED = 0
    ALL_FEATURES = 1
    WITHOUT_ENCODERS = 2


OBSERVED_PHASE: Final = "speed"
"""Phase that can run without encoders."""


PERIODS: Final = 8
"""PWM periods of a slow tick."""

Kind = int
"""Counted interrupt or loop (tests/bench/native/cost.h): M1 is 2 * period, M2 is 2 * period + 1, then the loops."""

FAST: Final[Kind] = 2 * PERIODS
SLOW: Final[Kind] = FAST + 1
KINDS: Final[tuple[Kind, ...]] = tuple(range(SLOW + 1))


def name_of(kind: Kind) -> str:
    """Name of a kind, such as ``M1, period 3``."""
    loops = {FAST: "fast loop", SLOW: "slow loop"}
    return loops.get(kind) or f"M{kind % 2 + 1}, period {kind // 2}"


@dataclass(frozen=True)
class Count:
    """Instructions of one interrupt or loop, including call and return."""

    number: int
    minimum: int
    maximum: int
    total: int

    @property
    def mean(self) -> float:
        return self.total / self.number


Counts = Mapping[tuple[str, Kind], Count]
"""Counts by phase and kind."""


def image(*, setup: Setup = Setup.CONFIGURED, phases: int = EVERY_PHASE, maximum: int = WHOLE_PHASES) -> bytes:
    """Input of cost.c.

    Parameters
    ----------
    setup : Setup
        Configuration of the phases.
    phases : int
        Mask of the phases to run.
    maximum : int
        Largest length of a phase, in units of 16 PWM periods.
    """
    return bytes([setup, phases, maximum])


def cost_program(programs: Programs, *, loops: bool) -> Path:
    """Program that moves two axes and counts the instructions of the interrupts, or of the loops in them."""
    names = ["cost", "bench_board", *(["cost_loops"] if loops else [])]
    files = [programs.bench / f"{name}.c" for name in names]
    wrap = [f"-Wl,--wrap={name}" for name in _LOOPS] if loops else []
    name = "loops" if loops else "interrupts"
    return programs.link(name, [*programs.objects(), programs.sources.native / "text.c", *files], wrap)


def count(programs: Programs, setup: Setup = Setup.CONFIGURED) -> Counts:
    """Instructions of interrupts and loops over a run of both axes.

    Raises
    ------
    TargetError
        If an axis is not in SPIN at the end, or has a fault.
    """
    result: dict[tuple[str, Kind], Count] = {}
    for loops in (False, True):
        phases = 1 << PHASES.index(OBSERVED_PHASE) if setup == Setup.WITHOUT_ENCODERS else EVERY_PHASE
        text = QemuProgram(cost_program(programs, loops=loops), COUNTING).run(image(setup=setup, phases=phases))
        for (phase, kind), value in parse(text).items():
            if (kind in (FAST, SLOW)) == loops:
                result[phase, kind] = value
    return result


def parse(text: str) -> Counts:
    """Parse the output of cost.c."""
    result: dict[tuple[str, Kind], Count] = {}
    axes = 0
    for line in text.splitlines():
        words = line.split()
        if words[0] == "axis":
            axes += 1
            if int(words[2], 16) != _SPIN or int(words[3], 16) != 0:
                raise TargetError(f"an axis does not spin at the end of the run: {line}")
            continue
        phase, kind, number, minimum, maximum, total = (int(word, 16) for word in words)
        if number:
            result[PHASES[phase], kind] = Count(number, minimum, maximum, total)
    if axes == 0:
        raise TargetError(f"the run did not terminate normally:\n{text[-1000:]}")
    return result
