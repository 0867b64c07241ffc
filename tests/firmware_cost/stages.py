"""Which part of the firmware the instructions of a loop belong to: each one of a run, looked up in the line table.

Parts are source files. What a file's inline functions become inside others counts for the file; the arithmetic of
``math/frac.h`` counts for its callers.
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
PERIODS: Final = 12  # times 16
SETTLED: Final = {"axis_fast": 128, "axis_slow": 16}
"""Loops that cost.c leaves out, too."""

_START: Final = "motion_start"
"""Called when the axes begin to spin."""
_LOOPS: Final = ("axis_fast", "axis_slow")
_ARITHMETIC: Final = ("math/frac", "math/saturate")
_OUTSIDE: Final = ("app/servo", "native/cost")
"""Parts from which the loops are called: there a loop has ended."""

_EXECUTED: Final = re.compile(rb"\[[0-9a-f]+/([0-9a-f]+)/")
_INSTRUCTION: Final = re.compile(r"^\s*([0-9a-f]+):\t", re.MULTILINE)
_VERSION: Final = re.compile(r"version (\d+)\.(\d+)")


@dataclass(frozen=True)
class Stages:
    """Mean instructions per loop and part."""

    fast: Mapping[str, float]
    slow: Mapping[str, float]


def stages(programs: Programs) -> Stages:
    """Look at every instruction of the first moments of a position move."""
    elf = cost_program(programs, loops=False)
    part = _parts(elf)
    start = _address(elf, _START)
    entries = {_address(elf, name): name for name in _LOOPS}
    seen: dict[str, list[Counter[str]]] = {name: [] for name in _LOOPS}
    current: Counter[str] | None = None
    for address in _executed(elf, image(phases=1 << PHASES.index(PHASE), maximum=PERIODS)):
        if address == start:
            for loops in seen.values():
                loops.clear()
        elif address in entries:
            current = Counter()
            seen[entries[address]].append(current)
        if current is None:
            continue
        name = part.get(address, "")
        if name in _OUTSIDE:
            current = None
        else:
            current[name] += 1
    fast, slow = (_mean(seen[name][SETTLED[name] :]) for name in _LOOPS)
    return Stages(fast, slow)


def _mean(loops: list[Counter[str]]) -> dict[str, float]:
    """Mean per part, dearest first."""
    if not loops:
        raise TargetError("no loop has run")
    total: Counter[str] = Counter()
    for loop in loops:
        total.update(loop)
    return {name: number / len(loops) for name, number in total.most_common()}


def _parts(elf: Path) -> dict[int, str]:
    """The part that each instruction belongs to, such as ``control/pi``."""
    addresses = _INSTRUCTION.findall(run(["arm-none-eabi-objdump", "-d", elf]))
    command = ["arm-none-eabi-addr2line", "-a", "-i", "-e", str(elf)]
    lines = run(command, data="\n".join(addresses).encode("ascii")).splitlines()
    result: dict[int, str] = {}
    for address, files in _frames(lines):
        names = [_part_of(name) for name in files]
        result[address] = next((name for name in names if name not in _ARITHMETIC), names[-1])
    return result


def _frames(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Addresses with their files, innermost inline function first."""
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
    """``.../firmware/control/pi.h:40`` is a part of ``control/pi``."""
    path = Path(location.rsplit(":", 1)[0])
    return f"{path.parent.name}/{path.stem}"


def _address(elf: Path, symbol: str) -> int:
    for line in run(["arm-none-eabi-nm", elf]).splitlines():
        words = line.split()
        if words[-1] == symbol:
            return int(words[0], 16) & ~1
    raise TargetError(f"{elf.name} has no {symbol}")


def _single_step() -> list[str]:
    """The simulator logs an address for each block that it translates: make every block one instruction."""
    found = _VERSION.search(run([QEMU[0], "--version"]))
    if found is not None and (int(found[1]), int(found[2])) < (8, 1):
        return ["-singlestep"]
    return ["-accel", "tcg,one-insn-per-tb=on"]


def _executed(elf: Path, data: bytes) -> Iterator[int]:
    """Address of every instruction, in the order of execution."""
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
