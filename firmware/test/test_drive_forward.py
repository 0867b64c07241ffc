"""Feed-forward: speed and acceleration of the shaped set-point, and current against friction."""

from __future__ import annotations

import itertools
import math

import pytest
from core_library import Core
from servo_bench import COUNT, FEATURES, MODE, TICK, Bench, amps, rad_s, speed

K_T = 0.0462  # N m/A of axis 1, as configured
INERTIA = 0.8e-5


def lag(log: list[tuple[int, int]]) -> list[int]:
    return [reference - position for reference, position in log]


# ---- speed -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [100.0, 314.0])
def test_no_lag_with_speed_feed_forward(bench: Bench, limit: float) -> None:
    """Without it the lag is v / K_v (E44): 1061 counts at 100 rad/s, 3332 at 314."""
    bench.set_parameter("speed_limit", limit)
    bench.write(0, position=200_000)
    plain = lag(bench.follow(400))
    bench.write(0, quick_stop=1)
    bench.follow(400)
    bench.switch_on(0, FEATURES.SPEED_FORWARD)
    bench.slow()
    bench.write(0, enable=1, position=-200_000)
    forward = lag(bench.follow(400))
    assert plain[-1] == pytest.approx(limit / 60.0 / COUNT, rel=0.03)
    # An ideal shaft of the bench is one tick late: a step of the set-point.
    assert max(abs(x) for x in forward) <= limit * TICK / COUNT + 3


def test_move_with_feed_forward_ends_on_target_without_overshoot(bench: Bench) -> None:
    bench.switch_on(0, FEATURES.SPEED_FORWARD | FEATURES.ACCELERATION_FORWARD | FEATURES.FRICTION)
    bench.slow()
    bench.write(0, position=20_000)
    log = bench.follow(800)
    assert max(position for _, position in log) <= 20_001
    assert log[-1][0] == 20_000
    assert abs(log[-1][1] - 20_000) <= 1


def test_switching_speed_feed_forward_in_motion_waits_for_rest(bench: Bench) -> None:
    """Adding the speed in motion would be a step; the feature applies to the next move."""
    bench.set_parameter("speed_limit", 100.0)
    bench.write(0, position=20_000)
    before = [rad_s(bench.view(0).speed_ref) for _ in range(200) if bench.follow(1)]
    bench.switch_on(0, FEATURES.SPEED_FORWARD)
    after = [rad_s(bench.view(0).speed_ref) for _ in range(20) if bench.follow(1)]
    assert max(abs(b - a) for a, b in itertools.pairwise([*before[-20:], *after])) < 2.0
    assert lag(bench.follow(1))[-1] > 900
    bench.follow(1200)
    bench.write(0, position=0)
    assert max(abs(x) for x in lag(bench.follow(400))) <= 40


def test_change_to_position_mode_in_motion_is_bumpless_with_speed_feed_forward(bench: Bench) -> None:
    bench.switch_on(0, FEATURES.SPEED_FORWARD)
    bench.slow()
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.follow(200)
    bench.write(0, mode=MODE.POSITION, position=30_000)
    references = [rad_s(bench.view(0).speed_ref) for _ in range(20) if bench.follow(1)]
    assert references[0] == pytest.approx(100.0, abs=3.0)
    assert max(abs(b - a) for a, b in itertools.pairwise(references)) < 5.0


# ---- acceleration ----------------------------------------------------------------------------------------------------


def currents(core: Core, features: int, ticks: int, **commands: int) -> tuple[Bench, list[float]]:
    """Current set-points [A] of an axis whose shaft follows the speed set-point, independent of the current."""
    bench = Bench(core)
    bench.to_spin(0)
    bench.slow(2)
    bench.switch_on(0, features)
    if "position" in commands:
        bench.set_parameter("acceleration_limit", 50_000.0)  # the path filter is slower
    bench.slow()
    bench.write(0, **commands)
    return bench, [bench.view(0).i_q_ref / amps(1.0) for _ in range(ticks) if bench.follow(1)]


