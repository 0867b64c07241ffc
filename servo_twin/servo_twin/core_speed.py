"""How fast the core of the DSC is (``core.toml``)."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEFAULT_FILE: Final = Path(__file__).with_name("core.toml")


@dataclass(frozen=True)
class CoreSpeed:
    """What the firmware's instructions cost.

    Raises
    ------
    ValueError
        If an instruction takes no time, or an interrupt less than none.
    """

    cycles_per_instruction: float  # clocks of the bus (10 ns) for each instruction that a Cortex-M3 would execute
    entry_cycles: int  # clocks of each interrupt besides those: vector, saving and restoring of registers

    def __post_init__(self) -> None:
        if not 0.0 < self.cycles_per_instruction <= 100.0:
            raise ValueError(f"core: {self.cycles_per_instruction} cycles per instruction; more than 0, at most 100")
        if not 0 <= self.entry_cycles <= 10_000:
            raise ValueError(f"core: an interrupt begins with {self.entry_cycles} cycles; 0 to 10000")

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
        """The values of a parsed table."""
        names = [field.name for field in fields(cls)]
        if sorted(table) != sorted(names):
            raise ValueError(f"core: the values are {names}, not {sorted(table)}")
        return cls(float(table["cycles_per_instruction"]), int(table["entry_cycles"]))


@lru_cache(maxsize=1)
def _packaged() -> CoreSpeed:
    return _read(DEFAULT_FILE)


def _read(path: Path) -> CoreSpeed:
    with path.open("rb") as file:
        return CoreSpeed.parse(tomllib.load(file))
