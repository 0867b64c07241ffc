"""Fractional formats of the firmware and SI units.

The controller computes in Q1.15 and Q1.31 fractions of a full scale (DRM 4.1, 4.2); everything else computes in SI.
These functions are the only place of the conversion.
"""

from __future__ import annotations

import math
from typing import Final

from servo_msgs_py.board_description import BoardDescription

COUNTS_PER_TURN: Final = 4000
"""Unit of positions in the contract, per mechanical revolution: a count of a 1000-line encoder (DRM 2.4.1)."""

PERIOD_NS: Final = BoardDescription.load().period_ns
"""Length of one PWM period [ns]."""

SLOW_PERIODS: Final = 8
"""PWM periods per slow loop (DRM 2.3.2), on every board."""

TICK_NS: Final = PERIOD_NS * SLOW_PERIODS
"""Length of one slow tick [ns]."""

PERIOD: Final = PERIOD_NS * 1e-9
"""Length of one PWM period [s]."""

TICK: Final = PERIOD * SLOW_PERIODS
"""Length of one slow tick [s]."""


def to_raw(value: float, lsb: float, low: int, high: int) -> int:
    """Round an SI value to the nearest raw number.

    Parameters
    ----------
    value : float
        Finite value in the unit of `lsb`.
    lsb : float
        SI value of one raw unit.
    low, high : int
        Range of the raw type.

    Raises
    ------
    ValueError
        If `value` is not finite or is more than one raw unit outside the range. The tolerance of one unit is needed for
        the full scale, which exceeds the largest signed fraction by one unit.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value!r} is not a finite number")
    raw = round(value / lsb)
    if not low - 1 <= raw <= high + 1:
        raise ValueError(f"{value:g} is outside {low * lsb:g} .. {high * lsb:g}")
    return min(max(raw, low), high)


def rpm(speed: float) -> float:
    """Speed [rad/s] in revolutions per minute."""
    return speed * (30.0 / math.pi)


def unwrap_u32(raw: int, previous: int) -> int:
    """Extend a 32-bit counter to an unbounded integer.

    Parameters
    ----------
    raw : int
        New reading, 0 .. 2^32 - 1.
    previous : int
        Last extended value; the new one is within +-2^31 of it.
    """
    return previous + ((raw - previous + 0x8000_0000) & 0xFFFF_FFFF) - 0x8000_0000
