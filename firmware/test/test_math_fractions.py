"""Fractions: every operation against exact integers over its whole range."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from core_library import Core
from exact import (
    FRACTION16,
    FRACTION32,
    I16,
    I32,
    I64,
    MAX16,
    MAX32,
    MIN16,
    MIN32,
    clip,
    narrow,
    near,
    product,
    times_gain,
    wrap,
)
from hypothesis import given
from hypothesis import strategies as st


@pytest.fixture(scope="module")
def c(core: Core) -> Any:
    return core.lib


@given(x=I32, n=st.integers(0, 31))
def test_shift_rounds_towards_minus_infinity_32(c: Any, x: int, n: int) -> None:
    assert c.probe_asr32(x, n) == x >> n


@given(x=I64, n=st.integers(0, 63))
def test_shift_rounds_towards_minus_infinity_64(c: Any, x: int, n: int) -> None:
    assert c.probe_asr64(x, n) == x >> n


@given(x=st.one_of(I32, near(MIN16, MAX16)), y=st.one_of(I64, near(MIN32, MAX32)))
def test_numbers_out_of_range_saturate(c: Any, x: int, y: int) -> None:
    assert c.probe_sat16(x) == clip(x, MIN16, MAX16)
    assert c.probe_sat32(y) == clip(y, MIN32, MAX32)


@given(x=st.one_of(I32, near(0, MAX16)), n=st.integers(1, 31))
def test_saturation_of_a_shifted_number_and_of_the_upper_half(c: Any, x: int, n: int) -> None:
    assert c.sat16_asr(x, n) == clip(x >> n, MIN16, MAX16)
    assert c.sat15(x) == clip(x, 0, MAX16)


@given(x=I32, limit=FRACTION16, y=I64, wide=FRACTION32, beside=st.integers(-2, 2))
def test_a_symmetric_limit_clips_both_signs(c: Any, x: int, limit: int, y: int, wide: int, beside: int) -> None:
    for at in (x, limit + beside, -limit + beside):
        assert c.probe_f16_limit(at, limit) == clip(at, -limit, limit)
    for at in (y, wide + beside, -wide + beside):
        assert c.probe_f32_limit(at, wide) == clip(at, -wide, wide)
        assert c.f32_clip(clip(at, MIN32, MAX32), wide) == clip(at, -wide, wide)


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
def test_product_is_rounded_and_saturated(core: Core, a: int) -> None:
    """The first factor at its ends, the second over all its values."""
    products = np.zeros(65536, dtype=np.int16)
    core.lib.probe_f16_mul_all(a, core.ffi.from_buffer("int16_t[]", products))
    exact = a * np.arange(MIN16, MAX16 + 1, dtype=np.int64)
    assert np.array_equal(products, np.clip((exact + 0x4000) >> 15, MIN16, MAX16))


@given(a=I16, b=I16)
def test_products_of_16_bits(c: Any, a: int, b: int) -> None:
    assert c.probe_f16_mul(a, b) == product(a, b)
    assert c.probe_f32_mul16(a, b) == clip(2 * a * b, MIN32, MAX32)


def test_round_trip_of_every_16_bit_fraction(c: Any) -> None:
    for a in range(MIN16, MAX16 + 1):
        wide = c.probe_f32_from_f16(a)
        assert wide == a * 65536
        assert c.probe_f16_from_f32(wide) == a


@given(a=I32)
def test_narrowing_rounds_and_saturates(c: Any, a: int) -> None:
    assert c.probe_f16_from_f32(a) == narrow(a)


@given(x=I32, gain=I32)
def test_a_gain_multiplies_and_saturates(c: Any, x: int, gain: int) -> None:
    assert c.probe_f32_gain(x, gain) == times_gain(x, gain)
