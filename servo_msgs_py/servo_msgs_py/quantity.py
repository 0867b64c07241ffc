"""Numbers with unit, range and format.

Variables of the board, members of its configuration, entries of files and parameters of nodes are quantities.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from servo_msgs_py.units import to_raw

FINITE: Final = sys.float_info.max
"""Limit of a range that has none."""

ABOVE_0: Final = 1e-12
"""Minimum of a range above 0."""

VALUE_MAX: Final = 1e12
"""Largest magnitude of an entry of a file; its products and squares are finite."""


@dataclass(frozen=True)
class Format:
    """Integer in the memory of the board (little endian)."""

    size: int = 0  # [bytes]; 0: not in the memory of the board
    signed: bool = False
    fraction_bits: int = 0  # bits after the binary point
    low: int = field(init=False)  # smallest integer
    high: int = field(init=False)  # largest integer

    def __post_init__(self) -> None:
        span = 1 << 8 * self.size
        object.__setattr__(self, "low", -span // 2 if self.signed else 0)
        object.__setattr__(self, "high", self.low + span - 1)

    @property
    def tsa(self) -> int:
        """Type of FreeMASTER: bits 111 S TT ZZ."""
        return 0xE0 | self.signed << 4 | bool(self.fraction_bits) << 2 | self.size.bit_length() - 1


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Number with unit and range; one of the board has a format and a resolution, too."""

    name: str = ""  # empty: the owner has it
    unit: str = ""  # SI unit; empty for pure numbers
    text: str = ""  # description
    minimum: float = -FINITE  # smallest valid value, in the unit
    maximum: float = FINITE  # largest valid value, in the unit
    whole: bool = False  # only whole numbers are valid
    optional: bool = False  # a file may leave it out
    format: Format = Format()
    lsb: float = 1.0  # value of one raw unit

    # ---- values
    def problem(self, value: object) -> str:
        """Reason why a value is not valid; empty if it is."""
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return "not a number"
        if not self.minimum <= value <= self.maximum:
            if not -FINITE <= value <= FINITE:
                return "not a finite number"
            return "too small" if value < self.minimum else "too large"
        return "not a whole number" if self.whole and value % 1 else ""

    def parse(self, text: str) -> float:
        """Value of a text.

        Raises
        ------
        ValueError
            If it is not a valid number; the text says what is valid.
        """
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if problem := self.problem(value):
            raise ValueError(f"{text.strip()!r} is {problem}; write {self.expected}")
        return value

    @property
    def expected(self) -> str:
        """Valid values, unit and description as text."""
        limits = " of either sign" if self.minimum < 0.0 < self.maximum else ""
        if 0.0 < self.minimum <= ABOVE_0:
            limits = " above 0"
        elif abs(self.minimum) < VALUE_MAX:
            limits = f" from {self.minimum:g}"
        if self.maximum < VALUE_MAX:
            limits += f" up to {self.maximum:g}"
        unit = f" [{self.unit}]" if self.unit else ""
        return f"a {'whole ' if self.whole else ''}number{limits}{unit}" + (f": {self.text}" if self.text else "")

    # ---- integers of the board
    @cached_property
    def raw_range(self) -> tuple[int, int]:
        """Limits as raw numbers; the board refuses numbers outside."""
        low, high = self.format.low, self.format.high
        if not self.format.size:
            return round(self.minimum / self.lsb), round(self.maximum / self.lsb)
        return to_raw(self.minimum, self.lsb, low, high), to_raw(self.maximum, self.lsb, low, high)

    def scale(self, raw: int) -> float | int:
        """Value of a raw number; an integer if one raw unit is 1."""
        return raw if self.lsb == 1.0 else raw * self.lsb

    def pack(self, raw: Iterable[int]) -> bytes:
        """Bytes of raw numbers in the memory of the board.

        Raises
        ------
        ValueError
            If one does not fit the format.
        """
        size, signed = self.format.size, self.format.signed
        try:
            return b"".join([int(number).to_bytes(size, "little", signed=signed) for number in raw])
        except OverflowError:
            limits = f"{self.format.low} .. {self.format.high}"
            raise ValueError(f"{self.name}: {list(raw)} does not fit {size} bytes ({limits})") from None

    def elements(self, data: bytes) -> list[int]:
        """Raw numbers of consecutive elements in the memory of the board."""
        step, signed = self.format.size, self.format.signed
        return [int.from_bytes(data[k : k + step], "little", signed=signed) for k in range(0, len(data), step)]
