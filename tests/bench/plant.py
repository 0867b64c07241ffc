"""CPU time of one PWM period of both axes in the plant alone: switching level and averaged, in one run.

Compiles ``plant/bench_plant.c`` with the options of the extension module, and again with the general integrations alone
(``PLANT_GENERAL``), prints both tables and writes them as JSON. No firmware and no chip take part.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from servo_msgs_py.units import PERIOD_NS
from servo_twin._build_native import CFLAGS, NATIVE, WARNINGS

ROOT: Final = Path(__file__).resolve().parents[2]
SOURCE: Final = Path(__file__).parent / "plant" / "bench_plant.c"

_ROW: Final = re.compile(
    r"\s*(?P<volts>\d+) V\s+(?P<load>\d+) mN m: switching\s+(?P<switching_ns>\d+) ns,"
    r" averaged\s+(?P<averaged_ns>\d+) ns per period, ratio (?P<ratio>[\d.]+), (?P<encoder_edges>[\d.]+) encoder edges"
)


def run(periods: int, *options: str) -> str:
    """Table of the bench, compiled with more options.

    Raises
    ------
    subprocess.CalledProcessError
        If it does not compile or does not run.
    """
    compiler = shlex.split(os.environ.get("CC", "cc"))
    with tempfile.TemporaryDirectory(prefix="bench-plant-") as folder:
        program = str(Path(folder) / "bench_plant")
        sources = [str(path) for path in [*sorted((NATIVE / "plant").glob("*.c")), SOURCE]]
        subprocess.run(
            [*compiler, *CFLAGS, *WARNINGS, *options, f"-I{NATIVE}", *sources, "-o", program, "-lm"], check=True
        )
        return subprocess.run([program, str(periods)], check=True, capture_output=True, text=True).stdout


def rows(text: str) -> list[dict[str, float]]:
    """Numbers of the table, one entry per line."""
    matches = [_ROW.fullmatch(line) for line in text.splitlines()]
    return [{name: float(value) for name, value in match.groupdict().items()} for match in matches if match]


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 unless the bench could not be compiled or run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--periods", type=int, default=32_000)
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "bench" / "plant.json", metavar="FILE")
    options = parser.parse_args(arguments)
    builds = {"fast": (), "general": ("-DPLANT_GENERAL",)}
    table: dict[str, list[dict[str, float]]] = {}
    for name, defines in builds.items():
        try:
            text = run(options.periods, *defines)
        except (OSError, subprocess.CalledProcessError) as error:
            print(error, file=sys.stderr)
            return 1
        print(f"{name}:\n{text}", end="")
        table[name] = rows(text)
    for plant in ("switching", "averaged"):
        fast, general = (sum(row[f"{plant}_ns"] for row in table[name]) for name in builds)
        worst = PERIOD_NS / max(row[f"{plant}_ns"] for row in table["fast"])
        print(f"{plant}: at least {worst:.0f} times real time, {general / fast:.2f} x the general integration")
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
