"""``python -m targets.casts``: mutation test that removes the casts and constant macros of the core one by one.

`int` has 16 bits on the 56800EX and on the AVR, so a missing cast is an error that the host does not show. Each mutant
is built for the AVR: it does not compile, it has the same machine code, or a replay must give other numbers. Surviving
mutants are printed; they must be without effect, such as ``-(int32_t)limit`` of a limit that is not negative. A cast
takes some seconds; ``--room control`` tests one folder.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from targets.comparison import Expectation, first_difference
from targets.machines import Avr, AvrProgram
from targets.recording import Recorder
from targets.scenarios import SCENARIOS
from targets.sources import ROOMS, Sources
from targets.toolchain import JOBS, TargetError

ROUNDS: Final = 60
"""Rounds of the arithmetic, which is tested before the runs."""

_TYPE: Final = r"(?:u?int(?:8|16|32|64)_t|frac(?:16|32)_t|gain_t|path_position_t|unsigned|size_t)"
_CAST: Final = re.compile(rf"(?<!\w)\({_TYPE}\)(?=\s*[\w(~\-!*])")
_MACRO: Final = re.compile(r"\bU?INT(?:16|32|64)_C\(([^()]*)\)")
_SILENT: Final = re.compile(r'/\*.*?\*/|"[^"\n]*"', re.DOTALL)
"""Comments and strings."""


@dataclass(frozen=True)
class Removal:
    """A cast, or a macro around a constant, that can be removed."""

    file: str  # path below the firmware folder
    start: int  # first character in the file
    end: int  # character after it
    rest: str  # replacement
    line: int  # line number, from 1
    removed: str  # the cast or macro
    code: str  # its line

    def __str__(self) -> str:
        return f"{self.file}:{self.line} without {self.removed} in: {self.code}"

    def apply(self, sources: Sources, folder: Path) -> Sources:
        """Copy the sources to a folder and remove it in the copy."""
        copy = sources.copy(folder)
        path = copy.firmware / self.file
        text = path.read_text(encoding="utf-8")
        path.write_text(text[: self.start] + self.rest + text[self.end :], encoding="utf-8")
        return copy


def removals(sources: Sources, rooms: Sequence[str] = ROOMS) -> Iterator[Removal]:
    """Every cast and constant macro of the core, except in generated files."""
    for room in rooms:
        for path in sorted((sources.firmware / room).glob("*.[ch]")):
            if not path.stem.endswith("_gen"):
                yield from _removals(str(path.relative_to(sources.firmware)), path.read_text(encoding="utf-8"))


def _removals(file: str, text: str) -> Iterator[Removal]:
    code = _SILENT.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    lines = text.splitlines()
    for match in [*_CAST.finditer(code), *_MACRO.finditer(code)]:
        line = text.count("\n", 0, match.start())
        rest = match[1] if match.re is _MACRO else ""
        yield Removal(file, match.start(), match.end(), rest, line + 1, match[0], lines[line].strip())


def verdict(
    removal: Removal, sources: Sources, built: AvrProgram, expected: Sequence[Expectation], place: Path
) -> str | None:
    """Detection of a removal as text, or None.

    Parameters
    ----------
    built : AvrProgram
        Program of the unchanged sources.
    place : Path
        Temporary folder of the build; must not exist.
    """
    try:
        return _detection(removal.apply(sources, place / "sources"), built, expected, place)
    finally:
        shutil.rmtree(place)


def _detection(sources: Sources, built: AvrProgram, expected: Sequence[Expectation], place: Path) -> str | None:
    try:
        program = Avr().build(sources, place)
    except TargetError:
        return "refused by the compiler"
    if program.elf.read_bytes() == built.elf.read_bytes():
        return "the same machine code"
    for one in expected:
        try:
            _, text = first_difference(program, one)
        except (TargetError, ValueError):
            text = "does not terminate normally"
        if text is not None:
            return f"{one.name}: {text}"
    return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0; surviving mutants need a review."""
    parser = argparse.ArgumentParser(prog="targets.casts", description=__doc__)
    parser.add_argument("--room", action="append", choices=ROOMS, help="folder of the firmware; default: all")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="casts-") as name:
        folder = Path(name)
        sources = Sources().copy(folder / "sources")
        built = Avr().build(sources, folder)
        recorder = Recorder(sources, folder)
        runs = sorted((recorder.record(scenario) for scenario in SCENARIOS), key=lambda run: len(run.image))
        expected: list[Expectation] = [recorder.arithmetic(rounds=ROUNDS), *runs]
        found = list(removals(sources, options.room or ROOMS))
        print(f"{len(found)} casts and constants", flush=True)
        test_removal = partial(_test_removal, sources, built, expected, folder)
        with ThreadPoolExecutor(JOBS) as pool:
            results = []
            for removal, result in zip(found, pool.map(test_removal, range(len(found)), found), strict=True):
                results.append(result if result is None or ":" not in result else "other numbers")
                if result is None:
                    print(f"survived: {removal}", flush=True)
    for result, count in Counter(results).most_common():
        print(f"{count:4} {result or 'survived'}")
    return 0


def _test_removal(
    sources: Sources, built: AvrProgram, expected: Sequence[Expectation], folder: Path, index: int, removal: Removal
) -> str | None:
    return verdict(removal, sources, built, expected, folder / f"removal{index}")


if __name__ == "__main__":
    sys.exit(main())
