"""Cost of the firmware on a Cortex-M3: ``make bench-firmware``.

Prints the table and its difference from the committed one, and writes the numbers as JSON.
"""

from __future__ import annotations

import argparse
import difflib
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_cost.calibration import weights_text
from firmware_cost.measurement import measure, plain
from firmware_cost.programs import TARGET
from firmware_cost.table import origin_of, problems, table
from servo_twin._core_time import WEIGHTS
from targets.machines import missing_text
from targets.sources import ROOT, Sources
from targets.toolchain import TargetError

TABLE: Final = Path(__file__).with_name("firmware_cost.md")


def difference(new: str) -> list[str]:
    """Difference of a table from the committed one, as lines."""
    old = TABLE.read_text(encoding="utf-8") if TABLE.exists() else ""
    return list(difflib.unified_diff(old.splitlines(), new.splitlines(), "committed", "measured", n=0, lineterm=""))


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 if everything was measured and is as it must be; a difference from the committed table is no error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "bench" / "firmware.json", metavar="FILE")
    parser.add_argument(
        "--update", action="store_true", help=f"write {TABLE.relative_to(ROOT)} and {WEIGHTS.relative_to(ROOT)}"
    )
    options = parser.parse_args(arguments)
    if not TARGET.available():
        print(missing_text(TARGET), file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory(prefix="cost-") as name:
        try:
            measurement = measure(Sources().copy(Path(name) / "sources"), Path(name) / "build")
            found = problems(measurement)
        except TargetError as error:
            print(error, file=sys.stderr)
            return 1
    text = table(measurement)
    print(text)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(plain(measurement), indent=1) + "\n", encoding="utf-8")
    if found:
        print("\n".join(found), file=sys.stderr)
        return 1
    if options.update:
        TABLE.write_text(text, encoding="utf-8")
        WEIGHTS.write_text(weights_text(measurement.weights), encoding="utf-8")
    _print_status(text)
    return 0


def _print_status(text: str) -> None:
    committed, _ = origin_of(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else ("", "")
    if committed != origin_of(text)[0]:
        print(f"The committed table was made with {committed or 'nothing'}.")
    changes = difference(text)
    print("\n".join(changes) or "The committed table says the same.")
    if changes:
        print("The committed table is out of date: `make bench-firmware UPDATE=1` writes it.")


if __name__ == "__main__":
    sys.exit(main())
