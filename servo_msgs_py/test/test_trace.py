"""Samples at equal intervals: times, parts, columns."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_msgs_py.trace import Trace

TICK = 500e-6


def trace(samples: int, first: int = 1) -> Trace:
    return Trace(TICK, {"a": np.arange(samples), "b": 0.5 * np.arange(samples)}, first, {"b": "A"})


@given(
    samples=st.integers(1, 50), first=st.integers(-20, 20), start=st.integers(-30, 60), ticks=st.integers(0, 60),
    rounding=st.floats(-0.4, 0.4),
)  # fmt: skip
def test_a_part_holds_the_samples_after_its_start_and_up_to_its_end(
    samples: int, first: int, start: int, ticks: int, rounding: float
) -> None:
    whole = trace(samples, first)
    numbers = range(first, first + samples)
    part = whole.part((start + rounding) * TICK, (start + ticks + rounding) * TICK)
    expected = [k for k in numbers if start < k <= start + ticks]
    assert part.time.tolist() == [TICK * k for k in expected]
    assert part["a"].tolist() == [k - first for k in expected]
    assert whole.part(start * TICK)["a"].tolist() == [k - first for k in numbers if k > start]


def test_parts_of_a_part_keep_the_time() -> None:
    part = trace(100).part(10 * TICK).part(20 * TICK, 30 * TICK)
    assert part.time.tolist() == [TICK * k for k in range(21, 31)]
    assert part.samples(2, 4).time.tolist() == [TICK * 23, TICK * 24]


def test_without_a_known_step_the_time_counts_samples() -> None:
    assert Trace(0.0, {"a": np.zeros(3)}, first=-1).time.tolist() == [-1.0, 0.0, 1.0]


def test_columns_side_by_side_and_heads() -> None:
    assert trace(2).table(["b", "a"]).tolist() == [[0.0, 0.0], [0.5, 1.0]]
    assert [trace(2).head(name) for name in ("a", "b")] == ["a", "b [A]"]


def test_columns_cannot_be_changed_but_replaced() -> None:
    source = np.zeros(3)
    whole = Trace(TICK, {"a": source})
    with pytest.raises(ValueError, match="read-only"):
        whole["a"][0] = 1.0
    source[0] = 1.0  # the owner may
    assert whole.changed(a=np.ones(3), c=np.zeros(3))["a"].tolist() == [1.0, 1.0, 1.0]
    assert pickle.loads(pickle.dumps(whole)).time.tolist() == whole.time.tolist()


@pytest.mark.parametrize("columns", [{}, {"a": np.zeros(2), "b": np.zeros(3)}])
def test_columns_of_different_lengths_are_refused(columns: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="same length"):
        Trace(TICK, columns)
