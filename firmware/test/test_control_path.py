"""Path filter (DRM 2.6, E38..E40): S curves that end exactly on their target."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from core_library import Core
from exact import I32, edges, nearest, towards_zero
from hypothesis import given, settings
from hypothesis import strategies as st

ONE = 2**24  # one count
COUNTS_PER_TURN = 4000
SPEED_LIMIT = 200 * ONE  # counts per slow tick: 314 rad/s
OMEGAS = (1, 65, 1957, 3276, 16384)


OMEGA = edges(1, 2**16 - 1)
STEP = edges(0, 2**40)  # up to 65536 counts per slow tick, 16 turns
SIGNED_STEP = edges(-(2**40), 2**40)


class Path:
    """The C path with numbers in counts."""

    def __init__(self, core: Core, omega_n_ts: int, position: int = 0, step: int = 0) -> None:
        self._lib = core.lib
        self.omega = omega_n_ts
        self.c: Any = core.ffi.new("path_t *")
        self._lib.path_reset(self.c, position, step, omega_n_ts)

    def step(self, target: int, step_limit: int = SPEED_LIMIT) -> float:
        self._lib.path_step(self.c, target, step_limit, self.omega)
        return self.output

    @property
    def output(self) -> float:
        return float(self.c.output / ONE)

    @property
    def position(self) -> int:
        return int(self._lib.path_position(self.c))


def beyond(x: int, target: int) -> int:
    """How far a position is beyond a target: counts wrap at 32 bits."""
    return (x - target * ONE + 2**55) % 2**56 - 2**55


class Integers:
    """The path with its roundings: two products to the nearest 2^-24 of a count per tick."""

    def __init__(self, omega: int, position: int, step: int) -> None:
        self.omega = omega
        self.output = position * ONE
        self.filter = towards_zero(step * 2**16, omega)
        self.ramp = self.output + 2 * self.filter - step

    def step(self, target: int, limit: int) -> None:
        self.ramp += min(max(-beyond(self.ramp, target), -limit), limit)
        self.filter += nearest((self.ramp - 2 * self.filter - self.output) * self.omega, 2**16)
        self.output += nearest(self.filter * self.omega, 2**16)

    def retune(self, target: int, omega: int) -> None:
        lead = towards_zero((self.ramp - self.output) * self.omega, omega)
        drawn = self.output + lead
        short, past = beyond(self.ramp, target) <= 0, beyond(drawn, target) > 0
        if lead <= 0:
            short, past = beyond(self.ramp, target) >= 0, beyond(drawn, target) < 0
        self.ramp = drawn - beyond(drawn, target) if short and past else drawn
        self.filter = towards_zero(self.filter * self.omega, omega)
        self.omega = omega

    @property
    def state(self) -> tuple[int, int, int]:
        return self.ramp, self.filter, self.output


def state_of(path: Path) -> tuple[int, int, int]:
    return path.c.ramp, path.c.filter, path.c.output


@given(
    omega=edges(1, 2**15),
    start=st.tuples(I32, SIGNED_STEP),
    ticks=st.lists(st.tuples(st.one_of(I32, st.none()), STEP, st.integers(1, 6)), min_size=1, max_size=8),
)
@settings(max_examples=300)
def test_every_bit(core: Core, omega: int, start: tuple[int, int], ticks: list[tuple[int | None, int, int]]) -> None:
    """Any start, targets over all 32 bits, ramps of up to 16 turns per tick; None stays where the output is."""
    path, model = Path(core, omega, *start), Integers(omega, *start)
    assert state_of(path) == model.state
    for target, limit, count in ticks:
        for _ in range(count):
            at = (model.output + ONE // 2 >> 24) if target is None else target
            at = min(max(at, -(2**31)), 2**31 - 1)
            path.step(at, limit)
            model.step(at, limit)
            assert state_of(path) == model.state


@given(omega=OMEGA, other=OMEGA, start=st.tuples(I32, SIGNED_STEP), target=I32, near=st.integers(-40, 40))
@settings(max_examples=400)
def test_every_bit_of_a_new_omega(
    core: Core, omega: int, other: int, start: tuple[int, int], target: int, near: int
) -> None:
    """Both quotients towards zero; the ramp stops at a target it would be drawn past."""
    for at in (target, min(max((Integers(omega, *start).ramp >> 24) + near, -(2**31)), 2**31 - 1)):
        path, model = Path(core, omega, *start), Integers(omega, *start)
        core.lib.path_retune(path.c, at, omega, other)
        model.retune(at, other)
        assert state_of(path) == model.state


@given(
    omega=edges(1, 2**15),
    start=I32,
    targets=st.lists(I32, min_size=1, max_size=3),
    limit=edges(1, 2**40),
)
@settings(max_examples=60)
def test_e40_over_the_whole_range(core: Core, omega: int, start: int, targets: list[int], limit: int) -> None:
    """At most 2 / (omega_n Ts) of 2^-24 counts off the reals, which are carried here with 64 bits more.

    A rounding of half an LSB in m is worth 1 / (2 omega_n Ts) in y, one in y twice that; both responses are monotonic.
    """
    path, more = Path(core, omega, start), 64
    ramp, m, y = path.c.ramp, 0, path.c.ramp << more
    for target in targets:
        for _ in range(60):
            ramp += min(max(-beyond(ramp, target), -limit), limit)
            m += ((ramp << more) - 2 * m - y) * omega >> 16
            y += m * omega >> 16
            path.step(target, limit)
            assert abs((path.c.output << more) - y) <= (2**17 << more) // omega


@given(output=edges(-(2**55) - ONE // 2, 2**55 - ONE // 2 - 1), target=I32, ramp=st.integers(-1, 1))
def test_position_and_rest(core: Core, output: int, target: int, ramp: int) -> None:
    """The nearest count, halves upwards; at rest when that is the target and the ramp has arrived to the last bit."""
    path = core.ffi.new("path_t *")
    path.output = output
    position = nearest(output, ONE)
    assert core.lib.path_position(path) == position
    for at in (target, position):
        path.ramp = at * ONE + ramp
        assert core.lib.path_at_rest(path, at) == (at == position and ramp == 0)


@pytest.mark.parametrize("omega_n_ts", OMEGAS[1:])
def test_equals_e40_in_floating_point(core: Core, omega_n_ts: int) -> None:
    path, w = Path(core, omega_n_ts), omega_n_ts / 65536.0
    x = m = y = 0.0
    for k in range(4000):
        target = 50000 if k < 2500 else 20000
        x += min(max(target - x, -30.0), 30.0)
        m += w * (x - 2.0 * m - y)
        y += w * m
        assert path.step(target, 30 * ONE) == pytest.approx(y, abs=0.01)


def test_ramp_becomes_an_s_curve(core: Core) -> None:
    """F23, F24: the speed of the output has no steps and is never above that of the ramp."""
    path = Path(core, 3276)
    y = np.array([path.step(100_000, 100 * ONE) for _ in range(1500)])
    speed = np.diff(y, prepend=0.0)
    assert np.max(speed) <= 100.0 + 1e-3
    assert np.max(speed) > 99.9
    assert np.min(speed) >= -1e-6
    assert np.max(np.abs(np.diff(speed, prepend=0.0))) < 100.0 * 3276 / 65536 * 1.05  # a v omega_n at most
    assert path.position == 100_000


@given(
    start=st.integers(-(2**30), 2**30),
    distance=st.integers(-20000, 20000),
    limit=st.integers(ONE // 8, SPEED_LIMIT),
    omega_n_ts=st.sampled_from(OMEGAS[2:]),
)
@settings(max_examples=60)
def test_ends_exactly_on_target_without_overshoot(
    core: Core, start: int, distance: int, limit: int, omega_n_ts: int
) -> None:
    path, target = Path(core, omega_n_ts, start), start + distance
    limit = max(limit, abs(distance) * ONE // 1500)
    furthest = 0.0
    for _ in range(2500 + 30 * 65536 // omega_n_ts):
        path.step(target, limit)
        beyond = (path.c.output - target * ONE) / ONE * (1 if distance >= 0 else -1)
        furthest = max(furthest, beyond)
    assert path.position == target
    assert abs(path.c.output - target * ONE) <= ONE // 256
    assert furthest <= 1.0 / 256.0


def test_100_turns(core: Core) -> None:
    path, target = Path(core, 1957), 100 * COUNTS_PER_TURN
    for _ in range(target // 200 + 1000):
        path.step(target)
    assert path.position == target
    for _ in range(target // 200 + 1000):
        path.step(-target)
    for _ in range(target // 200 + 1000):
        path.step(-target)
    assert path.position == -target


def test_slow_filter_carries_enough_bits(core: Core) -> None:
    """omega_n = 2 rad/s: with 16 fraction bits it would stop counts short of the target."""
    path = Path(core, 65)
    for _ in range(30000):
        path.step(1000)
    assert path.position == 1000


@pytest.mark.parametrize("omega_n_ts", OMEGAS)
@pytest.mark.parametrize("position", [0, 12345, -(2**31), 2**31 - 1, -954929659, 954929659])
def test_standing_start_stays(core: Core, omega_n_ts: int, position: int) -> None:
    path = Path(core, omega_n_ts, position)
    assert path.position == position
    for _ in range(50):
        path.step(position)
    assert path.position == position
    assert core.lib.path_at_rest(path.c, position)


@pytest.mark.parametrize(("start", "target"), [(2**31 - 50, -(2**31) + 150), (-(2**31) + 150, 2**31 - 50)])
def test_shortest_way_leads_through_the_wrap_of_the_counts(core: Core, start: int, target: int) -> None:
    path, plain = Path(core, 3276, start), Path(core, 3276)
    way = 200 if start > 0 else -200
    for _ in range(400):
        path.step(target, 20 * ONE)
        plain.step(way, 20 * ONE)
        assert (path.position - start - plain.position) % 2**32 == 0
    assert core.lib.path_at_rest(path.c, target)


@given(x=st.integers(-(2**60), 2**60), counts=I32)
def test_how_far_beyond(core: Core, x: int, counts: int) -> None:
    assert core.lib.path_beyond(x, counts) == beyond(x, counts)
    assert (core.lib.path_whole(x) - (x >> 24)) % 2**32 == 0
    assert core.lib.path_part(x) == x % ONE


@pytest.mark.parametrize("step", [150 * ONE, -150 * ONE, ONE // 3])
@pytest.mark.parametrize("omega_n_ts", OMEGAS[1:])
def test_moving_start_is_bumpless(core: Core, step: int, omega_n_ts: int) -> None:
    """Taken over at speed, the output goes on at that speed from the first tick."""
    path = Path(core, omega_n_ts, 5000, step)
    far, previous = (10**9 if step > 0 else -(10**9)), 5000.0
    for _ in range(300):
        now = path.step(far, abs(step))
        assert now - previous == pytest.approx(step / ONE, rel=1e-4)
        previous = now


def test_rest_is_told_only_at_rest(core: Core) -> None:
    path = Path(core, 3276)
    told = []
    for _ in range(400):
        path.step(3000, 100 * ONE)
        told.append(bool(core.lib.path_at_rest(path.c, 3000)))
        if told[-1]:
            assert path.position == 3000
    assert not any(told[:30])
    assert all(told[300:])
    assert not core.lib.path_at_rest(path.c, 3001)


def test_rounding_to_counts(core: Core) -> None:
    path = core.ffi.new("path_t *")
    for counts, expected in ((0.49, 0), (0.5, 1), (-0.5, 0), (-0.51, -1), (-1.5, -1), (7.25, 7)):
        path.output = round(counts * ONE)
        assert core.lib.path_position(path) == expected


def retune(core: Core, path: Path, target: int, omega_n_ts: int) -> tuple[float, float]:
    """Go on with another omega_n; returns the ramp before and after, in counts."""
    before = path.c.ramp
    core.lib.path_retune(path.c, target, path.omega, omega_n_ts)
    path.omega = omega_n_ts
    return before / ONE, path.c.ramp / ONE


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("omega_n_ts", [200, 3276])
def test_new_omega_before_the_shaft_turns_round(core: Core, way: int, omega_n_ts: int) -> None:
    """The limits change while the shaft still runs away from its target: only the ramp's lead follows."""
    path, target = Path(core, 1957, 0, -way * 100 * ONE), way * 900_000_000
    path.step(target)
    previous, output = path.output, path.step(target)
    before, after = retune(core, path, target, omega_n_ts)
    assert after - output == pytest.approx((before - output) * 1957 / omega_n_ts)
    assert path.step(target) - output == pytest.approx(output - previous, rel=0.1)


def test_new_omega_at_rest_changes_nothing(core: Core) -> None:
    path = Path(core, 1957, 77)
    assert retune(core, path, 900_000_000, 200) == (77.0, 77.0)


@pytest.mark.parametrize("way", [1, -1])
def test_new_omega_does_not_draw_the_ramp_past_the_target(core: Core, way: int) -> None:
    path, target = Path(core, 1957), way * 20_000
    for _ in range(60):
        path.step(target)
    assert abs(path.c.ramp) / ONE < 20_000
    assert retune(core, path, target, 65)[1] == target
