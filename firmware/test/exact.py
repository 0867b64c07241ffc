"""Exact integer arithmetic for the references of the tests, independent of the firmware."""

from __future__ import annotations

from hypothesis import strategies as st

MIN16, MAX16 = -(2**15), 2**15 - 1
MIN32, MAX32 = -(2**31), 2**31 - 1
GAIN_ONE = 2**24


def edges(low: int, high: int) -> st.SearchStrategy[int]:
    """Integers with more examples at the ends of the range and near zero."""
    special = [low, low + 1, -1, 0, 1, high - 1, high, low // 2, high // 2]
    return st.one_of(st.sampled_from([x for x in special if low <= x <= high]), st.integers(low, high))


def near(*centres: int) -> st.SearchStrategy[int]:
    """The given numbers and their neighbours."""
    return st.builds(int.__add__, st.sampled_from(centres), st.integers(-2, 2))


I16, I32, I64 = edges(MIN16, MAX16), edges(MIN32, MAX32), edges(-(2**63), 2**63 - 1)
U16 = edges(0, 2**16 - 1)
FRACTION16, FRACTION32 = edges(0, MAX16), edges(0, MAX32)


def clip(x: int, low: int, high: int) -> int:
    """Saturation."""
    return min(max(x, low), high)


def clip16(x: int) -> int:
    return clip(x, MIN16, MAX16)


def clip32(x: int) -> int:
    return clip(x, MIN32, MAX32)


def wrap(x: int, bits: int) -> int:
    """Two's complement."""
    half = 1 << (bits - 1)
    return (x + half) % (2 * half) - half


def nearest(numerator: int, denominator: int) -> int:
    """Nearest integer of a quotient, halves rounded up, as by rounding and shift of the DSC."""
    return (2 * numerator + denominator) // (2 * denominator)


def towards_zero(numerator: int, denominator: int) -> int:
    """Quotient rounded towards zero, as in C."""
    quotient = abs(numerator) // abs(denominator)
    return quotient if (numerator < 0) == (denominator < 0) else -quotient


def product(a: int, b: int) -> int:
    """Q1.15 x Q1.15 -> Q1.15."""
    return clip16(nearest(a * b, 2**15))


def times_gain(x: int, factor: int) -> int:
    """A Q1.31 fraction times a gain."""
    return clip32(nearest(x * factor, GAIN_ONE))


def narrow(x: int) -> int:
    """Q1.31 -> Q1.15."""
    return clip16(nearest(x, 2**16))


def saturated(total: int) -> int:
    """A sum of products with 55 fraction bits, saturated to the range of 31-bit fractions."""
    if MIN32 * GAIN_ONE <= total < (MAX32 + 1) * GAIN_ONE:
        return total
    return (MIN32 if total < 0 else MAX32) * GAIN_ONE
