"""C sources of all programs of a run."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]

ROOMS: Final = ("math", "control", "sensing", "diagnosis", "drive", "app", "comm", "config")
"""Folders of the firmware that make up the core."""

STRICT: Final = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror")
"""Options of every compiler: implicit conversions are errors."""

SAMPLES: Final = "-DSERVO_SAMPLES=384"
"""Sample memory of the recorders on every target [bytes], limited by the smallest target."""

_FOLDERS: Final = ("firmware", "servo_twin/native", "tests/targets/native", "tests/bench/native")
_REPLAY: Final = ("replay_main", "replay", "replay_hal", "arithmetic", "digest", "trace_reader", "text")
_IDEAL_BOARD: Final = ("board", "board_ideal", "flash", "ideal_chip", "uart")
"""Files of the virtual board at level `ideal`."""
_RECORDER: Final = ("recorder", "arithmetic", "digest")


@dataclass(frozen=True)
class Sources:
    """C sources below one root."""

    root: Path = ROOT  # the checkout, or a copy of its C sources

    def copy(self, folder: Path) -> Sources:
        """Copy the C sources to `folder`."""
        for name in _FOLDERS:
            source = self.root / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("test", "build", "__pycache__"))
        return Sources(folder)

    @property
    def firmware(self) -> Path:
        return self.root / "firmware"

    @property
    def twin(self) -> Path:
        return self.root / "servo_twin" / "native"

    @property
    def native(self) -> Path:
        return self.root / "tests" / "targets" / "native"

    def port(self, name: str) -> Path:
        return self.firmware / "port" / name

    def core(self, rooms: Iterable[str] = ROOMS) -> list[Path]:
        """C files of the firmware that run on every target."""
        return [path for room in rooms for path in sorted((self.firmware / room).glob("*.c"))]

    def replay(self) -> list[Path]:
        """C files of the replay program, in addition to the core and the machine."""
        return [self.native / f"{name}.c" for name in _REPLAY]

    def recorder(self) -> list[Path]:
        """C files of the recorder: core, virtual board and the layer between them."""
        board = [*(self.twin / f"{name}.c" for name in _IDEAL_BOARD), *sorted((self.twin / "plant").glob("*.c"))]
        return [*self.core(), *board, *(self.native / f"{name}.c" for name in _RECORDER)]