def test_speed_ramp_feeds_its_current_forward(bench: Bench) -> None:
    """J a / Kt in the first tick, before there is any error."""
    bench.set_parameter("acceleration_limit", 2000.0)
    bench.switch_on(0, FEATURES.ACCELERATION_FORWARD)
    bench.slow()
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.slow()
    proportional = rad_s(bench.view(0).speed_ref) * 2.0 * math.pi * 80.0 * INERTIA / K_T  # tune.py: speed_bandwidth
    expected = INERTIA * 2000.0 / K_T
    assert bench.view(0).i_q_ref / amps(1.0) == pytest.approx(expected + proportional, rel=0.05)


def test_path_acceleration_is_fed_forward_with_the_speed(core: Core) -> None:
    """The integral of the added current is the momentum J w of the path speed."""
    bench, with_it = currents(core, FEATURES.SPEED_FORWARD | FEATURES.ACCELERATION_FORWARD, 40, position=100_000)
    _, without = currents(core, FEATURES.SPEED_FORWARD, 40, position=100_000)
    gained = [a - b for a, b in zip(with_it, without, strict=True)]
    reached = rad_s(bench.axis(0).motion.shaped_speed)
    assert reached > 100.0
    assert sum(gained) * TICK * K_T / INERTIA == pytest.approx(reached, rel=0.01)
    # E40 needs up to half of the 4 A limit while accelerating (servo.toml: path_current_use).
    assert max(gained) == pytest.approx(2.0, rel=0.03)


def test_path_acceleration_needs_speed_feed_forward(core: Core) -> None:
    """Without speed feed-forward the shaft lags and accelerates later than the path."""
    _, with_it = currents(core, FEATURES.ACCELERATION_FORWARD, 60, position=10_000)
    _, without = currents(core, 0, 60, position=10_000)
    assert with_it == without


def test_change_of_mode_feeds_no_acceleration_forward(bench: Bench) -> None:
    """The shaped speed starts from the speed of the shaft, so the change itself needs no current."""
    bench.switch_on(0, FEATURES.ACCELERATION_FORWARD)
    bench.slow()
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.follow(300)
    for mode in ({"mode": 2, "i_q": 0}, {"mode": MODE.SPEED, "speed": speed(100.0)}, {"quick_stop": 1}):
        bench.write(0, **mode)
        bench.follow(1)
        assert abs(bench.axis(0).motion.acceleration) <= speed(4000.0 * TICK) + 1


# ---- friction --------------------------------------------------------------------------------------------------------


def test_friction_current_follows_the_set_point_not_the_shaft(bench: Bench) -> None:
    """A shaft rotated by hand at a set-point of zero gets no friction current."""
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.slow(5)
    bench.turn(0, 0.5)
    plain = bench.trace(60, lambda: bench.view(0).i_q_ref, follow=False)
    other = Bench(bench.core)
    other.to_spin(0)
    other.slow(2)
    other.switch_on(0, FEATURES.FRICTION)
    other.write(0, mode=MODE.SPEED, speed=0)
    other.slow(5)
    other.turn(0, 0.5)
    for k in range(60):
        other.slow()
        assert other.view(0).i_q_ref == plain[k]


@pytest.mark.parametrize("rad_per_s", [100.0, -100.0, 250.0])
def test_coulomb_and_viscous_friction_are_fed_forward(core: Core, rad_per_s: float) -> None:
    """2.0 mN m and 1e-5 N m s, as configured, over Kt."""
    _, with_it = currents(core, FEATURES.FRICTION, 200, mode=MODE.SPEED, speed=speed(rad_per_s))
    _, without = currents(core, 0, 200, mode=MODE.SPEED, speed=speed(rad_per_s))
    expected = math.copysign(2.0e-3, rad_per_s) + 1e-5 * rad_per_s
    assert with_it[-1] - without[-1] == pytest.approx(expected / K_T, abs=0.001)
