"""Execution time of the core of the DSC (``core.toml``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.text_file import TextFileError, read_toml

DEFAULT_FILE: Final = Path(__file__).with_name("core.toml")


@dataclass(frozen=True)
class CoreSpeed:
    """Execution time of the instructions of the firmware.

    Raises
    ------
    ValueError
        If a value is out of range.
    """

    cycles_per_instruction: float  # bus clocks (10 ns) per instruction of a Cortex-M3
    entry_cycles: int  # additional bus clocks per interrupt: vector fetch, saving and restoring of registers

    def __post_init__(self) -> None:
        if not 0.0 < self.cycles_per_instruction <= 100.0:
            raise ValueError(
                f"core: cycles_per_instruction {self.cycles_per_instruction} is not above 0 and at most 100"
            )
        if not 0 <= self.entry_cycles <= 10_000:
            raise ValueError(f"core: entry_cycles {self.entry_cycles} is not within 0 .. 10000")

    @classmethod
    def load(cls, path: Path | str | None = None) -> CoreSpeed:
        """Read a file like the packaged ``core.toml``, which is the default.

        Raises
        ------
        ValueError
            If a value is missing, unknown or out of range.
        """
        return _packaged() if path is None else _read(Path(path))

    @classmethod
    def parse(cls, table: Mapping[str, Any]) -> CoreSpeed:
        """Create from a parsed table."""
        names = [field.name for field in fields(cls)]
        if sorted(table) != sorted(names):
            raise ValueError(f"core: expected the values {names}, found {sorted(table)}")
        return cls(float(table["cycles_per_instruction"]), int(table["entry_cycles"]))


@lru_cache(maxsize=1)
def _packaged() -> CoreSpeed:
    return _read(DEFAULT_FILE)


def _read(path: Path) -> CoreSpeed:
    try:
        return CoreSpeed.parse(read_toml(path))
    except TextFileError as error:
        raise ValueError(f"{path}: {error}") from None
