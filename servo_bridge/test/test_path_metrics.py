"""Figures of a path from samples of two shafts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from servo_bridge.path_metrics import PathFigures, measure_path
from servo_bridge.trajectory.shapes import lissajous

COUNT = 2.0 * np.pi / 4000
TICK = 62.5e-6
JOINTS = ("axis1", "axis2")
PATH = lissajous(JOINTS, [1.0, -2.0], [6.0, 6.0], [1.0, 1.5], 4.0, phase=0.0)
TIME = np.arange(0.0, 6.3, 0.005)


def places(*starts: float) -> NDArray[np.float64]:
    """Positions of both joints on the path with separate starts, rounded to counts."""
    columns = [PATH.state(TIME - start).position[:, k] for k, start in enumerate(starts)]
    return np.round(np.column_stack(columns) / COUNT) * COUNT


def measured(first: int, second: int, lag: float = 0.0) -> PathFigures:
    """Figures of joints with start ticks and a lag of the shafts [s]."""
    return measure_path(
        TIME, places(first * TICK + lag, second * TICK + lag), places(first * TICK, second * TICK), PATH
    )


@pytest.mark.parametrize(("first", "second"), [(640, 640), (640, 641), (643, 640), (640, 656)])
def test_ticks_between_the_starts_are_found_to_the_tick(first: int, second: int) -> None:
    figures = measured(first, second)
    assert figures.ticks_apart == abs(first - second)
    assert figures.start == pytest.approx(TICK * (first + second) / 2, abs=TICK / 4)
    assert figures.duration == 4.0


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(32, 36_000), st.integers(-16, 16))
def test_any_begin_is_found(first: int, apart: int) -> None:
    """A busy computer may delay the path by more than its periods."""
    second = first + apart
    figures = measured(first, second)
    assert figures.ticks_apart == abs(first - second)
    assert figures.start == pytest.approx(TICK * (first + second) / 2, abs=TICK / 4)


def test_a_late_shaft_is_a_following_error_of_its_speed() -> None:
    figures = measured(640, 640, lag=2e-3)
    speeds = np.abs(PATH.state(np.linspace(0.0, 4.0, 4001)).velocity).max(axis=0)
    assert figures.ticks_apart == 0
    assert figures.error_max == pytest.approx(tuple(2e-3 * speeds), abs=2 * COUNT)
    assert figures.end_error == pytest.approx((0.0, 0.0), abs=COUNT)


def test_samples_without_the_path_are_reported() -> None:
    with pytest.raises(ValueError, match="do not contain a path of 4 s"):
        measure_path(TIME[:700], places(0.04, 0.04)[:700], places(0.04, 0.04)[:700], PATH)
    late = places(3.0, 3.0)
    with pytest.raises(ValueError, match=r"do not contain the path|left the path"):
        measure_path(TIME, late, late, PATH)
    with pytest.raises(ValueError, match="shape"):
        measure_path(TIME, places(0.04, 0.04)[:, :1], places(0.04, 0.04), PATH)
