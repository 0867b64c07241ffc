"""How long the core of the DSC is busy with each interrupt handler (``core.toml``)."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["CoreLoad"]

DEFAULT_FILE: Final = Path(__file__).with_name("core.toml")


@dataclass(frozen=True)
class CoreLoad:
    """Length of each handler in clocks of the bus (10 ns).

    Attributes
    ----------
    m1, m1_slow, m1_watch : int
        M1 with nothing but its fast loop, with the slow loop of motor 2, with the watches of motor 2.
    m2, m2_slow, m2_watch : int
        The same of M2, with motor 1.
    start, edge, fault, receive : int
        Start of the sequence, captured encoder edge, over-current break, byte from the host.
    """

    m1: int
    m1_slow: int
    m1_watch: int
    m2: int
    m2_slow: int
    m2_watch: int
    start: int
    edge: int
    fault: int
    receive: int

    @classmethod
    def load(cls, path: Path | str | None = None) -> CoreLoad:
        """Read instruction counts and what an instruction costs; the packaged file by default.

        Raises
        ------
        ValueError
            If a handler is missing or unknown, or lasts less than one clock.
        """
        with open(path or DEFAULT_FILE, "rb") as file:
            return cls.parse(tomllib.load(file))

    @classmethod
    def longest(cls, path: Path | str | None = None) -> CoreLoad:
        """The same with every feature of the firmware on, at its longest."""
        with open(path or DEFAULT_FILE, "rb") as file:
            table = tomllib.load(file)
        return cls.parse({**table, "instructions": {**table["instructions"], **table["instructions_most"]}})

    @classmethod
    def parse(cls, table: Mapping[str, Any]) -> CoreLoad:
        """Lengths out of a parsed table."""
        instructions = dict(table["instructions"])
        names = {field.name for field in fields(cls)}
        if set(instructions) != names:
            raise ValueError(f"core load: handlers are {sorted(names)}, not {sorted(instructions)}")
        entry, each = float(table["entry_cycles"]), float(table["cycles_per_instruction"])
        lengths = {name: round(entry + each * float(count)) for name, count in instructions.items()}
        for name, length in lengths.items():
            if not 0 < length < 1 << 32:
                raise ValueError(f"core load: {name} lasts {length} clocks")
        return cls(**lengths)
