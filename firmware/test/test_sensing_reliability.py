"""Mean and variance of 64 speeds against exact fractions, back-EMF check, oscillating rotor."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from observer_rig import FULL_SPEED, PAIRS, PSI, SLOW, U_FS, Rig, frac16

SIZE = 64


class Reliability:
    """The C statistics."""

    def __init__(self, core: Core, threshold: int = 4096, period: int = 1, hysteresis: int = 5) -> None:
        self.lib = core.lib
        self.config: Any = core.ffi.new("speed_reliability_config_t *")
        self.config.variance_threshold, self.config.period, self.config.hysteresis = threshold, period, hysteresis
        self.state: Any = core.ffi.new("speed_reliability_t *")
        self.lib.speed_reliability_reset(self.state)

    def add(self, speed: int) -> bool:
        """Add a raw speed of 15 fraction bits."""
        return bool(self.lib.speed_reliability_add(self.state, self.config, speed * 65536))

    @property
    def holds(self) -> bool:
        return bool(self.lib.speed_reliability_holds(self.state, self.config))

    @property
    def mean(self) -> int:
        return int(self.lib.speed_reliability_mean(self.state))


@settings(max_examples=200)
@given(
    speeds=st.lists(st.integers(-32768, 32767), min_size=SIZE, max_size=200),
    threshold=st.integers(0, 65535),
    near=st.booleans(),
)
def test_reliability_criterion_is_exact(core: Core, speeds: list[int], threshold: int, near: bool) -> None:
    if near:
        speeds = [9000 + speed // 8 for speed in speeds]  # range in which the criterion may be met
    r = Reliability(core, threshold)
    for speed in speeds:
        r.add(speed)
    last = speeds[-SIZE:]
    mean = Fraction(sum(last), SIZE)
    variance = sum((x - mean) ** 2 for x in last) / SIZE
    assert r.holds == (variance <= mean**2 * Fraction(threshold, 65536))
    assert r.mean == mean * 65536


def test_criterion_is_not_met_before_64_speeds(core: Core) -> None:
    r = Reliability(core)
    for k in range(SIZE):
        assert not r.holds
        assert r.state.failures == k
        r.add(5000)
    assert r.holds
    assert r.state.failures == 0


def test_one_speed_is_sampled_per_period(core: Core) -> None:
    r = Reliability(core, period=3)
    assert [r.add(5000) for _ in range(9)] == 3 * [False, False, True]
    assert r.state.filled == 3


def test_consecutive_failures_are_counted_and_saturate(core: Core) -> None:
    r = Reliability(core)
    for _ in range(SIZE):
        r.add(5000)
    for k in range(10):
        r.add(-30000 if k % 2 else 30000)
    assert r.state.failures == 10
    for _ in range(SIZE):
        r.add(5000)
    assert r.state.failures == 0
    r.state.failures = 0xFFFF
    for _ in range(3):
        r.add(30000)
        r.add(-30000)
    assert r.state.failures == 0xFFFF


# ---- the back-EMF ----------------------------------------------------------------------------------------------------


def deviates(core: Core, emf: complex, expected: float, current: float = 0.0) -> bool:
    config = core.ffi.addressof(core.lib.probe_config().axis[0], "emf_check")
    volts = frac16(expected / U_FS)
    there = {"d": frac16(emf.real / U_FS), "q": frac16(emf.imag / U_FS)}
    deviation = core.lib.emf_check_deviation(there, volts)
    return bool(core.lib.emf_check_deviates(config, config.floor_spin, deviation, volts, frac16(current / 8.25)))


def turned(volts: float, degrees: float) -> complex:
    return 1j * volts * complex(math.cos(math.radians(degrees)), math.sin(math.radians(degrees)))


@pytest.mark.parametrize("volts", [3.0, -3.0, 10.0])
def test_back_emf_check_detects_a_wrong_angle(core: Core, volts: float) -> None:
    assert not deviates(core, turned(volts, 0.0), volts)
    assert not deviates(core, turned(volts, 20.0), volts)
    assert not deviates(core, turned(volts, -20.0), volts)
    for degrees in (45.0, -45.0, 90.0, 180.0):
        assert deviates(core, turned(volts, degrees), volts)


def test_back_emf_check_detects_a_wrong_amplitude(core: Core) -> None:
    assert deviates(core, turned(1.0, 0.0), 3.0)
    assert deviates(core, turned(3.0, 0.0), 0.0), "rotation without an observed speed"
    assert not deviates(core, turned(2.5, 0.0), 3.0), "a hot magnet"


def test_resistance_error_is_tolerated_in_proportion_to_the_current(core: Core) -> None:
    off = turned(0.5 * 0.55 * 3.0, 0.0)
    assert deviates(core, off, 0.0)
    assert not deviates(core, off, 0.0, 3.0)
    assert not deviates(core, -off, 0.0, -3.0)


def lacks(core: Core, emf: float, expected: float, ticks: int) -> bool:
    """Whether the back-EMF is missing after `ticks` slow ticks, by the criterion of the start-up."""
    config = core.ffi.addressof(core.lib.probe_config().axis[0], "emf_check")
    check = core.ffi.new("emf_check_t *")
    core.lib.emf_check_reset(check)
    volts = frac16(expected / U_FS)
    for _ in range(ticks):
        deviation = core.lib.emf_check_deviation({"d": 0, "q": frac16(emf / U_FS)}, volts)
        core.lib.emf_check_filter(check, deviation)
    return bool(core.lib.emf_check_emf_missing(check, config, volts))


@pytest.mark.parametrize("volts", [0.4, -0.4, 1.0, 3.0])
def test_missing_back_emf_is_detected_at_every_speed(core: Core, volts: float) -> None:
    assert deviates(core, 0j, volts, 2.0) == (abs(volts) > 2.0), "a running axis tolerates more"
    assert lacks(core, 0.1 * volts, volts, ticks=64)
    assert not lacks(core, 0.8 * volts, volts, ticks=64)


def test_deviation_is_confirmed_after_some_ticks(core: Core) -> None:
    check = core.ffi.new("emf_check_t *")
    core.lib.emf_check_reset(check)
    assert [core.lib.emf_check_confirmed(check, True, 3) for _ in range(4)] == [False, False, False, True]
    for _ in range(6):
        core.lib.emf_check_confirmed(check, False, 3)
    assert check.ticks == 0


# ---- oscillation not detected by the criterion (ST slide "Detection of a blocked rotor") ----------------------------


@pytest.mark.parametrize(("amplitude", "swing"), [(0.2, 150.0), (0.2, 250.0), (0.5, 400.0)])
def test_an_oscillating_rotor_is_detected_by_the_back_emf_but_not_by_the_variance(
    core: Core, amplitude: float, swing: float
) -> None:
    """A rotor that swings sinusoidally about where it is held: its back-EMF is the sum of two vectors that turn against
    each other, the slide's PLL follows one of them, at a speed that hardly varies, but would need far more of it."""
    rig = Rig(core)
    it = rig.estimator
    it.ignore_amplitude()
    it.start(0.0, swing)
    reliability = Reliability(core)
    smooth = core.ffi.new("emf_check_t *")
    core.lib.emf_check_reset(smooth)
    config = core.ffi.addressof(core.lib.probe_config().axis[0], "emf_check")
    accepted, seen = 0, 0
    ticks = 400

    def theta(t: float) -> float:
        return amplitude * math.sin(swing * t)

    for _ in range(ticks):
        for _ in range(SLOW):
            rig.step(theta)
        reliability.add(round(it.speed / 65536))
        expected = frac16(it.omega * PSI / U_FS)
        emf = {"d": frac16(it.emf_dq.real / U_FS), "q": frac16(it.emf_dq.imag / U_FS)}
        there = core.lib.emf_check_filter(smooth, core.lib.emf_check_deviation(emf, expected))
        accepted += reliability.holds
        seen += bool(core.lib.emf_check_deviates(config, config.floor_spin, there, expected, 0))
    assert abs(reliability.mean) / 2**31 * FULL_SPEED * PAIRS == pytest.approx(swing, rel=0.25)
    assert accepted > 0.9 * (ticks - SIZE), "the criterion alone accepts it as rotation"
    assert seen > 0.8 * ticks, "the back-EMF does not fit"


