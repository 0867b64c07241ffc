"""Instructions that a recorder adds to the interrupt of its loop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from targets.machines import QemuProgram
from targets.toolchain import TargetError

from firmware_cost.instructions import COUNTING, Count
from firmware_cost.programs import Programs

IDLE: Final = "idle"
FOUR: Final = "4 variables of 2 bytes"
CASES: Final = (
    IDLE,
    FOUR,
    "4 variables of 4 bytes",
    "8 variables of 2 bytes",
    f"{FOUR}, a trigger",
    "4 variables of 4 bytes, a trigger",
)
"""Cases of tests/bench/native/cost_recorder.c, in order."""


def recorder_program(programs: Programs) -> Path:
    """Program that calls a recorder."""
    files = [*programs.objects(), programs.sources.native / "text.c", programs.bench / "cost_recorder.c"]
    return programs.link("recorder", files)


def recorder_costs(programs: Programs) -> Mapping[str, Count]:
    """Instructions of a call of ``recorder_sample()``, minus those of a call of an empty function.

    Raises
    ------
    TargetError
        If the run does not terminate normally.
    """
    text = QemuProgram(recorder_program(programs), COUNTING).run(b"")
    found: dict[str, Count] = {}
    for line in text.splitlines():
        case, minimum, maximum, total, number = (int(word, 16) for word in line.split())
        found[CASES[case]] = Count(number, minimum, maximum, total)
    if len(found) != len(CASES):
        raise TargetError(f"the run did not terminate normally:\n{text[-1000:]}")
    return found
