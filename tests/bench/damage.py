"""Client and server of the firmware on a line that damages bytes in both directions: ``make bench-damage``.

One byte of a frame is changed or lost. No wrong value may be written or read: a variable has the value of the last
successful write, or of a later write that failed. No byte is inserted: CRC-8 would accept one of 256 such frames.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "servo_bridge" / "test"), str(ROOT / "firmware" / "test")]

from fake_transport import client_on  # noqa: E402
from firmware_compiler import CompileC  # noqa: E402
from freemaster_board import CDEF, Board  # noqa: E402
from freemaster_model import COMM_SOURCES, ENTRIES, SERVO  # noqa: E402
from lossy_line import LossyLine  # noqa: E402
from servo_bridge.freemaster.commands import ScopeSlot  # noqa: E402
from servo_bridge.freemaster.errors import FreemasterError  # noqa: E402

VARIABLES: Final = tuple(
    entry for entry in ENTRIES if entry.name in ("M.var_u16", "M.var_i32", "M.ramp", "M.word0", "M.pair")
)
"""Written variables; no other byte of the memory may change."""

FRAMES: Final = 1_000_000
DAMAGED_FRACTION: Final = 0.33


@dataclass
class Report:
    """Counts of a run on a line with damage."""

    damaged: int = 0  # damaged frames
    exchanges: int = 0  # requests of the user
    failed: int = 0  # requests that failed after all retries
    wrong_writes: int = 0  # variables with a wrong value in the memory
    wrong_reads: int = 0  # variables that were read with a wrong value


def new_server(folder: Path) -> Board:
    """Server of the firmware with the memory layout of the product."""
    table = folder / "table.c"
    table.write_text(SERVO.c_source(), encoding="ascii")
    sources: list[str | Path] = [*COMM_SOURCES, "test/freemaster_harness.c", table]
    ffi, lib = CompileC(folder)("freemaster_damage", sources, CDEF, SERVO.defines)
    return Board(ffi, lib, SERVO)


def run(board: Board, frames: int, seed: int = 1, damaged_fraction: float = DAMAGED_FRACTION) -> Report:
    """Write, read and sample variables until `frames` frames have been damaged."""
    line = LossyLine(board.send, seed=seed)
    client = client_on(line)
    client.identify()
    base, random, report = SERVO.variables, line.random, Report()
    memory = board.memory()
    allowed = {entry: {memory[entry.at : entry.at + entry.size]} for entry in VARIABLES}
    scope = client.set_scope([ScopeSlot(base + entry.at, entry.size) for entry in VARIABLES])
    line.damage = damaged_fraction
    while line.damaged < frames:
        entry = random.choice(VARIABLES)
        report.exchanges += 1
        try:
            match random.randrange(3):
                case 0:
                    data = random.randbytes(entry.size)
                    allowed[entry].add(data)
                    client.write_memory(base + entry.at, data)
                    allowed[entry] = {data}
                case 1:
                    report.wrong_reads += client.read_memory(base + entry.at, entry.size) not in allowed[entry]
                case 2:
                    data = client.exchange(scope).data
                    for variable in VARIABLES:
                        report.wrong_reads += data[: variable.size] not in allowed[variable]
                        data = data[variable.size :]
        except FreemasterError:
            report.failed += 1
        found = board.memory()
        for variable in VARIABLES:
            part = slice(variable.at, variable.at + variable.size)
            report.wrong_writes += found[part] not in allowed[variable]
            found = found[: part.start] + memory[part] + found[part.stop :]
        report.wrong_writes += found != memory
        line.requests.clear()
        line.sent_at.clear()
    report.damaged = line.damaged
    return report


def main() -> int:
    """Run the command line; exit status 1 if a wrong value was written or read."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--frames", type=int, default=FRAMES, help="damaged frames (default: %(default)d)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        report = run(new_server(Path(folder)), arguments.frames, arguments.seed)
    print(
        f"{report.damaged} damaged frames, {report.exchanges} requests: {report.failed} failed after all retries, "
        f"{report.wrong_writes} wrong values written and {report.wrong_reads} read"
    )
    return int(report.wrong_writes + report.wrong_reads > 0)


if __name__ == "__main__":
    sys.exit(main())
