"""Speed observer: every bit against its equations, and its estimate from a counter."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache
from typing import Any

import pytest
from core_library import Core
from hypothesis import given
from hypothesis import strategies as st
from servo_bench import FEATURES, Bench, rad_s, speed

ONE = 2**22  # a count
FULL = 523.5987755982989
TICK = 0.5e-3
COUNT = 2.0 * math.pi / 4000
INT32 = (-(2**31), 2**31 - 1)
int32s = st.integers(*INT32)


@cache
def axis_config(core: Core) -> Any:
    """What the configuration computes for axis 1."""
    board = Bench(core)  # owns the block, must stay referenced
    return core.ffi.new("speed_observer_config_t *", board.axis(0).config.speed_observer)


def saturated(x: int) -> int:
    return max(INT32[0], min(INT32[1], x))


def rounded_gain(x: int, gain: int) -> int:
    """`f32_gain`: product rounded to nearest, halves up, saturated."""
    return saturated(math.floor(Fraction(x * gain, 2**24) + Fraction(1, 2)))


State = tuple[int, int, int, int, int]


def model(state: State, half: int, config: Any, count: int, part: int, i_q: int) -> tuple[State, int]:
    """One step in unlimited integers; all roundings downwards, except those of the gains."""
    last, last_part, offset, step, acceleration = state
    total = (i_q * 2**16 * config.acceleration_per_current >> 31) + acceleration
    moved = ((count - last + 2**31) % 2**32 - 2**31) * ONE + (part >> 2) - (last_part >> 2)
    offset = saturated(offset + step + (total >> 1) - moved)
    step = saturated(step + total)
    error = half - offset if offset > half else -half - offset if offset < -half else 0
    if abs(error) > 64 * ONE:
        speed = saturated(saturated(moved) * config.speed_per_step >> 22)
        step = saturated(speed * config.step_per_speed >> 25)
        offset, acceleration = 0, 0
    elif error:
        offset += rounded_gain(error, config.l_position)
        step = saturated(step + rounded_gain(error, config.l_speed))
        acceleration = saturated(acceleration + rounded_gain(error, config.l_acceleration))
    return (count, part, offset, step, acceleration), saturated(step * config.speed_per_step >> 22)


@given(
    count=int32s,
    moved=st.one_of(st.integers(-200, 200), int32s),
    offset=st.one_of(st.integers(-ONE, ONE), int32s),
    step=int32s,
    acceleration=int32s,
    parts=st.tuples(*[st.sampled_from([0, 0, 1, 2**23, -(2**23)])] * 2),
    lines=st.sampled_from([1000, 1000, 100, 16384]),
    i_q=st.integers(-(2**15), 2**15 - 1),
)
def test_step_agrees_with_the_model(
    core: Core,
    count: int,
    moved: int,
    offset: int,
    step: int,
    acceleration: int,
    parts: tuple[int, int],
    lines: int,
    i_q: int,
) -> None:
    """Exact over the whole range of every number, with saturation and the wrap of the count, for any encoder."""
    config = axis_config(core)
    now = (count + moved + 2**31) % 2**32 - 2**31
    observer = core.ffi.new("speed_observer_t *", {"half_count": 500 * ONE // lines})
    fields = "count", "part", "offset", "step", "acceleration"
    before = count, parts[0], offset, step, acceleration
    for name, value in zip(fields, before, strict=True):
        setattr(observer, name, value)
    state, expected = model(before, observer.half_count, config, now, parts[1], i_q)
    assert core.lib.speed_observer_step(observer, config, now, parts[1], i_q) == expected
    assert tuple(getattr(observer, name) for name in fields) == state


@given(raw=int32s, count=int32s)
def test_observer_starts_with_the_given_speed(core: Core, raw: int, count: int) -> None:
    config = axis_config(core)
    observer = core.ffi.new("speed_observer_t *")
    core.lib.speed_observer_reset(observer, config, count, 0, raw)
    counts_per_tick = raw / 2**31 * FULL * TICK / COUNT
    assert observer.step / ONE == pytest.approx(counts_per_tick, rel=1e-5, abs=1e-6)
    assert (observer.count, observer.offset, observer.acceleration) == (count, 0, 0)


class Shaft:
    """A shaft with a torque, and the count of an encoder with edges between the counts."""

    def __init__(self, core: Core, speed_rad_s: float = 0.0) -> None:
        self.core, self.config = core, axis_config(core)
        self.observer = core.ffi.new("speed_observer_t *", {"half_count": ONE // 2})
        self.theta, self.omega = 0.0, speed_rad_s
        core.lib.speed_observer_reset(self.observer, self.config, 0, 0, 0)

    def step(self, i_q: float = 0.0, load: float = 0.0) -> float:
        """One tick with a current [A] that is fed forward and a load [N m] that is not; return the speed."""
        acceleration = (0.0462 * i_q - load) / 0.8e-5
        self.theta += self.omega * TICK + 0.5 * acceleration * TICK**2
        self.omega += acceleration * TICK
        raw = self.core.lib.speed_observer_step(
            self.observer, self.config, round(self.theta / COUNT), 0, round(i_q / 8.25 * 2**15)
        )
        return rad_s(raw)


@pytest.mark.parametrize("omega", [0.05, 0.5, 5.0, 50.0, 314.0, -0.5, -314.0])
def test_constant_speed_is_found(core: Core, omega: float) -> None:
    """0.5 to 3000 rpm, within the correction of one edge (`l_speed` counts per tick: 0.41 rad/s) and 0.2 %."""
    shaft = Shaft(core, omega)
    edges = abs(omega) / COUNT
    for _ in range(round(30.0 / edges / TICK) + 400):
        shaft.step()
    errors = [abs(shaft.step() - shaft.omega) for _ in range(400)]
    edge = shaft.config.l_speed / 2**24 * COUNT / TICK
    assert max(errors) <= 1.1 * edge + 0.002 * abs(omega)


def test_acceleration_by_i_q_is_fed_forward(core: Core) -> None:
    """With 20 mA from rest the first edge occurs after 4 ms; the estimate is also correct in every tick before."""
    shaft = Shaft(core)
    for _ in range(8):
        assert shaft.step(i_q=0.02) == pytest.approx(shaft.omega, abs=0.02)


def test_unknown_load_is_estimated(core: Core) -> None:
    """Time constant 2 ms (80 Hz): the load is estimated after 15 ms."""
    shaft = Shaft(core, 20.0)
    for _ in range(200):
        shaft.step()
    for _ in range(30):
        shaft.step(load=2e-3)
    for _ in range(50):
        assert shaft.step(load=2e-3) == pytest.approx(shaft.omega, abs=0.5)
    learnt = shaft.observer.acceleration / ONE * COUNT / TICK**2
    assert learnt == pytest.approx(-2e-3 / 0.8e-5, rel=0.1)


def test_estimate_at_rest_is_zero(core: Core) -> None:
    """Within one count there is no correction, so no hunting."""
    shaft = Shaft(core)
    assert {shaft.step() for _ in range(1000)} == {0.0}


def test_jump_of_the_counter_is_adopted(core: Core) -> None:
    """A jump of the counter is adopted, without wind-up of the estimate."""
    shaft = Shaft(core)
    shaft.theta = 500 * COUNT
    shaft.step()
    for _ in range(100):
        speed_seen = shaft.step()
    assert speed_seen == pytest.approx(0.0, abs=0.5)


# ---- in the axis ----------------------------------------------------------------------------------------------------


def spinning(core: Core) -> Bench:
    bench = Bench(core)
    bench.to_spin(0)
    bench.slow(2)
    return bench


def test_enabling_the_observer_is_bumpless(core: Core) -> None:
    bench = spinning(core)
    bench.turn_without_current(0, 100.0)
    bench.slow(100)
    bench.switch_on(0, FEATURES.SPEED_OBSERVER)
    for _ in range(50):
        bench.slow()
        assert rad_s(bench.view(0).speed) == pytest.approx(100.0, abs=3.0)
    bench.switch_on(0, 0)
    bench.slow(5)
    assert bench.view(0).speed == bench.axis(0).encoder.speed.speed


def test_disabled_observer_has_no_effect(core: Core) -> None:
    bench = spinning(core)
    bench.turn_without_current(0, 20.0)
    for _ in range(100):
        bench.slow()
        assert bench.view(0).speed == bench.axis(0).encoder.speed.speed


def test_standstill_and_position_come_from_encoder(core: Core) -> None:
    """Standstill is detected by the edges; stops and the rotor search use it."""
    bench = spinning(core)
    bench.switch_on(0, FEATURES.SPEED_OBSERVER)
    bench.turn_without_current(0, 20.0)
    bench.slow(50)
    assert not bench.axis(0).feedback.still
    bench.turn(0, 0.0)
    bench.slow(400)
    assert bench.axis(0).feedback.still
    assert abs(bench.view(0).speed) < speed(0.05)
    bench.write(0, enable=0)
    bench.until(lambda: bench.states()[0][0] == 2, 4000)
