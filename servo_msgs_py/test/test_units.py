"""Fractional formats and counters against values of the reference design or a calculator."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servo_msgs_py import units


def test_bus_voltage_is_scaled_as_in_the_reference_design() -> None:
    """DRM E46, E47: 24 V of 36.3 V is 21665."""
    lsb = 36.3 / 32768
    assert units.to_raw(24.0, lsb, -32768, 32767) == 21665


def test_full_scale_itself_becomes_the_largest_number() -> None:
    lsb = 5.0 / 32768
    assert units.to_raw(5.0, lsb, -32768, 32767) == 32767
    assert units.to_raw(-5.0, lsb, -32768, 32767) == -32768


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_infinite_values_and_nan_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        units.to_raw(value, 1.0, -10, 10)


@pytest.mark.parametrize("value", [12.0, -12.0, 1e300])
def test_values_out_of_range_are_refused_and_not_clipped(value: float) -> None:
    with pytest.raises(ValueError, match="outside"):
        units.to_raw(value, 1.0, -10, 10)


@given(st.integers(-32768, 32767), st.floats(1e-3, 1e6))
def test_conversion_of_raw_to_si_is_reversible(raw: int, full_scale: float) -> None:
    lsb = full_scale / 32768
    assert units.to_raw(raw * lsb, lsb, -32768, 32767) == raw


@given(st.floats(-1e5, 1e5))
def test_rounding_is_to_the_nearest(value: float) -> None:
    lsb = 0.25
    raw = units.to_raw(value, lsb, -(2**31), 2**31 - 1)
    assert abs(raw * lsb - value) <= lsb / 2


def test_rpm_is_revolutions_per_minute() -> None:
    assert units.rpm(2.0 * math.pi) == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("raw", "previous", "expected"),
    [
        (5, 0, 5),
        (0, 0xFFFF_FFFF, 0x1_0000_0000),
        (0xFFFF_FFFF, 0x1_0000_0000, 0xFFFF_FFFF),
        (0x8000_0000 - 1, 0, 0x8000_0000 - 1),
    ],
)
def test_a_wrapped_counter_is_unwrapped(raw: int, previous: int, expected: int) -> None:
    assert units.unwrap_u32(raw, previous) == expected


@given(st.integers(-(2**60), 2**60), st.integers(-(2**31), 2**31 - 1))
def test_unwrap_follows_any_step_within_half_the_range(previous: int, step: int) -> None:
    assert units.unwrap_u32((previous + step) & 0xFFFF_FFFF, previous) == previous + step
