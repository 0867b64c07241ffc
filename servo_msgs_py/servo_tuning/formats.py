"""Fixed-point integer formats of the firmware."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.quantity import Quantity

from servo_tuning.errors import Entry, Remedy, refused


class FixedPoint(Quantity):
    """Fraction of a full scale as an integer of the firmware."""

    def raw(self, entry: Entry | str, value: float, *remedies: Remedy | str, given: float | None = None) -> int:
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
        raw = round(value / self.lsb)
        shown, result = (value, "") if given is None else (given, f"{value:g} ")
        if raw == 0 and value != 0.0:
            raise refused(entry, shown, f"{result}is too small for {self.name} and would vanish in rounding", *remedies)
        low, high = self.raw_range
        if not low <= raw <= high:
            limits = f"{self.minimum:g} .. {self.maximum:g}"
            raise refused(entry, shown, f"{result}does not fit {self.name} ({limits})", *remedies)
        return raw


def fixed_point(name: str, fraction_bits: int, low: int, high: int) -> FixedPoint:
    """Raw numbers `low` to `high` in units of ``2 ** -fraction_bits``; `name` for messages."""
    lsb = math.ldexp(1.0, -fraction_bits)
    return FixedPoint(name=name, lsb=lsb, minimum=low * lsb, maximum=high * lsb)


@cache
def member_format(path: str) -> FixedPoint:
    """Format and range of a member of the configuration block, as in ``axis_config.toml``."""
    member = AxisConfigTable.load().members[path]
    return fixed_point(path, member.format.fraction_bits, *member.raw_range)


GAIN: Final = fixed_point("gain_t", 24, -(2**31), 2**31 - 1)
FRAC16: Final = fixed_point("frac16_t", 15, -(2**15), 2**15 - 1)
FRAC32: Final = fixed_point("frac32_t", 31, -(2**31), 2**31 - 1)
UINT16: Final = fixed_point("uint16_t", 0, 0, 2**16 - 1)
