"""The record of a first fault from the bytes of the board."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.fault_record import FaultRecord

CATALOGUE = Catalogue.load()


def record(code: int = 18, tick: int = 8003, following: int = 3, size: int = 64) -> bytes:
    """Record whose samples contain their index in the ring buffer."""
    ring = list(range(64))
    head = struct.pack("<II6H", 0, tick, code, 3, 3, following, size, 0)
    return head + struct.pack("<320h", *(100 * r + k for r in range(5) for k in ring))


def test_samples_come_oldest_first_and_scaled() -> None:
    it = FaultRecord.of(0, record(), CATALOGUE)
    assert it.fault is not None
    assert (it.fault.name, it.place, it.tick) == ("PHASE_LOST", "RUN/SPIN", 8003)
    order = np.roll(np.arange(64), -3)
    np.testing.assert_allclose(it.samples["i_q"], (100 + order) * 8.25 / 2**15)
    np.testing.assert_allclose(it.samples["u_dc"], (300 + order) * 36.3 / 2**15)
    assert "PHASE_LOST in RUN/SPIN, 0.5002 s after reset" in it.summary()


@pytest.mark.parametrize(("tick", "periods"), [(8003, 7), (8004, 8), (8005, 1), (8008, 4)])
def test_sample_times_of_the_record(tick: int, periods: int) -> None:
    """Samples are taken in periods 4, 12 and so on; a fault raised by a monitor has the sample of that period."""
    time = FaultRecord.of(0, record(tick=tick), CATALOGUE).samples["time"]
    assert time[-1] == 0.0
    assert time[-2] == pytest.approx(-periods * 62.5e-6)
    np.testing.assert_allclose(np.diff(time[:-1]), 0.5e-3)


def test_incomplete_record_has_the_recorded_samples_only() -> None:
    it = FaultRecord.of(0, record(following=5, size=5), CATALOGUE)
    np.testing.assert_allclose(it.samples["speed"] * 2**15 / 523.5987755982989, 400 + np.arange(5))


def test_phase_currents_are_those_of_the_vector() -> None:
    it = FaultRecord.of(0, record(), CATALOGUE)
    d, q, theta = (it.samples[name] for name in ("i_d", "i_q", "theta_e"))
    np.testing.assert_allclose(it.samples["i_a"], d * np.cos(theta) - q * np.sin(theta))
    third = 2.0 * math.pi / 3.0
    np.testing.assert_allclose(it.samples["i_b"], d * np.cos(theta - third) - q * np.sin(theta - third), atol=1e-12)


def test_record_without_a_fault_is_empty() -> None:
    assert FaultRecord.of(1, record(code=0, size=0), CATALOGUE).summary() == "no fault"
    with pytest.raises(ValueError, match=r"axis2\.fault_record"):
        FaultRecord.of(1, b"short", CATALOGUE)
