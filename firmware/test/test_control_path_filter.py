"""Path (DRM 2.6, E38..E40): a ramp of limited speed and acceleration, and S curves that end exactly on their target."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from core_library import Core
from exact import I32, clip, edges, nearest, towards_zero
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

ONE = 2**24  # one count
COUNTS_PER_TURN = 4000
TICK = 0.5e-3
SPEED_UNIT = TICK * COUNTS_PER_TURN * ONE / (2.0 * math.pi)  # of a path, in one rad/s
ACCELERATION_UNIT = TICK * SPEED_UNIT  # in one rad/s^2
SPEED_LIMIT = int(419.0 * SPEED_UNIT)  # the contract's highest limits
ACCELERATION_LIMIT = int(50_000.0 * ACCELERATION_UNIT)
SPEED_MAX = 3_000_000_000  # largest number whose square fits
ROUNDING = 4  # of the output's second difference: 1.5e-3 rad/s^2


OMEGA = edges(1, 2**16 - 1)
STEP = edges(0, SPEED_LIMIT)
SIGNED_STEP = edges(-667 * ONE, 667 * ONE)  # full scale
ACCELERATION = edges(1, ACCELERATION_LIMIT)
DISTANCE = st.integers(0, 55).flatmap(lambda bits: st.integers(0, 2**bits))


def logarithmic(low: float, high: float, unit: float) -> st.SearchStrategy[int]:
    """Integers over decades: `low` to `high`, SI."""
    return st.floats(math.log(low), math.log(high)).map(lambda x: int(math.exp(x) * unit))


SPEEDS = logarithmic(0.1, 419.0, SPEED_UNIT)
ACCELERATIONS = logarithmic(1.0, 50_000.0, ACCELERATION_UNIT)


class Path:
    """The C path with numbers in counts."""

    def __init__(self, core: Core, omega_n_ts: int, position: int = 0, step: int = 0) -> None:
        self._lib = core.lib
        self.omega = omega_n_ts
        self.c: Any = core.ffi.new("path_filter_t *")
        self._lib.path_filter_reset(self.c, position, step, omega_n_ts)

    def step(self, target: int, step_limit: int = SPEED_LIMIT, acceleration: int = ACCELERATION_LIMIT) -> float:
        self._lib.path_filter_step(self.c, target, step_limit, acceleration, self.omega)
        return self.output

    def retune(self, target: int, omega_n_ts: int, acceleration: int = ACCELERATION_LIMIT) -> None:
        self._lib.path_filter_retune(self.c, target, acceleration, self.omega, omega_n_ts)
        self.omega = omega_n_ts

    @property
    def output(self) -> float:
        return float(self.c.output / ONE)

    @property
    def position(self) -> int:
        return int(self._lib.path_filter_position(self.c))


def beyond(x: int, target: int) -> int:
    """Distance of a position beyond a target; counts wrap at 32 bits."""
    return (x - target * ONE + 2**55) % 2**56 - 2**55


def braking_speed(distance: int, acceleration: int, maximum: int) -> int:
    if distance <= acceleration:
        return min(distance, maximum)
    return min(math.isqrt(2 * acceleration * distance) - (acceleration + 1) // 2, maximum)


def stopping_distance(speed: int, acceleration: int) -> Fraction:
    """Exact stopping distance of a ramp that starts with steps of `speed`."""
    n = speed // acceleration
    return Fraction((n + 1) * speed) - Fraction(acceleration * n * (n + 1), 2)


class Integers:
    """The path with its roundings: two products to the nearest 2^-24 of a count per tick, a root rounded down."""

    def __init__(self, omega: int, position: int, step: int) -> None:
        self.omega = omega
        self.output = position * ONE
        self.filter = towards_zero(step * 2**16, omega)
        self.ramp = self.output + 2 * self.filter - step
        self.speed = step

    def step(self, target: int, limit: int, acceleration: int) -> None:
        off = beyond(self.ramp, target)
        direction = -1 if off > 0 else 1
        speed = direction * self.speed
        allowed = braking_speed(abs(off), acceleration, min(limit, speed + acceleration))
        self.speed = direction * (
            max(allowed, speed - acceleration) if speed + acceleration > 0 else speed + acceleration
        )
        self.ramp += self.speed
        self.filter += nearest((self.ramp - 2 * self.filter - self.output) * self.omega, 2**16)
        self.output += nearest(self.filter * self.omega, 2**16)

    def times(self, x: int) -> int:
        return nearest(x * self.omega, 2**16)

    def over(self, x: int, omega: int) -> int:
        return towards_zero(x * self.omega, omega)

    def retune(self, target: int, acceleration: int, omega: int) -> None:
        step, excess = self.times(self.filter), self.ramp + self.speed - self.output - 2 * self.filter
        maximum = towards_zero(towards_zero(acceleration * 2**32, omega), omega)
        pull = clip(self.over(excess, omega), -maximum, maximum)
        ramp, speed = self.ramp, self.speed
        self.filter, self.omega = self.over(self.filter, omega), omega
        following = self.times(self.times(pull))
        even = step + following + towards_zero(following * 2**16, omega)
        reach = towards_zero(acceleration * 2**16, omega)
        self.speed = even + clip(self.speed - even, -reach, reach)
        self.ramp = self.output + 2 * self.filter + pull - self.speed
        self._stop_at(target, acceleration, ramp, speed)

    def _stop_at(self, target: int, acceleration: int, ramp: int, speed: int) -> None:
        direction = -1 if self.ramp < self.output else 1
        remaining, past = -direction * beyond(ramp, target), direction * beyond(self.ramp, target)
        speed *= direction
        if remaining < 0 or (
            speed > 0 and braking_speed(remaining + speed, acceleration, min(speed, SPEED_MAX)) < speed - acceleration
        ):
            return
        if past > 0:
            self.ramp, self.speed = self.ramp - direction * past, 0
        elif direction * self.speed > 0:
            self.speed = direction * braking_speed(-past, acceleration, min(direction * self.speed, SPEED_MAX))

    @property
    def state(self) -> tuple[int, int, int, int]:
        return self.ramp, self.speed, self.filter, self.output


def state_of(path: Path) -> tuple[int, int, int, int]:
    return path.c.ramp, path.c.speed, path.c.filter, path.c.output


@given(
    omega=edges(1, 2**15),
    start=st.tuples(I32, SIGNED_STEP),
    ticks=st.lists(st.tuples(st.one_of(I32, st.none()), STEP, ACCELERATION, st.integers(1, 6)), min_size=1, max_size=8),
)
@settings(max_examples=300)
def test_agrees_with_integers_in_every_bit(
    core: Core, omega: int, start: tuple[int, int], ticks: list[tuple[int | None, int, int, int]]
) -> None:
    """Any start, targets over all 32 bits, all limits; None: the target is the output."""
    path, model = Path(core, omega, *start), Integers(omega, *start)
    assert state_of(path) == model.state
    for target, limit, acceleration, count in ticks:
        for _ in range(count):
            at = (model.output + ONE // 2 >> 24) if target is None else target
            at = min(max(at, -(2**31)), 2**31 - 1)
            path.step(at, limit, acceleration)
            model.step(at, limit, acceleration)
            assert state_of(path) == model.state


@given(
    omega=OMEGA,
    other=OMEGA,
    start=st.tuples(I32, SIGNED_STEP),
    target=I32,
    near=st.integers(-400, 400),
    limits=st.tuples(STEP, ACCELERATION),
    count=st.integers(0, 5),
)
@settings(max_examples=400)
def test_every_bit_of_a_new_omega(
    core: Core,
    omega: int,
    other: int,
    start: tuple[int, int],
    target: int,
    near: int,
    limits: tuple[int, int],
    count: int,
) -> None:
    """All quotients towards zero; far from the target and close to it, in steady motion and after some ticks."""
    omega = min(omega, 2**15)
    for at in (target, clip((Integers(omega, *start).ramp >> 24) + near, -(2**31), 2**31 - 1)):
        path, model = Path(core, omega, *start), Integers(omega, *start)
        for _ in range(count):
            path.step(at, *limits)
            model.step(at, *limits)
        path.retune(at, other, limits[1])
        model.retune(at, limits[1], other)
        assert state_of(path) == model.state


@given(distance=DISTANCE, acceleration=ACCELERATION, maximum=STEP)
@settings(max_examples=2000)
def test_braking_speed_suffices_and_wastes_little(core: Core, distance: int, acceleration: int, maximum: int) -> None:
    """The discrete ramp that ends on the target differs from constant deceleration by an eighth of the acceleration."""
    speed = core.lib.braking_speed(distance, acceleration, maximum)
    assert speed == braking_speed(distance, acceleration, maximum)
    assert 0 <= speed <= maximum
    assert stopping_distance(speed, acceleration) <= distance
    higher = speed + acceleration // 8 + 2
    assert higher > maximum or stopping_distance(higher, acceleration) > distance


def moved(path: Path, target: int, ticks: int, *limits: int) -> NDArray[np.int64]:
    """States of some ticks towards a target: ramp, its speed, filter, output."""
    rows = []
    for _ in range(ticks):
        path.step(target, *limits)
        rows.append(state_of(path))
    return np.array(rows, dtype=np.int64)


def ticks_of(distance: int, limit: int, acceleration: int) -> float:
    """Duration of a trapezoid [ticks]."""
    if distance * acceleration > limit * limit:
        return distance / limit + limit / acceleration
    return 2.0 * math.sqrt(distance / acceleration)


def reachable(ticks: int, limit: int, acceleration: int) -> int:
    """Distance in whole counts of a move that takes at most this number of ticks."""
    return int(min(acceleration * ticks * ticks / 4.0, limit * ticks / 2.0) / ONE)


SETTLED = {1957: 600, 3276: 360, 16384: 90}  # ticks from the end of the ramp until the filter is on its target


@given(
    omega=st.sampled_from(sorted(SETTLED)),
    start=I32,
    limit=SPEEDS,
    acceleration=ACCELERATIONS,
    ticks=st.integers(1, 3000),
    direction=st.sampled_from([1, -1]),
)
@settings(max_examples=80)
def test_rest_to_rest_is_a_trapezoid_and_ends_exactly_on_its_target(
    core: Core, omega: int, start: int, limit: int, acceleration: int, ticks: int, direction: int
) -> None:
    """Within the limits, monotonic, across the wrap of the counts, and in the shortest time that the limits permit."""
    distance = reachable(ticks, limit, acceleration)
    target = (start + direction * distance + 2**31) % 2**32 - 2**31
    path = Path(core, omega, start)
    needed = math.ceil(ticks_of(distance * ONE, limit, acceleration)) + 3
    log = direction * moved(path, target, needed + SETTLED[omega], limit, acceleration)
    ramp, speed, output = log[:, 0], log[:, 1], log[:, 3]
    assert np.all(np.abs(np.diff(speed, prepend=0)) <= acceleration)
    assert speed.min() >= 0
    assert speed.max() <= limit
    assert np.all(ramp[needed:] == direction * start * ONE + distance * ONE), "on the target in time, in every bit"
    steps = np.diff(output, prepend=direction * start * ONE)
    assert np.abs(np.diff(steps, prepend=0)).max() <= acceleration + ROUNDING
    assert steps.min() >= -ROUNDING
    assert steps.max() <= limit + ROUNDING
    assert core.lib.path_filter_at_rest(path.c, target)


MOVES = st.lists(st.tuples(st.floats(-1.5, 1.5), SPEEDS, ACCELERATIONS, st.integers(1, 400)), min_size=2, max_size=6)


@given(omega=st.sampled_from(sorted(SETTLED)), start=I32, step=SPEEDS, moves=MOVES)
@settings(max_examples=80)
def test_targets_and_limits_that_change_in_flight_never_exceed_a_limit(
    core: Core, omega: int, start: int, step: int, moves: list[tuple[float, int, int, int]]
) -> None:
    """The ramp keeps the limits of the tick, the lagging output the largest limits so far; it ends on the target."""
    path = Path(core, omega, start, step)
    target, before, fastest, hardest = start, [start * ONE - step], step, 0
    output = [start * ONE]
    limit = acceleration = 1
    for part, limit, acceleration, ticks in moves:
        fastest, hardest = max(fastest, limit), max(hardest, acceleration)
        direction = int(part * reachable(ticks, limit, acceleration))
        target = (path.position + direction + 2**31) % 2**32 - 2**31
        speed = path.c.speed
        log = moved(path, target, ticks, limit, acceleration)
        speeds = log[:, 1]
        assert np.all(np.abs(np.diff(speeds, prepend=speed)) <= acceleration)
        earlier = np.concatenate([[speed], speeds[:-1]])
        assert np.all(np.abs(speeds) <= np.maximum(limit, np.abs(earlier) - acceleration))
        output += log[:, 3].tolist()
    steps = np.diff(np.array(before + output, dtype=object)).astype(np.int64)
    assert np.abs(steps).max() <= fastest + ROUNDING
    assert np.abs(np.diff(steps)).max() <= hardest + ROUNDING
    # A stop, the motion back, and the remaining distance.
    speed = abs(path.c.speed)
    distance = abs(beyond(path.c.ramp, target)) + speed * speed // (2 * acceleration) + speed
    needed = ticks_of(distance, limit, acceleration) + speed / acceleration + 10
    if needed < 40_000:
        moved(path, target, math.ceil(needed) + SETTLED[omega], limit, acceleration)
        assert core.lib.path_filter_at_rest(path.c, target)


@given(step=SPEEDS, acceleration=ACCELERATIONS, spare=st.integers(0, 3), direction=st.sampled_from([1, -1]))
@settings(max_examples=80)
def test_target_beyond_the_stopping_distance_is_not_passed(
    core: Core, step: int, acceleration: int, spare: int, direction: int
) -> None:
    """Start at speed, with the stopping distance and at most three counts more."""
    path = Path(core, 3276, 0, direction * step)
    room = stopping_distance(max(step - acceleration, 0), acceleration) + acceleration // 8
    target = direction * (direction * path.c.ramp + math.ceil(room)) // ONE + direction * (1 + spare)
    needed = min(step // acceleration, 20_000) + 400
    log = moved(path, target, needed, SPEED_LIMIT, acceleration)
    assert (direction * log[:, 0]).max() <= direction * target * ONE
    assert (direction * log[:, 1]).min() >= 0


@given(
    step=SPEEDS,
    acceleration=ACCELERATIONS,
    omega=st.sampled_from(sorted(SETTLED)),
    part=st.floats(-1.0, 2.0),
    direction=st.sampled_from([1, -1]),
)
@settings(max_examples=80)
def test_braking_begins_at_once_when_steady_motion_would_pass_the_target(
    core: Core, step: int, acceleration: int, omega: int, part: float, direction: int
) -> None:
    """The output continues at its speed, which changes within the limit; a distant target changes nothing."""
    path = Path(core, omega, 0, direction * step)
    steady = state_of(path)
    stop = core.lib.path_filter_stopping_position(path.c, acceleration)
    target = int(part * stop) - direction
    core.lib.path_filter_start_braking(path.c, target, acceleration, omega)
    if part >= 1.1 and abs(stop) > 100:
        assert state_of(path) == steady
    if state_of(path) != steady:
        assert direction * core.lib.path_filter_stopping_position(path.c, acceleration) < direction * stop + 1
    output = moved(path, target, 1000, step, acceleration)[:, 3]
    steps = np.diff(np.concatenate([[-direction * step, 0], output]))
    assert np.abs(np.diff(steps)).max() <= acceleration * (1.0 + omega / 65536) + 10 * ROUNDING
    assert np.abs(steps).max() <= step + 10 * ROUNDING


@given(step=SPEEDS, acceleration=ACCELERATIONS, direction=st.sampled_from([1, -1]), again=st.integers(1, 300))
@settings(max_examples=80)
def test_stopping_position_is_the_end_of_full_braking(
    core: Core, step: int, acceleration: int, direction: int, again: int
) -> None:
    """The stopping position is at the end of full braking, and does not come closer when computed again later."""
    path = Path(core, 3276, 0, direction * step)
    stop = core.lib.path_filter_stopping_position(path.c, acceleration)
    minimum = stopping_distance(max(step - acceleration, 0), acceleration) if step > acceleration else Fraction(0)
    beyond_min = direction * (stop * ONE - path.c.ramp) - minimum
    assert 0 <= beyond_min <= 2 * ONE + acceleration // 4 + minimum / 2**14
    log = moved(path, stop, again, SPEED_LIMIT, acceleration)
    assert (direction * log[:, 0]).max() <= direction * stop * ONE
    assert direction * core.lib.path_filter_stopping_position(path.c, acceleration) >= direction * stop


@given(omegas=st.lists(st.integers(65, 3276), min_size=2, max_size=5), moves=MOVES)
@settings(max_examples=80)
def test_new_omegas_in_flight_keep_the_acceleration(
    core: Core, omegas: list[int], moves: list[tuple[float, int, int, int]]
) -> None:
    """Far from the target. The acceleration may exceed the limit by omega_n Ts, the filter's share of one tick."""
    path, acceleration = Path(core, omegas[0]), moves[0][2]
    limit = max(move[1] for move in moves)
    output = [0, 0]
    for k, (part, _, _, ticks) in enumerate(moves):
        target = 2**29 if part > 0.0 else -(2**29)
        path.retune(target, omegas[k % len(omegas)], acceleration)
        output += moved(path, target, ticks, limit, acceleration)[:, 3].tolist()
    steps = np.diff(output)
    assert np.abs(steps).max() <= limit + ROUNDING
    assert np.abs(np.diff(steps)).max() <= acceleration * (1.0 + max(omegas) / 65536) + 200 * ROUNDING


