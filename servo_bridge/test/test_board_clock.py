from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.wire.board_clock import BoardClock, TickExtender, WallClock

TICK = 62_500
MS = 1_000_000
S = 1_000_000_000


# ---- ticks --------------------------------------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 16_000), max_size=50))
def test_ticks_are_unwrapped_beyond_32_bits(start: int, steps: list[int]) -> None:
    extender = TickExtender()
    tick, now = start, 5 * S
    assert extender.update(start, now, now).tick == start
    for step in steps:
        tick += step
        now += step * TICK
        assert extender.disagreement(tick % 2**32, now, now) == 0
        reading = extender.update(tick % 2**32, now, now)
        assert (reading.tick, reading.epoch) == (tick, 0)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 400.0), st.integers(-1000, 1000))
def test_wraps_during_a_long_pause_are_counted(start: int, hours: float, error_ms: int) -> None:
    extender = TickExtender()
    extender.update(start, S, S)
    step = round(hours * 3600 * S / TICK)
    now = S + step * TICK + error_ms * MS // 2
    assert extender.disagreement((start + step) % 2**32, now, now) == 0
    assert extender.update((start + step) % 2**32, now, now).tick == start + step


@pytest.mark.parametrize(
    ("last", "gap_s", "raw"),
    [
        (1_000_000, 0.01, 0),  # decreases
        (0xF000_0000, 0.01, 100),  # decreases by more than half of the range, which looks like a jump forward
        (5 * 16_000, 60.0, 8 * 16_000),  # too slow
        (5 * 16_000, 0.1, 60 * 16_000),  # too fast
    ],
)
def test_disagreement_is_measured_and_begins_no_epoch(last: int, gap_s: float, raw: int) -> None:
    extender = TickExtender()
    extender.update(last, S, S)
    now = S + round(gap_s * 1e9)
    error_ns = abs((raw - last) % 2**32 * TICK - round(gap_s * 1e9))
    measured = extender.disagreement(raw, now, now)
    assert 0.4 * error_ns - S < measured < error_ns
    assert extender.update(raw, now, now).epoch == 0
    assert extender.disagreement(raw + 160, now + 10 * MS, now + 10 * MS) == 0


def test_slow_board_or_pause_is_no_disagreement() -> None:
    extender = TickExtender()
    extender.update(0, 0, 0)
    for tick, now in ((12 * 16_000, 20 * S), (12 * 16_000 + 8, 21 * S), (12 * 16_000 + 8, 21 * S)):
        assert extender.disagreement(tick, now, now) == 0  # runs at 60 %; stopped for 1 s; repeated sample
        extender.update(tick, now, now)


