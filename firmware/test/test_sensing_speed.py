"""Speed by the M/T method, plain and enhanced (DRM 2.4.4..2.4.6)."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import pytest
from core_library import Core
from exact import I32, MAX32, MIN32, U16, edges, towards_zero
from hypothesis import given, settings
from hypothesis import strategies as st
from quad_timer import AGE_OVERFLOW, COUNTS, TIMER_CLOCK, EdgeCapture

ONE = 2**31
SLOW = 0.5e-3
FULL_SCALE_RPM = 5000
RPM_PER_RATIO = Fraction(781250 * 60, COUNTS)  # one count per timer tick


class Speed:
    """The C module; speeds in rpm."""

    def __init__(self, core: Core, enhanced: bool = True) -> None:
        self._enhanced = enhanced
        self._core, self._config = core, core.lib.probe_config().axis[0]
        self.mt_config: Any = core.ffi.new("mt_speed_config_t *", self._config.mt_speed)
        self.c: Any = core.ffi.new("mt_speed_t *")
        core.lib.mt_speed_reset(self.c)

    def edge(self, count: int, time: int) -> float:
        """A captured edge; returns the speed computed from it."""
        address = self._core.ffi.addressof
        self._core.lib.mt_speed_edge(
            self.c, self.mt_config, address(self._config.encoder), (count & 0xFFFF, time & 0xFFFF)
        )
        return self.rpm

    def slow(self, age: int) -> float:
        self._core.lib.mt_speed_slow(self.c, age, self._enhanced)
        return self.rpm

    @property
    def rpm(self) -> float:
        return float(self.c.speed / ONE * FULL_SCALE_RPM)

    def run(self, shaft: EdgeCapture, ticks: int, first: int = 1) -> list[float]:
        """Slow loops on a rotating shaft: read the edge and compute, read the age, arm."""
        speeds = []
        for k in range(first, first + ticks):
            now = k * SLOW
            captured = shaft.take(now)
            if captured is not None:
                self.edge(*captured)
            speeds.append(self.slow(shaft.age(now)))
        return speeds


@given(
    factor=edges(1, 2**20),
    counts=edges(-1999, 1999),
    interval=edges(1, 65535),
    start=st.tuples(st.integers(-COUNTS + 1, COUNTS - 1), U16),
)
@settings(max_examples=400)
def test_e33_over_the_whole_range(core: Core, factor: int, counts: int, interval: int, start: tuple[int, int]) -> None:
    """Up to half a revolution in any interval at any full scale: rounded towards zero, error below one LSB (2^-31)."""
    count, time = start
    arrived = count + counts
    if abs(arrived) >= COUNTS:
        arrived -= COUNTS if arrived > 0 else -COUNTS
    speed = Speed(core)
    speed.mt_config.speed_per_ratio = factor
    speed.edge(count, time)
    speed.edge(arrived, time + interval)
    exact = Fraction(counts * factor * 2**15, interval)
    if abs(counts) * factor // interval > 0xFFFF:
        assert speed.c.speed == (MAX32 if counts > 0 else MIN32)
    else:
        assert speed.c.speed == towards_zero(counts * factor * 2**15, interval)
        assert abs(speed.c.speed - exact) < 1
    assert speed.c.interval == interval


@given(edge_speed=I32, interval=edges(1, 65535), age=edges(0, AGE_OVERFLOW + 1), before=I32)
@settings(max_examples=400)
def test_f19_over_the_whole_range(core: Core, edge_speed: int, interval: int, age: int, before: int) -> None:
    """M2 / TMRx3 rounded towards zero, error below one LSB (2^-31); constant until TMRx3 > M2; 0 after overflow."""
    speed = Speed(core)
    speed.c.edge_speed, speed.c.interval, speed.c.speed, speed.c.primed = edge_speed, interval, before, True
    speed.slow(age)
    assert speed.c.waited == age
    if age >= AGE_OVERFLOW:
        assert (speed.c.speed, speed.c.edge_speed, speed.c.primed) == (0, 0, False)
    elif age > interval:
        assert speed.c.speed == towards_zero(edge_speed * interval, age)
        assert speed.c.primed
    else:
        assert speed.c.speed == before


@given(edge_speed=I32, interval=edges(1, 65535), age=edges(0, AGE_OVERFLOW + 1), before=I32)
def test_the_plain_method_keeps_its_speed_until_the_timer_overflows(
    core: Core, edge_speed: int, interval: int, age: int, before: int
) -> None:
    """F18; the age of the edge is still used to distinguish the next edge from one after a wrap."""
    speed = Speed(core, enhanced=False)
    speed.c.edge_speed, speed.c.interval, speed.c.speed, speed.c.primed = edge_speed, interval, before, True
    speed.slow(age)
    overflow = age >= AGE_OVERFLOW
    assert (speed.c.waited, speed.c.primed, speed.c.speed) == (age, not overflow, 0 if overflow else before)


@given(waited=edges(0, 65535), interval=edges(0, 65535), primed=st.booleans(), old=I32)
def test_an_interval_is_measured_from_a_recent_edge_only(
    core: Core, waited: int, interval: int, primed: bool, old: int
) -> None:
    """Not from a missing edge, not from one at the same time, not from one older than this interval one loop ago."""
    speed = Speed(core)
    speed.c.primed, speed.c.waited, speed.c.edge_speed, speed.c.speed, speed.c.interval = primed, waited, old, old, 7
    speed.edge(3, interval)
    measured = primed and interval != 0 and interval >= waited
    exact = Fraction(3 * speed.mt_config.speed_per_ratio * 2**15, interval) if measured else 0
    assert speed.c.speed == speed.c.edge_speed == min(int(exact), MAX32)
    assert speed.c.interval == (interval if measured else 7)
    assert (speed.c.waited, speed.c.primed, speed.c.fresh) == (0, True, True)
    assert (speed.c.last.count, speed.c.last.time) == (3, interval)


def test_after_a_reset_the_speed_is_zero(core: Core) -> None:
    speed = Speed(core)
    speed.edge(5, 6)
    speed.edge(7, 8)
    core.lib.mt_speed_reset(speed.c)
    c = speed.c
    assert (c.primed, c.fresh, c.interval, c.waited, c.edge_speed, c.speed) == (False, False, 0, 0, 0, 0)
    assert (c.last.count, c.last.time) == (0, 0)


def test_worked_example_of_f19(core: Core) -> None:
    """M2 = 4; TMRx3 = 2, 5, 8, 11 scale by 1, 4/5, 4/8, 4/11; the next capture, M2 = 12, by 1/3: exactly."""
    speed = Speed(core)
    speed.edge(0, 1000)
    speed.edge(1, 1004)
    omega = speed.c.edge_speed
    assert omega == ONE * Fraction(1, 4) * RPM_PER_RATIO / FULL_SCALE_RPM
    speed.slow(0)  # the loop of the edge
    for age, factor in ((2, 1), (5, Fraction(4, 5)), (8, Fraction(4, 8)), (11, Fraction(4, 11))):
        speed.slow(age)
        assert speed.c.speed == int(omega * factor)
    speed.edge(2, 1016)
    assert speed.c.interval == 12
    assert abs(speed.c.speed - Fraction(omega, 3)) < 1


TICKS_PER_SLOW = SLOW * TIMER_CLOCK
APART = sorted(
    {
        *(2.0 * TICKS_PER_SLOW * 10.0 ** (decade / 10.0) for decade in range(-12, 28)),  # 3800 rpm down to 0.06 rpm
        *(TICKS_PER_SLOW * share for share in (0.49, 0.5, 0.99, 1.0, 1.01)),
        *(65536.0 + ticks for ticks in (-500.0, -2.0, -0.7, 0.3, 1.0, 64.3, 114.6, 200.0, 390.0, 782.0, 65600.0)),
    }
)
"""Timer ticks between two B edges."""


@pytest.mark.parametrize("apart", APART)
@pytest.mark.parametrize("enhanced", [False, True])
def test_no_speed_is_above_the_true_one_by_more_than_a_tick_of_the_interval(
    core: Core, apart: float, enhanced: bool
) -> None:
    """E33 gives c K / M2 for c counts in a true interval of T ticks, and the true speed is c K / T.

    Both time stamps are truncated to whole ticks, so M2 > T - 1: the result is less than (M2 + 1) / M2 of the true
    speed. The division rounds towards zero and F19 only takes away, so this holds for both methods. From below it is
    (M2 - 1) / M2, and one tick more for F19, once two edges have come within the 65536 ticks of the timer. Otherwise
    it is 0.
    """
    true = float(2.0 * RPM_PER_RATIO / Fraction(apart))
    to_settle = math.ceil(3.0 * apart / TICKS_PER_SLOW) + 3
    for phase in range(8):
        for sign in (1, -1):
            start, stamp = sign * 2.0 * phase / 8.0 + 0.01, 8191 * phase
            shaft = EdgeCapture(sign * 2.0 / apart * TIMER_CLOCK, start, stamp)
            speed = Speed(core, enhanced)
            for k in range(1, to_settle + math.ceil(2.0 * apart / TICKS_PER_SLOW) + 40):
                rpm = sign * speed.run(shaft, 1, first=k)[0]
                m2 = max(speed.c.interval, 1)
                assert 0.0 <= rpm <= true * (m2 + 1) / m2, (phase, sign, k)
                if apart >= 65537.0:
                    assert rpm == 0.0
                elif apart < 65535.0 and k > to_settle:
                    assert rpm >= true * (m2 - 1 - enhanced) / m2 - 1e-5, (phase, sign, k)


def test_the_sign_follows_the_first_interval_in_the_new_direction(core: Core) -> None:
    """The sign is that of the first complete interval in the new direction."""
    speed = Speed(core)
    speed.edge(3998, 0)
    assert speed.edge(0, 300) > 0
    assert speed.edge(0, 600) == 0.0  # the same B edge, in the other direction
    assert speed.edge(3998, 900) < 0
    assert speed.rpm == pytest.approx(-float(2 * RPM_PER_RATIO / 300), rel=1e-6)


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