@pytest.mark.parametrize(("amplitude", "swing"), [(0.2, 150.0), (0.2, 250.0), (0.5, 400.0)])
def test_an_oscillating_rotor_has_a_mean_observed_speed_near_zero(core: Core, amplitude: float, swing: float) -> None:
    """The mean speed is almost zero, the condition of standstill (sensorless_estimate.c)."""
    rig = Rig(core)
    it = rig.estimator
    it.start(0.0, swing)
    reliability = Reliability(core)
    for _ in range(400):
        for _ in range(SLOW):
            rig.step(lambda t: amplitude * math.sin(swing * t))
        reliability.add(round(it.speed / 65536))
    assert abs(reliability.mean) / 2**31 * FULL_SPEED * PAIRS < 0.1 * swing


def test_a_rotating_rotor_passes_both_criteria(core: Core) -> None:
    rig = Rig(core)
    it = rig.estimator
    it.start(0.0, 60.0)
    reliability = Reliability(core)
    for _ in range(300):
        for _ in range(SLOW):
            rig.step(lambda t: 60.0 * t, 1.0)
        reliability.add(round(it.speed / 65536))
    assert reliability.holds
    emf = np.round(it.emf_dq, 6)
    assert not deviates(core, complex(emf), it.omega * PSI, 1.0)
