"""Fractions: every operation against exact integers over its whole range."""

from __future__ import annotations

from fractions import Fraction
from math import floor
from typing import Any

import numpy as np
import pytest
from core_library import load_core
from firmware_compiler import CompileC
from hypothesis import given
from hypothesis import strategies as st

MIN16, MAX16 = -(2**15), 2**15 - 1
MIN32, MAX32 = -(2**31), 2**31 - 1


def edges(low: int, high: int) -> st.SearchStrategy[int]:
    """Integers that prefer the ends of the range and the neighbourhood of zero."""
    marked = [low, low + 1, -1, 0, 1, high - 1, high, low // 2, high // 2]
    return st.one_of(st.sampled_from([x for x in marked if low <= x <= high]), st.integers(low, high))


I16, I32, I64 = edges(MIN16, MAX16), edges(MIN32, MAX32), edges(-(2**63), 2**63 - 1)


def clip(x: int, low: int, high: int) -> int:
    return min(max(x, low), high)


def wrap(x: int, bits: int) -> int:
    half = 1 << (bits - 1)
    return (x + half) % (2 * half) - half


def rounded(x: Fraction) -> int:
    """Nearest integer, halves upwards: what the DSC's rounding adds and its shift cuts off."""
    return floor(x + Fraction(1, 2))


@pytest.fixture(scope="module")
def c(compile_c: CompileC) -> Any:
    return load_core(compile_c).lib


@given(x=I32, n=st.integers(0, 31))
def test_shift_rounds_towards_minus_infinity_32(c: Any, x: int, n: int) -> None:
    assert c.probe_asr32(x, n) == x >> n


@given(x=I64, n=st.integers(0, 63))
def test_shift_rounds_towards_minus_infinity_64(c: Any, x: int, n: int) -> None:
    assert c.probe_asr64(x, n) == x >> n


@given(x=I32, y=I64)
def test_saturation(c: Any, x: int, y: int) -> None:
    assert c.probe_sat16(x) == clip(x, MIN16, MAX16)
    assert c.probe_sat32(y) == clip(y, MIN32, MAX32)


@given(x=I32, limit=edges(0, MAX16), y=I64, wide=edges(0, MAX32))
def test_symmetric_limit(c: Any, x: int, limit: int, y: int, wide: int) -> None:
    assert c.probe_f16_limit(x, limit) == clip(x, -limit, limit)
    assert c.probe_f32_limit(y, wide) == clip(y, -wide, wide)


@given(a=I16, b=I16)
def test_sums_of_16_bits(c: Any, a: int, b: int) -> None:
    assert c.probe_f16_add(a, b) == clip(a + b, MIN16, MAX16)
    assert c.probe_f16_sub(a, b) == clip(a - b, MIN16, MAX16)
    assert c.probe_f16_neg(a) == clip(-a, MIN16, MAX16)
    assert c.probe_f16_abs(a) == clip(abs(a), MIN16, MAX16)
    assert c.probe_f16_add_wrap(a, b) == wrap(a + b, 16)
    assert c.probe_f16_sub_wrap(a, b) == wrap(a - b, 16)


@given(a=I32, b=I32)
def test_sums_of_32_bits(c: Any, a: int, b: int) -> None:
    assert c.probe_f32_add(a, b) == clip(a + b, MIN32, MAX32)
    assert c.probe_f32_sub(a, b) == clip(a - b, MIN32, MAX32)
    assert c.probe_f32_abs(a) == clip(abs(a), MIN32, MAX32)
    assert c.probe_i32_add_wrap(a, b) == wrap(a + b, 32)
    assert c.probe_i32_sub_wrap(a, b) == wrap(a - b, 32)


@pytest.mark.parametrize("a", [MIN16, MIN16 + 1, -16384, -3, -1, 0, 1, 2, 3, 12345, 16384, MAX16 - 1, MAX16])
def test_product_is_rounded_and_saturated(compile_c: CompileC, a: int) -> None:
    """The first factor at its ends, the second over all its values."""
    core = load_core(compile_c)
    products = np.zeros(65536, dtype=np.int16)
    core.lib.probe_f16_mul_all(a, core.ffi.from_buffer("int16_t[]", products))
    exact = a * np.arange(MIN16, MAX16 + 1, dtype=np.int64)
    assert np.array_equal(products, np.clip((exact + 0x4000) >> 15, MIN16, MAX16))


@given(a=I16, b=I16)
def test_products_of_16_bits(c: Any, a: int, b: int) -> None:
    assert c.probe_f16_mul(a, b) == clip(rounded(Fraction(a * b, 2**15)), MIN16, MAX16)
    assert c.probe_f32_mul16(a, b) == clip(2 * a * b, MIN32, MAX32)


def test_minus_one_squared_saturates(c: Any) -> None:
    assert c.probe_f16_mul(MIN16, MIN16) == MAX16
    assert c.probe_f32_mul16(MIN16, MIN16) == MAX32


def test_round_trip_of_every_16_bit_fraction(c: Any) -> None:
    for a in range(MIN16, MAX16 + 1):
        wide = c.probe_f32_from_f16(a)
        assert wide == a * 65536
        assert c.probe_f16_from_f32(wide) == a


@given(a=I32)
def test_narrowing_rounds_and_saturates(c: Any, a: int) -> None:
    assert c.probe_f16_from_f32(a) == clip(rounded(Fraction(a, 65536)), MIN16, MAX16)


@given(x=I32, gain=I32)
def test_gain(c: Any, x: int, gain: int) -> None:
    assert c.probe_f32_gain(x, gain) == clip(rounded(Fraction(x * gain, 2**24)), MIN32, MAX32)


def test_gain_examples(c: Any) -> None:
    one = 1 << 24
    assert c.probe_f32_gain(MIN32, one) == MIN32
    assert c.probe_f32_gain(MIN32, -one) == MAX32
    assert c.probe_f32_gain(12345678, one // 2) == 6172839
    assert c.probe_f32_gain(-3, one // 2) == -1  # -1.5 goes up
    assert c.probe_f32_gain(1 << 25, 100 * one) == MAX32
