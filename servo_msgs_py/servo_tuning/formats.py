"""Fixed-point integer formats of the firmware."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from servo_tuning.errors import Remedy, refused


@dataclass(frozen=True)
class Format:
    """Raw numbers ``low .. high`` in units of ``2 ** -fraction_bits``."""

    name: str  # for messages
    fraction_bits: int  # of the value
    low: int  # smallest raw number
    high: int  # largest raw number

    def raw(self, entry: str, value: float, *remedies: Remedy | str, given: float | None = None) -> int:
        """Return the nearest raw number.

        Parameters
        ----------
        entry : str
            Full name of the entry, or of the quantity computed from several entries; for the refusal.
        value : float
            Value to convert.
        *remedies : Remedy or str
            Corrections; for the refusal.
        given : float, optional
            Value in the configuration, if it is not `value` itself.

        Raises
        ------
        ConfigError
            If the value does not fit, or is rounded to 0 although it is not 0.
        """
        scaled = math.ldexp(value, self.fraction_bits)
        raw = round(scaled)
        shown, result = (value, "") if given is None else (given, f"{value:g} ")
        if raw == 0 and value != 0.0:
            raise refused(entry, shown, f"{result}is too small for {self.name} and would vanish in rounding", *remedies)
        if not self.low <= raw <= self.high:
            low, high = (math.ldexp(bound, -self.fraction_bits) for bound in (self.low, self.high))
            raise refused(entry, shown, f"{result}does not fit {self.name} ({low:g} .. {high:g})", *remedies)
        return raw

    @property
    def lsb(self) -> float:
        """Value of the smallest step."""
        return math.ldexp(1.0, -self.fraction_bits)

    def value(self, raw: int) -> float:
        """Value of a raw number, as a fraction of full scale."""
        return math.ldexp(raw, -self.fraction_bits)


GAIN: Final = Format("gain_t", 24, -(2**31), 2**31 - 1)
FRAC16: Final = Format("frac16_t", 15, -(2**15), 2**15 - 1)
FRAC32: Final = Format("frac32_t", 31, -(2**31), 2**31 - 1)
INT16_Q8: Final = Format("int16_t with 8 fraction bits", 8, -(2**15), 2**15 - 1)
UINT16: Final = Format("uint16_t", 0, 0, 2**16 - 1)
UINT16_Q14: Final = Format("uint16_t with 14 fraction bits", 14, 0, 2**16 - 1)
INT32_Q16: Final = Format("int32_t with 16 fraction bits", 16, 1, 2**31 - 1)
