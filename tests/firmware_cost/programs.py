"""Programs for the Cortex-M3 that share the compiled firmware."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from targets.machines import CORTEX_M3, CortexM3, build_cortex_m3
from targets.sources import ROOMS, STRICT, Sources
from targets.toolchain import compile_objects, version

OPTIMISATIONS: Final = ("-Os", "-O2", "-O3")
COMPILER: Final = "arm-none-eabi-gcc"
TARGET: Final = CortexM3("-O2")
"""The machine; its tools serve every optimisation."""

_DEBUG: Final = "-g"  # line tables change no instruction


def compiler() -> str:
    """Name and version of the compiler, of which every number is a consequence."""
    return f"{COMPILER} {version(COMPILER)}"


@dataclass(frozen=True)
class Programs:
    """The firmware, compiled with one optimisation.

    Attributes
    ----------
    sources : Sources
    folder : Path
        Where objects and programs are.
    optimisation : str
    """

    sources: Sources
    folder: Path
    optimisation: str

    @classmethod
    def compile(cls, sources: Sources, folder: Path, optimisation: str) -> Programs:
        """Compile every room of the firmware into a folder of its own below `folder`."""
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
        """Compiled firmware."""
        return [path for room in rooms for path in sorted((self.folder / room).glob("*.o"))]

    def link(self, name: str, files: Sequence[Path], options: Sequence[str] = ()) -> Path:
        """Link objects and C files with the machine."""
        everything = [self.optimisation, _DEBUG, f"-I{self.bench}", *options]
        return build_cortex_m3(self.sources, self.folder / f"{name}.elf", files, everything)
