"""Division of a band into recordings."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_measurement.access import MeasurementError, step_of
from servo_measurement.bode_plan import bands_of


@given(slow=st.booleans(), capacity=st.integers(400, 4000), low=st.floats(1e-4, 0.3), width=st.floats(1.1, 3000.0))
def test_bands_cover_the_requested_range(slow: bool, capacity: int, low: float, width: float) -> None:
    nyquist = 0.5 / step_of(1, slow)
    f_min = low * nyquist
    f_max = min(width * f_min, 0.8 * nyquist)
    bands = bands_of(f_min, f_max, capacity, slow)
    assert bands[0].f_min == pytest.approx(f_min)
    assert bands[-1].f_max == pytest.approx(f_max)
    for below, above in pairwise(bands):
        assert below.f_max == above.f_min
    for band in bands:
        assert band.f_min < band.f_max
        assert band.samples <= capacity
        assert band.f_max <= 0.81 * 0.5 / band.step
        assert band.sweep_seconds * band.f_min > 3.0
        assert band.step == pytest.approx(step_of(band.every, slow))
    assert len(bands) <= 2 + math.log(f_max / f_min) / math.log(0.05 * capacity)


def test_invalid_band_is_refused() -> None:
    for low, high in ((900.0, 950.0), (900.0, 50.0), (0.0, 10.0)):
        with pytest.raises(MeasurementError, match="must be between 0 and 800 Hz"):
            bands_of(low, high, 1000, True)
    with pytest.raises(MeasurementError, match="100 Hz of the band must be below its upper end, 50 Hz"):
        bands_of(100.0, 50.0, 1000, True)
