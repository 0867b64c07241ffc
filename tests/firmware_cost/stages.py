"""Instructions of a loop by source file, from a trace of a run and the line table.

Inline functions are assigned to the file that defines them, except the arithmetic of ``math/frac.h``, which is assigned
to its callers.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from targets.machines import QEMU, QEMU_IMAGE_ADDRESS
from targets.toolchain import TargetError, run

from firmware_cost.instructions import PHASES, cost_program, image
from firmware_cost.programs import Programs

PHASE: Final = "position"
PERIODS: Final = 12  # in units of 16 PWM periods
SETTLED: Final = {"axis_fast": 128, "axis_slow": 16}
"""Number of first loops that are ignored, as in cost.c."""

_START: Final = "motion_start"
"""Function that is called at the start of SPIN."""
_LOOPS: Final = ("axis_fast", "axis_slow")
_ARITHMETIC: Final = ("math/frac", "math/saturate")
_OUTSIDE: Final = ("app/servo", "native/cost")
"""Callers of the loops; a loop ends when they continue."""

_EXECUTED: Final = re.compile(rb"\[[0-9a-f]+/([0-9a-f]+)/")
_INSTRUCTION: Final = re.compile(r"^\s*([0-9a-f]+):\t", re.MULTILINE)
_VERSION: Final = re.compile(r"version (\d+)\.(\d+)")


@dataclass(frozen=True)
class Stages:
    """Mean instructions per loop and part."""

    fast: Mapping[str, float]  # fast loop [instructions]
    slow: Mapping[str, float]  # slow loop [instructions]


def stages(programs: Programs) -> Stages:
    """Evaluate every instruction of the start of a position move."""
    elf = cost_program(programs, loops=False)
    part = _parts(elf)
    start = _address(elf, _START)
    entries = {_address(elf, name): name for name in _LOOPS}
    recorded: dict[str, list[Counter[str]]] = {name: [] for name in _LOOPS}
    current: Counter[str] | None = None
    for address in _executed(elf, image(phases=1 << PHASES.index(PHASE), maximum=PERIODS)):
        if address == start:
            for loops in recorded.values():
                loops.clear()
        elif address in entries:
            current = Counter()
            recorded[entries[address]].append(current)
        if current is None:
            continue
        name = part.get(address, "")
        if name in _OUTSIDE:
            current = None
        else:
            current[name] += 1
    fast, slow = (_mean(recorded[name][SETTLED[name] :]) for name in _LOOPS)
    return Stages(fast, slow)


def _mean(loops: list[Counter[str]]) -> dict[str, float]:
    """Mean per part, the largest first."""
    if not loops:
        raise TargetError("no loop has run")
    total: Counter[str] = Counter()
    for loop in loops:
        total.update(loop)
    return {name: number / len(loops) for name, number in total.most_common()}


def _parts(elf: Path) -> dict[int, str]:
    """Part of each instruction address, such as ``control/pi``."""
    addresses = _INSTRUCTION.findall(run(["arm-none-eabi-objdump", "-d", elf]))
    command = ["arm-none-eabi-addr2line", "-a", "-i", "-e", str(elf)]
    lines = run(command, data="\n".join(addresses).encode("ascii")).splitlines()
    result: dict[int, str] = {}
    for address, files in _frames(lines):
        names = [_part_of(name) for name in files]
        result[address] = next((name for name in names if name not in _ARITHMETIC), names[-1])
    return result


def _frames(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Addresses with their files, the innermost inline function first."""
    address, files = None, list[str]()
    for line in lines:
        if line.startswith("0x"):
            if address is not None:
                yield address, files
            address, files = int(line, 16), []
        else:
            files.append(line)
    if address is not None:
        yield address, files


def _part_of(location: str) -> str:
    """Part of a location: ``control/pi`` for ``.../firmware/control/pi.h:40``."""
    path = Path(location.rsplit(":", 1)[0])
    return f"{path.parent.name}/{path.stem}"


def _address(elf: Path, symbol: str) -> int:
    for line in run(["arm-none-eabi-nm", elf]).splitlines():
        words = line.split()
        if words[-1] == symbol:
            return int(words[0], 16) & ~1
    raise TargetError(f"{elf.name} has no {symbol}")


def _single_step() -> list[str]:
    """QEMU options for blocks of one instruction, as the trace has one address per block."""
    found = _VERSION.search(run([QEMU[0], "--version"]))
    if found is not None and (int(found[1]), int(found[2])) < (8, 1):
        return ["-singlestep"]
    return ["-accel", "tcg,one-insn-per-tb=on"]


def _executed(elf: Path, data: bytes) -> Iterator[int]:
    """Address of every executed instruction, in order."""
    with tempfile.NamedTemporaryFile(suffix=".image") as file, tempfile.TemporaryFile() as output:
        file.write(data)
        file.flush()
        loader = f"loader,file={file.name},addr={QEMU_IMAGE_ADDRESS:#x},force-raw=on"
        trace = [*_single_step(), "-d", "exec,nochain"]
        command = [*QEMU, *trace, "-device", loader, "-kernel", str(elf)]
        with subprocess.Popen(command, stdout=output, stderr=subprocess.PIPE) as process:
            assert process.stderr is not None
            for line in process.stderr:
                found = _EXECUTED.search(line)
                if found is not None:
                    yield int(found[1], 16)
        if process.returncode != 0:
            raise TargetError(f"{command[0]} ended with status {process.returncode}")
