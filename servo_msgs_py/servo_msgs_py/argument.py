"""Numbers on a command line, as types for `argparse`."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError
from typing import Final

from servo_msgs_py.quantity import ABOVE_0, Quantity

_FINITE: Final = Quantity()
_NOT_NEGATIVE: Final = Quantity(minimum=0.0)
_POSITIVE: Final = Quantity(minimum=ABOVE_0)
_COUNT: Final = Quantity(minimum=1.0, whole=True)


def finite(text: str, valid: Quantity = _FINITE) -> float:
    """A finite number that is valid for a quantity."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if problem := valid.problem(value):
        raise ArgumentTypeError(f"{text.strip()!r} is {problem}; write {valid.expected}")
    return value


def not_negative(text: str) -> float:
    """A finite number of at least 0."""
    return finite(text, _NOT_NEGATIVE)


def positive(text: str) -> float:
    """A finite number above 0."""
    return finite(text, _POSITIVE)


def count(text: str) -> int:
    """A whole number of at least 1."""
    return int(finite(text, _COUNT))
