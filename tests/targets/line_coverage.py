"""Lines of the core that no replay executes (gcov)."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from targets.machines import Host
from targets.sources import Sources
from targets.toolchain import run

_COUNTED: Final = Host("gcov", "gcc", ("-O0", "--coverage"), "counts lines", ("gcc",))


@dataclass(frozen=True)
class MissedLine:
    """A line of the core that was compiled but not executed."""

    file: str
    function: str
    number: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.number} in {self.function}: {self.text}"


def missed_lines(sources: Sources, images: Iterable[bytes], folder: Path) -> list[MissedLine]:
    """Replay images with counters on the host.

    Parameters
    ----------
    folder : Path
        Empty folder for the build.

    Raises
    ------
    TargetError
        If something does not build or run.
    """
    program = _COUNTED.build(sources, folder)
    for image in images:
        program.run(image)
    counted = sorted(folder.glob("*.gcda"))
    lines: dict[tuple[str, int], tuple[str, int]] = {}
    for data in counted:
        report = json.loads(run(["gcov", "--json-format", "--stdout", data], folder=folder))
        for file in report["files"]:
            path = sources.root / file["file"]
            if not path.is_relative_to(sources.firmware):
                continue
            for line in file["lines"]:
                key = str(path.relative_to(sources.firmware)), int(line["line_number"])
                function, count = lines.get(key, (str(line.get("function_name", "")), 0))
                lines[key] = function, count + int(line["count"])
    return [
        MissedLine(file, function, number, _text(sources.firmware / file, number))
        for (file, number), (function, count) in sorted(lines.items())
        if count == 0
    ]


def _text(path: Path, number: int) -> str:
    return path.read_text(encoding="utf-8").splitlines()[number - 1].strip()
