"""Instructions of a board with rotating shafts by part: firmware, drivers, chip and plant, counted by valgrind.

The counts do not depend on the load of the machine. Needs valgrind and an extension compiled with line numbers.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from servo_msgs_py.units import PERIOD_NS

PERIODS: Final = 800

_PARTS: Final = (
    ("plant", ("/plant/",)),
    ("chip", ("/native/chip/", "ideal_chip", "uart", "/native/flash", "/native/board")),
    ("drivers", ("/firmware/port/",)),
    ("firmware", ("/firmware/",)),
)
"""Parts by a substring of the path of a source file; the first match counts."""

_CHILD: Final = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from bench.twin import turning
from servo_twin.board import Board
board = Board(seed=1, level=sys.argv[1])
turning(board)
board.trace(board.time_ns + {PERIODS * PERIOD_NS}, capacity=1)
"""

_FILE: Final = re.compile(r"(?P<kind>fl|fi|fe|cfi|cfl)=\((?P<number>\d+)\)(?: (?P<name>.*))?")
_COST: Final = re.compile(r"[+\-*\d]\S* (?P<cost>\d+)$")


def part_of(name: str) -> str:
    """Part of a source file."""
    return next((part for part, marks in _PARTS if any(mark in name for mark in marks)), "other")


def by_part(lines: Iterable[str]) -> dict[str, int]:
    """Instructions by part, from a callgrind file."""
    names: dict[str, str] = {}
    costs: dict[str, int] = defaultdict(int)
    part = "other"
    called = False  # the next cost is that of a call, which is counted in the callee
    for line in lines:
        if match := _FILE.match(line):
            if match["name"]:
                names[match["number"]] = match["name"]
            if not match["kind"].startswith("c"):  # kinds with c are callees
                part = part_of(names[match["number"]])
        elif line.startswith("calls="):
            called = True
        elif match := _COST.match(line):
            if not called:
                costs[part] += int(match["cost"])
            called = False
    return dict(costs)


def shares(level: str) -> Mapping[str, float] | str:
    """Instructions per PWM period by part, or the reason of a failure."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        return "not counted: there is no valgrind (apt install valgrind)"
    with tempfile.TemporaryDirectory(prefix="shares-") as folder:
        out = Path(folder) / "callgrind.out"
        command = [
            valgrind, "--tool=callgrind", "--collect-atstart=no", "--toggle-collect=*board_trace*",
            f"--callgrind-out-file={out}", sys.executable, "-c", _CHILD, level,
        ]  # fmt: skip
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode != 0:
            return f"not counted: {result.stderr.strip().splitlines()[-1]}"
        costs = by_part(out.read_text(encoding="utf-8", errors="replace").splitlines())
    if not {"plant", "chip", "firmware"} <= costs.keys():
        return "not counted: the extension has no line numbers (compile it with -g)"
    return {part: cost / PERIODS for part, cost in costs.items()}
