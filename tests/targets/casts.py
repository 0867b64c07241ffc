"""``python -m targets.casts``: remove the casts and constant macros of the core one by one: whose digest changes?

`int` has 16 bits on the 56800EX as on the AVR, so a missing cast is an error that the host hides. Each removal is built
for the AVR: the compiler may refuse it or make the same machine code of it, or a replay has to give other numbers. What
no machine notices is printed, and has to be something that no number can show, such as ``-(int32_t)limit`` of a limit
that is not negative. Takes some seconds per cast; ``--room control`` looks at one folder.
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
"""Of the arithmetic, which comes before the runs."""

_TYPE: Final = r"(?:u?int(?:8|16|32|64)_t|frac(?:16|32)_t|gain_t|path_position_t|unsigned|size_t)"
_CAST: Final = re.compile(rf"(?<!\w)\({_TYPE}\)(?=\s*[\w(~\-!*])")
_MACRO: Final = re.compile(r"\bU?INT(?:16|32|64)_C\(([^()]*)\)")
_SILENT: Final = re.compile(r'/\*.*?\*/|"[^"\n]*"', re.DOTALL)
"""Comments and strings."""


@dataclass(frozen=True)
class Removal:
    """A cast, or the macro around a constant, that can be taken away.

    Attributes
    ----------
    file : str
        Below the firmware folder.
    start, end : int
        Where it stands in the text.
    rest : str
        What stays of it.
    line : int
        For people.
    removed, code : str
        The cast, and the line that it stands in.
    """

    file: str
    start: int
    end: int
    rest: str
    line: int
    removed: str
    code: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line} without {self.removed} in: {self.code}"

    def apply(self, sources: Sources, folder: Path) -> Sources:
        """Copy the sources to a folder and remove it there."""
        copy = sources.copy(folder)
        path = copy.firmware / self.file
        text = path.read_text(encoding="utf-8")
        path.write_text(text[: self.start] + self.rest + text[self.end :], encoding="utf-8")
        return copy


def removals(sources: Sources, rooms: Sequence[str] = ROOMS) -> Iterator[Removal]:
    """Every cast and constant macro of the core, generated files excepted."""
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
    """Name the machine whose digest changes, or None.

    Parameters
    ----------
    built : AvrProgram
        The program of the whole sources.
    place : Path
        For what is built; does not exist yet, and is gone afterwards.
    """
    try:
        return _notice(removal.apply(sources, place / "sources"), built, expected, place)
    finally:
        shutil.rmtree(place)


def _notice(sources: Sources, built: AvrProgram, expected: Sequence[Expectation], place: Path) -> str | None:
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
            text = "does not come to its end"
        if text is not None:
            return f"{one.name}: {text}"
    return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0; what survives has to be judged by people."""
    parser = argparse.ArgumentParser(prog="targets.casts", description=__doc__)
    parser.add_argument("--room", action="append", choices=ROOMS, help="folder of the firmware; all unless given")
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
        judge = partial(_judge, sources, built, expected, folder)
        with ThreadPoolExecutor(JOBS) as pool:
            results = []
            for removal, result in zip(found, pool.map(judge, range(len(found)), found), strict=True):
                results.append(result if result is None or ":" not in result else "other numbers")
                if result is None:
                    print(f"unnoticed: {removal}", flush=True)
    for result, count in Counter(results).most_common():
        print(f"{count:4} {result or 'unnoticed'}")
    return 0


def _judge(
    sources: Sources, built: AvrProgram, expected: Sequence[Expectation], folder: Path, index: int, removal: Removal
) -> str | None:
    return verdict(removal, sources, built, expected, folder / f"removal{index}")


if __name__ == "__main__":
    sys.exit(main())
