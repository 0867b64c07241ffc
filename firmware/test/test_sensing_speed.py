"""Speed by the enhanced M/T method (DRM 2.4.4..2.4.6)."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from hypothesis import given, settings
from hypothesis import strategies as st
from quad_timer import AGE_OVERFLOW, COUNTS, TIMER_CLOCK, EdgeCapture

ONE = 2**31
SLOW = 0.5e-3
FULL_SCALE_RPM = 5000
RPM_PER_RATIO = Fraction(781250 * 60, COUNTS)  # one count per timer tick


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


class Speed:
    """The C module; speeds in rpm."""

    def __init__(self, core: Core) -> None:
        self._core, self._config = core, core.lib.probe_config().axis[0]
        self.c: Any = core.ffi.new("mt_speed_t *")
        core.lib.mt_speed_reset(self.c)

    def edge(self, count: int, time: int) -> float:
        """A latched edge; returns the speed computed from it."""
        address = self._core.ffi.addressof
        self._core.lib.mt_speed_edge(
            self.c, address(self._config.mt_speed), address(self._config.encoder), (count & 0xFFFF, time & 0xFFFF)
        )
        return self.rpm

    def slow(self, age: int) -> float:
        self._core.lib.mt_speed_slow(self.c, age)
        return self.rpm

    @property
    def rpm(self) -> float:
        return float(self.c.speed / ONE * FULL_SCALE_RPM)

    def run(self, shaft: EdgeCapture, ticks: int, first: int = 1) -> list[float]:
        """Slow loops on a turning shaft: take and compute, read the age, arm."""
        speeds = []
        for k in range(first, first + ticks):
            now = k * SLOW
            captured = shaft.take(now)
            if captured is not None:
                self.edge(*captured)
            speeds.append(self.slow(shaft.age(now)))
        return speeds


@pytest.mark.parametrize("counts", [1, 2, 117, 160, -1, -2, -160])
@pytest.mark.parametrize("interval", [1, 2, 3, 390, 391, 46875, 65535])
def test_e33_exactly(core: Core, counts: int, interval: int) -> None:
    """One LSB of the 32-bit fraction, saturated at the full scale."""
    speed = Speed(core)
    speed.edge(3990, 65000)
    speed.edge((3990 + counts) % COUNTS, 65000 + interval)
    exact = Fraction(counts, interval) * RPM_PER_RATIO / FULL_SCALE_RPM * ONE
    assert abs(speed.c.speed - min(max(exact, -ONE), ONE - 1)) <= 1


@pytest.mark.parametrize("rpm", [0.5, 1.0, 3.7, 10.0, 60.0, 100.0, 333.3, 1000.0, 2000.0, 3000.0, 3500.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_constant_speed_from_half_a_turn_per_minute_to_3500(core: Core, rpm: float, sign: int) -> None:
    """The only error left is one timer tick in the interval between two latched edges."""
    shaft = EdgeCapture(sign * rpm * COUNTS / 60.0, start=0.3)
    speed = Speed(core)
    to_settle = int(3 * 2 * 60 / (rpm * COUNTS) / SLOW) + 3
    speeds = speed.run(shaft, to_settle + 400)[to_settle:]
    edges_apart = 2.0 / (rpm * COUNTS / 60.0)
    interval = max(edges_apart, SLOW - edges_apart) * TIMER_CLOCK  # shortest between two captures
    for measured in speeds:
        assert measured == pytest.approx(sign * rpm, rel=1.01 / interval)
    # E33 divides by differences of the same stamps: over many edges the mean is exact
    if rpm >= 100.0:
        assert sum(speeds) / len(speeds) == pytest.approx(sign * rpm, rel=0.2 / interval)


def test_resolution_at_half_a_turn_per_minute(core: Core) -> None:
    """M2 = 46875; a Q1.15 speed of 5000 rpm full scale would read 0.458 or 0.610."""
    speed = Speed(core)
    speed.edge(10, 100)
    assert speed.edge(12, 100 + 46875) == pytest.approx(0.5, abs=1e-5)
    assert speed.c.interval == 46875


def test_worked_example_of_f19(core: Core) -> None:
    """M2 = 4; TMRx3 = 2, 5, 8, 11 scale by 1, 4/5, 4/8, 4/11; the next capture, M2 = 12, by 1/3: exactly."""
    speed = Speed(core)
    speed.edge(0, 1000)
    speed.edge(1, 1004)
    omega = speed.c.edge_speed
    assert omega == ONE * Fraction(1, 4) * RPM_PER_RATIO / FULL_SCALE_RPM
    speed.slow(0)  # the loop in which the edge came
    for age, factor in ((2, 1), (5, Fraction(4, 5)), (8, Fraction(4, 8)), (11, Fraction(4, 11))):
        speed.slow(age)
        assert speed.c.speed == int(omega * factor)
    speed.edge(2, 1016)
    assert speed.c.interval == 12
    assert abs(speed.c.speed - Fraction(omega, 3)) < 1


def test_no_scaling_in_the_loop_of_the_edge(core: Core) -> None:
    """Fast shaft: edges come several times per loop, only the first is latched; its age says nothing."""
    speed = Speed(core)
    speed.edge(0, 0)
    speed.slow(380)
    rpm = speed.edge(10, 40)
    assert speed.slow(389) == rpm


def test_stop_is_seen_at_once_and_ends_in_zero(core: Core) -> None:
    """A shaft that stops: from the next loop on the speed falls as 1 / age, never rises, and is 0 on overflow."""
    speed = Speed(core)
    speed.edge(0, 0)
    speed.edge(100, 390)
    start = speed.slow(10)
    previous = start
    for k in range(1, 170):
        age = min(10 + round(k * 390.625), AGE_OVERFLOW)
        now = speed.slow(age)
        assert 0.0 <= now <= previous
        if age < AGE_OVERFLOW:
            assert now == pytest.approx(start * min(1.0, 390 / age), rel=1e-4)
        previous = now
    assert speed.c.speed == 0


def test_first_edge_after_standstill_measures_nothing(core: Core) -> None:
    """Its interval would be ambiguous; the second one counts."""
    speed = Speed(core)
    speed.edge(0, 0)
    speed.edge(100, 390)
    speed.slow(100)
    speed.slow(AGE_OVERFLOW)
    assert speed.edge(102, 300) == 0.0
    assert speed.edge(104, 300 + 7812) == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("interval", [65536, 65537, 65600, 65700, 65926])
def test_interval_longer_than_the_timer_is_no_short_one(core: Core, interval: int) -> None:
    """0.36 rpm, and the slow loop has not seen the overflow yet: 65600 ticks must not be taken for 64."""
    speed = Speed(core)
    speed.edge(0, 0)
    speed.edge(2, 46875)
    speed.slow(0)
    for age in range(391, 65536, 391):
        speed.slow(age)
    assert 0.0 <= speed.edge(4, 46875 + interval) <= 0.36


@pytest.mark.parametrize("rpm", [0.2, 0.3, 0.34, 0.355, 0.3576, 0.36, 0.4])
def test_creeping_never_spikes(core: Core, rpm: float) -> None:
    """Around the overflow of TMRx3 every result lies between standstill and the true speed."""
    shaft = EdgeCapture(rpm * COUNTS / 60.0, start=0.1)
    speeds = Speed(core).run(shaft, 4000)
    assert max(speeds) <= rpm * 1.01
    assert min(speeds) >= 0.0


def test_reversal(core: Core) -> None:
    """The sign follows the first whole interval in the new direction."""
    speed = Speed(core)
    speed.edge(3998, 0)
    assert speed.edge(0, 300) > 0
    assert speed.edge(0, 600) == 0.0  # the same B edge, backwards
    assert speed.edge(3998, 900) < 0
    assert speed.rpm == pytest.approx(-float(2 * RPM_PER_RATIO / 300), rel=1e-6)


def test_counter_wrap_between_two_captures(core: Core) -> None:
    """3990 -> 10 is +20, -3990 -> -10 is -20."""
    speed = Speed(core)
    speed.edge(3990, 0)
    assert speed.edge(10, 390) == pytest.approx(float(20 * RPM_PER_RATIO / 390), rel=1e-6)
    speed = Speed(core)
    speed.edge(-3990, 0)
    assert speed.edge(-10, 390) == pytest.approx(-float(20 * RPM_PER_RATIO / 390), rel=1e-6)


@given(
    steps=st.lists(
        st.tuples(
            st.booleans(), st.integers(-COUNTS + 1, COUNTS - 1), st.integers(0, 65535), st.integers(0, AGE_OVERFLOW)
        ),
        max_size=30,
    )
)
@settings(max_examples=200)
def test_any_input_gives_a_bounded_speed(core: Core, steps: list[tuple[bool, int, int, int]]) -> None:
    """Between edges the magnitude never grows."""
    speed = Speed(core)
    for is_edge, count, time, age in steps:
        if is_edge:
            speed.edge(count, time)
        else:
            before = abs(speed.c.speed)
            speed.slow(age)
            assert abs(speed.c.speed) <= max(before, abs(speed.c.edge_speed))
