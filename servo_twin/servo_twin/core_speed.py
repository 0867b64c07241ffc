"""Execution time of the core of the DSC (``core.toml``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.quantity import ABOVE_0, Quantity
from servo_msgs_py.text_file import read_toml

DEFAULT_FILE: Final = Path(__file__).with_name("core.toml")

_VALUES: Final[Mapping[str, Quantity]] = {
    "cycles_per_instruction": Quantity(minimum=ABOVE_0, maximum=100.0),
    "entry_cycles": Quantity(minimum=0.0, maximum=10_000.0, whole=True),
}


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
        for name, valid in _VALUES.items():
            value = getattr(self, name)
            if problem := valid.problem(value):
                raise ValueError(f"{name} = {value!r} is {problem}; write {valid.expected}")

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
            raise ValueError(f"expected the values {names}, found {sorted(table)}")
        return cls(**table)


@lru_cache(maxsize=1)
def _packaged() -> CoreSpeed:
    return _read(DEFAULT_FILE)


def _read(path: Path) -> CoreSpeed:
    try:
        return CoreSpeed.parse(read_toml(path))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