@given(st.floats(0.0, 100.0), st.floats(0.0, 100.0))
def test_host_that_processes_answers_late_is_no_disagreement(before_s: float, after_s: float) -> None:
    """A suspended process finds the answer in the buffer: the tick is as old as the request."""
    extender = TickExtender()
    extender.update(0, 0, MS)
    request = S
    response = request + round(before_s * S)
    assert extender.disagreement(request // TICK, request, response) == 0
    extender.update(request // TICK, request, response)
    request, now = response + 1, response + round(after_s * S) + 2
    assert extender.disagreement(request // TICK, request, now) == 0


def test_registered_reset_starts_a_new_epoch() -> None:
    extender = TickExtender()
    extender.update(1000, S, S)
    extender.restart()
    reading = extender.update(1160, S + 10 * MS, S + 10 * MS)
    assert (reading.tick, reading.epoch) == (1160, 1)


# ---- board time to host time --------------------------------------------------------------------------------------
def simulate(
    seed: int, drift: float, seconds: float, jitter_ms: float, rate: float = 150.0, floor_ms: float = 1.0
) -> list[tuple[int, int, int]]:
    """Samples of a board with clock drift: tick, true host time, time of arrival."""
    rng = random.Random(seed)
    samples = []
    moment = 0.5
    while moment < seconds:
        tick = int(moment / 62.5e-6 * (1.0 + drift))
        true_ns = round(tick * TICK / (1.0 + drift)) + 7 * S
        # Adapters sometimes deliver in bursts; most delays are small.
        delay = floor_ms + rng.expovariate(1.0) * 0.2 + (rng.random() * jitter_ms if rng.random() < 0.2 else 0.0)
        samples.append((tick, true_ns, true_ns + round(delay * MS)))
        moment += max(1.0 / rate, delay * 1e-3)  # the next sample is requested after the arrival of this one
    return samples


@pytest.mark.parametrize("drift", [-50e-6, 0.0, 50e-6])
@given(seed=st.integers(0, 1000))
def test_stamps_are_accurate_within_250_us(drift: float, seed: int) -> None:
    clock = BoardClock(minimum_delay_ns=MS)
    errors = []
    for tick, true_ns, arrival_ns in simulate(seed, drift, 8.0, jitter_ms=16.0):
        stamp = clock.update(tick, arrival_ns)
        if true_ns > 10 * S:
            errors.append(abs(stamp - true_ns))
    assert max(errors) < MS // 4


@given(st.integers(0, 1000), st.floats(-100e-6, 100e-6), st.floats(0.0, 100.0))
def test_stamps_increase_and_are_not_after_the_arrival(seed: int, drift: float, jitter_ms: float) -> None:
    clock = BoardClock()
    last = 0
    for tick, _, arrival_ns in simulate(seed, drift, 3.0, jitter_ms):
        stamp = clock.update(tick, arrival_ns)
        assert last < stamp <= arrival_ns
        last = stamp


def test_spacing_of_stamps_is_that_of_the_board() -> None:
    """The jitter of the arrivals must not be in the stamps, as readers may differentiate."""
    clock = BoardClock()
    stamps = [(t, clock.update(t, a)) for t, _, a in simulate(3, 30e-6, 8.0, jitter_ms=10.0)][600:]
    ratios = [(b[1] - a[1]) / ((b[0] - a[0]) * TICK) for a, b in itertools.pairwise(stamps)]
    assert max(abs(r - 1.0) for r in ratios) < 5e-3


def test_a_late_first_sample_is_corrected_soon() -> None:
    clock = BoardClock()
    clock.update(0, 100 * MS)  # 100 ms late
    for k in range(1, 400):
        clock.update(160 * k, 10 * MS * k)
    assert clock.host_ns(160 * 399) == pytest.approx(10 * MS * 399, abs=3 * MS)


def test_stopped_clock_is_resynchronised_by_a_jump() -> None:
    clock = BoardClock()
    for k in range(100):
        clock.update(160 * k, 10 * MS * k)
    stamp = clock.update(160 * 100, 10 * MS * 100 + 10 * S)
    assert stamp == 10 * MS * 100 + 10 * S


def test_stamps_increase_after_a_reset() -> None:
    clock = BoardClock()
    before = [clock.update(160 * k, 10 * MS * k) for k in range(100)][-1]
    clock.reset()
    assert clock.offset_ns is None
    with pytest.raises(ValueError, match="no sample of the board"):
        clock.host_ns(0)
    after = clock.update(5, 10 * MS * 101)
    assert after > before
    assert after == 10 * MS * 101


# ---- wall clock ---------------------------------------------------------------------------------------------------
def test_wall_clock_follows_when_refreshed() -> None:
    now = {"steady": 1000, "wall": 500_000}
    clock = WallClock(lambda: now["wall"], lambda: now["steady"])
    assert clock.wall_ns(1100) == 500_100
    now["wall"] += 7_000
    assert clock.wall_ns(1100) == 500_100
    clock.refresh()
    assert clock.wall_ns(1100) == 507_100


def test_interrupted_clock_comparison_is_discarded() -> None:
    times = iter([0, 0, 1_000, 1_000 + MS, 2_000_000, 2_000_000])
    walls = iter([100, 900_000, 2_000_200])
    clock = WallClock(lambda: next(walls), lambda: next(times))
    clock.refresh()
    assert clock.wall_ns(0) == 100
    clock.refresh()
    assert clock.wall_ns(0) == 200


@pytest.mark.parametrize("speed", [0.0, 0.5, 2.0])
def test_stamps_increase_at_any_speed_of_simulated_time(speed: float) -> None:
    now = 0
    clock = WallClock(lambda: 7 * S + int(now * speed) // (10 * MS) * (10 * MS), lambda: now)
    stamps = []
    for step in range(3000):
        now = step * MS
        clock.refresh()
        delay = (step * 37 % 5) * MS // 10
        stamps.append(clock.stamp(now - delay))
        assert abs(stamps[-1] - (7 * S + now * speed)) < 11 * MS
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))


def test_stamps_follow_a_clock_that_was_set_back() -> None:
    wall = 100 * S
    clock = WallClock(lambda: wall, lambda: 0)
    assert clock.stamp(0) == 100 * S
    wall = 100 * S - MS
    clock.refresh()
    assert clock.stamp(0) == 100 * S + 1
    wall = 5 * S
    clock.refresh()
    assert clock.stamp(0) == 5 * S
