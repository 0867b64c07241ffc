"""Quantities: validity, text of the valid values, memory format."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_msgs_py.quantity import ABOVE_0, Format, Quantity

SPEED = Quantity(unit="rad/s", text="speed of the shaft", minimum=ABOVE_0, maximum=400.0)
FORMATS = [Format(size, signed=signed) for size in (1, 2, 4) for signed in (False, True)]


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (400, ""),
        (400.5, "too large"),
        (0.0, "too small"),
        (math.nan, "not a finite number"),
        (-math.inf, "not a finite number"),
        (10**400, "not a finite number"),
        (True, "not a number"),
        ("7", "not a number"),
    ],
)
def test_a_value_is_valid_or_has_a_reason(value: object, problem: str) -> None:
    assert SPEED.problem(value) == problem
    assert Quantity(maximum=math.inf).problem(math.inf) == ""


@pytest.mark.parametrize(
    ("quantity", "text"),
    [
        (SPEED, "a number above 0 up to 400 [rad/s]: speed of the shaft"),
        (Quantity(minimum=1.0, whole=True), "a whole number from 1"),
        (Quantity(minimum=-0.2, maximum=0.2), "a number from -0.2 up to 0.2"),
        (Quantity(unit="A"), "a number of either sign [A]"),
    ],
)
def test_valid_values_are_described(quantity: Quantity, text: str) -> None:
    assert quantity.expected == text


@given(st.sampled_from(FORMATS), st.data())
def test_raw_numbers_of_the_memory_are_read_back(format_: Format, data: st.DataObject) -> None:
    quantity = Quantity(format=format_)
    raw = data.draw(st.lists(st.integers(format_.low, format_.high)))
    assert quantity.elements(quantity.pack(raw)) == raw
    for outside in (format_.low - 1, format_.high + 1):
        with pytest.raises(ValueError, match="does not fit"):
            quantity.pack([*raw, outside])
