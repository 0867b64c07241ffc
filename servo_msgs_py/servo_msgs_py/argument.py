"""Numbers on a command line, as types for `argparse`."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError


def finite(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def not_negative(text: str) -> float:
    """A finite number of at least 0."""
    if (value := finite(text)) < 0.0:
        raise ArgumentTypeError(f"{text} is below 0")
    return value


def positive(text: str) -> float:
    """A finite number above 0."""
    if (value := finite(text)) <= 0.0:
        raise ArgumentTypeError(f"{text} is not above 0")
    return value


def count(text: str) -> int:
    """A whole number of at least 1."""
    if not (value := positive(text)).is_integer():
        raise ArgumentTypeError(f"{text} is not a whole number")
    return int(value)