@given(omega=edges(1, 2**15), start=I32, targets=st.lists(I32, min_size=1, max_size=3), limit=edges(1, SPEED_LIMIT))
@settings(max_examples=60)
def test_e40_is_exact_within_its_rounding_over_the_whole_range(
    core: Core, omega: int, start: int, targets: list[int], limit: int
) -> None:
    """At most 2 / (omega_n Ts) of 2^-24 counts off the exact values, which are computed with 64 additional bits.

    A rounding of half an LSB in m is worth 1 / (2 omega_n Ts) in y, one in y twice that; both responses are monotonic.
    """
    path, more = Path(core, omega, start), 64
    m, y = 0, path.c.ramp << more
    for target in targets:
        for _ in range(60):
            path.step(target, limit)
            m += ((path.c.ramp << more) - 2 * m - y) * omega >> 16
            y += m * omega >> 16
            assert abs((path.c.output << more) - y) <= (2**17 << more) // omega


@given(output=edges(-(2**55) - ONE // 2, 2**55 - ONE // 2 - 1), target=I32, ramp=st.integers(-1, 1))
def test_position_is_the_nearest_count_and_rest_is_exact(core: Core, output: int, target: int, ramp: int) -> None:
    """Position: nearest count, halves upwards. At rest if it is the target and the ramp rests on it in every bit."""
    path = core.ffi.new("path_filter_t *")
    path.output = output
    position = nearest(output, ONE)
    assert core.lib.path_filter_position(path) == position
    for at in (target, position):
        path.ramp = at * ONE + ramp
        for path.speed in (0, 1):
            assert core.lib.path_filter_at_rest(path, at) == (at == position and ramp == 0 and path.speed == 0)


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
