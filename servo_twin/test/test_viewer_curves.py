"""Points of curves before they are written to a recording."""

from __future__ import annotations

import numpy as np
import pytest
from servo_twin.view.curves import Curves, ShaftAngle


def test_points_are_taken_once_and_in_order() -> None:
    curves = Curves()
    curves.add(np.array([0.0, 0.1]), {"a": np.array([1.0, 2.0]), "b": np.array([5.0, 6.0])})
    curves.add(np.array([0.2]), {"a": np.array([3.0])})
    taken = curves.take()
    assert [part.tolist() for part in taken["a"]] == [[0.0, 0.1, 0.2], [1.0, 2.0, 3.0]]
    assert [part.tolist() for part in taken["b"]] == [[0.0, 0.1], [5.0, 6.0]]
    assert curves.take() == {}


@pytest.mark.parametrize("later", [0.7, -3.0])
def test_missing_telemetry_breaks_a_curve_even_between_two_writes(later: float) -> None:
    curves = Curves()
    curves.add(np.array([1.0]), {"a": np.array([1.0])})
    curves.take()
    curves.add(np.array([1.0 + later]), {"a": np.array([2.0])})
    times, values = curves.take()["a"]
    assert times[0] == pytest.approx(1.0, abs=1e-3)
    assert np.isnan(values[0])
    assert values[1:].tolist() == [2.0]


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_shaft_pointer_is_updated_at_30_hz_with_any_size_of_messages(chunk: int) -> None:
    pointer = ShaftAngle()
    times = np.arange(1000, dtype=np.float64) * 0.002
    for first in range(0, 1000, chunk):
        part = times[first : first + chunk]
        pointer.add(part, 10.0 * part)
    taken, angles = pointer.take()
    assert 55 <= len(taken) <= 60
    assert np.diff(taken).min() >= 1.0 / 30.0 - 1e-9
    assert angles == pytest.approx(10.0 * taken)
    assert len(pointer.take()[0]) == 0


def test_shaft_pointer_continues_after_time_has_jumped_back() -> None:
    pointer = ShaftAngle()
    pointer.add(np.array([5.0]), np.array([1.0]))
    pointer.add(np.array([0.1]), np.array([2.0]))
    assert pointer.take()[1].tolist() == [1.0, 2.0]
