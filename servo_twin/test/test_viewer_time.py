"""The time axis of a recording."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD
from servo_twin.view.board_time import BoardTime

START = 1_700_000_000_123_456_789  # [ns]


def ticks(*numbers: int) -> NDArray[np.int64]:
    return np.array(numbers, np.int64)


def stamps(*seconds: float) -> NDArray[np.int64]:
    return np.array([START + round(s * 1e9) for s in seconds], np.int64)


def test_times_are_ticks_from_the_first_row_independent_of_later_stamps() -> None:
    line = BoardTime(START)
    times = line.telemetry(ticks(1600, 3200, 16000), stamps(0.25, 0.36, 1.14))
    assert times == pytest.approx([0.25, 0.35, 1.15], abs=1e-9)
    assert line.telemetry(ticks(32000), stamps(7.0)) == pytest.approx([2.15], abs=1e-9)
    assert line.newest == pytest.approx(2.15)
    assert line.first == pytest.approx(0.25)
    assert line.resets == 0


def test_a_first_row_stamped_before_the_start_is_at_zero() -> None:
    assert BoardTime(START).telemetry(ticks(80_000), stamps(-0.01)) == pytest.approx([0.0])


def test_without_stamps_the_first_row_is_zero() -> None:
    assert BoardTime(START).telemetry(ticks(5000, 21000), None) == pytest.approx([0.0, 1.0])


def test_a_stamp_is_converted_exactly_at_rows_and_linearly_elsewhere() -> None:
    line = BoardTime(START)
    # The board runs 1 % fast against the stamps.
    line.telemetry(ticks(0, 16160, 32320), stamps(1.0, 2.0, 3.0))
    assert line.of_stamps(stamps(2.0, 3.0, 1.5)) == pytest.approx([2.01, 3.02, 1.505], abs=1e-9)
    assert line.of_stamps(stamps(0.8, 3.5)) == pytest.approx([0.8, 3.52], abs=1e-9)
    assert line.of_ticks(ticks(16160)) == pytest.approx([2.01])


def test_before_any_telemetry_stamps_count_from_the_start() -> None:
    line = BoardTime(START)
    assert line.first == np.inf
    assert line.of_stamp(START + 1_500_000_000) == pytest.approx(1.5)


@pytest.mark.parametrize("together", [True, False])
def test_after_a_reset_time_continues_by_the_stamps(together: bool) -> None:
    line = BoardTime(START)
    tick, stamp = ticks(160_000, 160_016, 8, 1608), stamps(0.0, 0.001, 2.0, 2.1)
    if together:
        times = line.telemetry(tick, stamp)
    else:
        times = np.concatenate([line.telemetry(tick[k : k + 1], stamp[k : k + 1]) for k in range(4)])
    assert times == pytest.approx([0.0, 0.001, 2.0, 2.1], abs=1e-9)
    assert line.resets == 1
    # The twin may still process samples from before the reset.
    assert line.of_stamps(stamps(0.001, 2.1)) == pytest.approx([0.001, 2.1], abs=1e-9)


def test_time_does_not_decrease_at_a_reset() -> None:
    line = BoardTime(START)
    line.telemetry(ticks(0, 16000), stamps(0.0, 0.5))
    assert line.telemetry(ticks(8), stamps(0.4))[0] == pytest.approx(1.0 + PERIOD)
