"""Programs for the Cortex-M3 that share the compiled firmware."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from targets.machines import CORTEX_M3, CortexM3, build_cortex
from targets.sources import ROOMS, STRICT, Sources
from targets.toolchain import compile_objects, version

OPTIMISATIONS: Final = ("-Os", "-O2", "-O3")
COMPILER: Final = "arm-none-eabi-gcc"
OBJCOPY: Final = "arm-none-eabi-objcopy"
TARGET: Final = CortexM3("-O2")
"""Target whose tools are needed for every optimisation."""

_DEBUG: Final = "-g"  # line tables do not change the instructions


def compiler() -> str:
    """Name and version of the compiler."""
    return f"{COMPILER} {version(COMPILER)}"


@dataclass(frozen=True)
class Programs:
    """The firmware, compiled with one optimisation."""

    sources: Sources  # C sources
    folder: Path  # folder of objects and programs
    optimisation: str  # compiler option

    @classmethod
    def compile(cls, sources: Sources, folder: Path, optimisation: str) -> Programs:
        """Compile each folder of the firmware into a separate folder below `folder`."""
        options = [*STRICT, *CORTEX_M3, optimisation, _DEBUG, f"-I{sources.firmware}"]
        for room in ROOMS:
            objects = folder / room
            objects.mkdir(parents=True)
            compile_objects([COMPILER, *options], sources.core([room]), objects, sources.root)
        return cls(sources, folder, optimisation)

    @property
    def bench(self) -> Path:
        """C sources of the programs."""
        return self.sources.root / "tests" / "bench" / "native"

    def objects(self, rooms: Sequence[str] = ROOMS) -> list[Path]:
        """Object files of the firmware."""
        return [path for room in rooms for path in sorted((self.folder / room).glob("*.o"))]

    def link(self, name: str, files: Sequence[Path], options: Sequence[str] = ()) -> Path:
        """Link objects and C files with the start-up code."""
        everything = [*CORTEX_M3, self.optimisation, _DEBUG, f"-I{self.bench}", *options]
        return build_cortex(self.sources, self.folder / f"{name}.elf", files, everything)
