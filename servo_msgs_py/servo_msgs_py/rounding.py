"""Rounding of numbers that a message proposes."""

import math
from collections.abc import Callable


def rounded_up(value: float) -> float:
    """Value above 0 rounded up to two digits."""
    return _two_digits(value, math.ceil)


def rounded_down(value: float) -> float:
    """Value above 0 rounded down to two digits."""
    return _two_digits(value, math.floor)


def _two_digits(value: float, whole: Callable[[float], int]) -> float:
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(round(whole(value / unit) * unit, 9))
