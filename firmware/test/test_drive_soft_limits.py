"""Soft limits of the position: no motion beyond them, and no motion caused by them."""

from __future__ import annotations

import itertools
import math

import pytest
from core_library import Core
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from servo_bench import COUNT, FEATURES, LIMITS, MODE, TICK, Bench, amps, rad_s, speed
from test_drive_motion import move_counters


def confine(bench: Bench, low: int, high: int) -> None:
    """Set the limits of axis 1 [counts] and switch them on."""
    bench.write_raw("param.position_min", [low, 0])
    bench.write_raw("param.position_max", [high, 0])
    bench.switch_on(0, FEATURES.POSITION_LIMITS)
    bench.slow()


@pytest.mark.parametrize(("target", "limit"), [(50_000, 8000), (-50_000, -6000)])
def test_move_ends_at_the_limit(bench: Bench, target: int, limit: int) -> None:
    confine(bench, -6000, 8000)
    bench.write(0, position=target)
    log = bench.follow(900)
    assert max(abs(position) for _, position in log) <= abs(limit) + 1
    assert abs(log[-1][1] - limit) <= 1
    assert bench.view(0).limits & LIMITS.POSITION


def test_move_inside_the_limits_is_not_affected(core: Core) -> None:
    """A move to a target within the limits is identical in every tick."""
    logs = []
    for on in (False, True):
        bench = Bench(core)
        bench.to_spin(0)
        bench.slow(2)
        if on:
            confine(bench, -8000, 8000)
        else:
            bench.slow()
        bench.write(0, position=8000)
        logs.append(bench.follow(600))
        assert not bench.view(0).limits & LIMITS.POSITION
    assert logs[0] == logs[1]


@pytest.mark.parametrize("acceleration", [4000.0, 50_000.0, 2000.0])
@pytest.mark.parametrize("rad_per_s", [314.0, 60.0, -314.0, -60.0])
def test_speed_falls_towards_the_limit(bench: Bench, rad_per_s: float, acceleration: float) -> None:
    bench.set_parameter("acceleration_limit", acceleration)
    confine(bench, -60_000, 60_000)
    bench.servo.parameter.faults_enabled = [0, 0]  # voltage without current is a fault
    bench.write(0, mode=MODE.SPEED, speed=speed(rad_per_s))
    positions, speeds = [], []
    for _ in range(3500):
        bench.turn(0, rad_s(bench.view(0).speed_ref))
        bench.slow()
        positions.append(bench.view(0).position)
        speeds.append(rad_s(bench.view(0).speed_ref))
    assert max(abs(p) for p in positions) <= 60_000 + 1
    assert abs(positions[-1]) >= 60_000 - 12, "it stops close to the limit"
    assert max(abs(v) for v in speeds) == pytest.approx(abs(rad_per_s), rel=1e-3), "full speed far from the limit"
    braking = max((abs(a) - abs(b)) / TICK for a, b in itertools.pairwise(speeds))
    assert braking <= 0.55 * 0.0462 * 4.0 / 0.8e-5, "braking with at most half of the current"
    assert braking <= acceleration * 1.001
    assert bench.view(0).limits & LIMITS.POSITION


def test_motion_away_from_a_limit_is_not_restricted(bench: Bench) -> None:
    confine(bench, -2000, 2000)
    bench.write(0, mode=MODE.SPEED, speed=speed(20.0))
    bench.follow(1000)
    bench.write(0, speed=speed(-20.0))
    bench.follow(100)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(-20.0, rel=1e-3)
    assert not bench.view(0).limits & LIMITS.POSITION


def test_torque_ends_at_the_limit(bench: Bench) -> None:
    """At the limit the current brakes the remaining speed and does not push against the limit."""
    confine(bench, -2000, 2000)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(1.0))
    bench.slow(3)
    assert bench.view(0).i_q_ref == amps(1.0), "no limitation inside"
    bench.turn(0, 50.0)
    bench.until(lambda: bench.view(0).position > 1990, 200)
    bench.turn(0, 5.0)
    bench.slow(20)
    assert bench.view(0).i_q_ref < 0
    assert bench.view(0).limits & LIMITS.POSITION
    assert not bench.view(0).limits & LIMITS.SPEED
    bench.turn(0, 0.0)
    bench.slow(2000)
    assert bench.view(0).i_q_ref < 0, "the holding current stays, as the load may persist"
    bench.turn(0, -5.0)
    bench.slow(100)
    bench.turn(0, 0.0)
    bench.slow(500)
    assert bench.axis(0).motion.limit_hold_current == 0, "released"


@pytest.mark.parametrize("sign", [1, -1])
def test_torque_holds_against_a_load_at_the_limit(bench: Bench, sign: int) -> None:
    """Like the integral part of the speed controller: ki per count beyond the limit, released on the way back."""
    confine(bench, -2000, 2000)
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.turn(0, sign * 50.0)
    bench.until(lambda: sign * bench.view(0).position >= 1950, 200)
    bench.turn(0, sign * 0.5)
    bench.until(lambda: sign * bench.view(0).position >= 2000, 400)
    bench.turn(0, 0.0)
    bench.slow(300)
    rest, begin = bench.view(0).i_q_ref, bench.view(0).position
    per_count = bench.axis(0).config.speed.ki / 2**24 * speed(COUNT / 0.5e-3) / 2**16
    bench.turn(0, sign * 0.5)
    bench.slow(12)
    bench.turn(0, 0.0)
    bench.slow(300)
    pushed = abs(bench.view(0).position - begin)
    assert pushed >= 2
    assert sign * bench.view(0).i_q_ref == pytest.approx(sign * rest - per_count * pushed, abs=2.0)
    bench.turn(0, -sign * 50.0)
    bench.slow(40)
    assert bench.view(0).i_q_ref == 0, "inside the limits the commanded torque applies"


@pytest.mark.parametrize("sign", [1, -1])
def test_torque_against_a_load_stays_within_the_current_limit(bench: Bench, sign: int) -> None:
    """The holding current saturates at the current limit, without wind-up."""
    bench.set_parameter("i_q_limit", 1.0)
    confine(bench, -2000, 2000)
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.turn(0, sign * 30.0)
    bench.slow(1500)
    assert bench.view(0).i_q_ref == pytest.approx(-sign * amps(1.0), abs=1)
    bench.turn(0, -sign * 30.0)
    back = bench.until(lambda: bench.view(0).i_q_ref == 0, 60)
    assert back >= 1


def test_torque_mode_begins_without_the_holding_current_of_an_earlier_load(bench: Bench) -> None:
    confine(bench, -2000, 2000)
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.turn(0, 30.0)
    bench.slow(400)
    assert bench.view(0).i_q_ref < 0
    bench.turn(0, 0.0)
    bench.slow(300)
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.slow(2)
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.slow(2)
    assert bench.axis(0).motion.limit_hold_current == 0


@pytest.mark.parametrize(("low", "high"), [(100, 5000), (-5000, -100), (100, -100), (-100, -200)])
def test_limits_behind_the_shaft_do_not_move_it(bench: Bench, low: int, high: int) -> None:
    """No motion without a command, also with contradictory limits."""
    confine(bench, low, high)
    for _ in range(200):
        bench.slow()
        assert (bench.view(0).position_ref, bench.view(0).speed_ref) == (0, 0)


@pytest.mark.parametrize("mode", [MODE.POSITION, MODE.SPEED])
def test_outside_the_limits_only_inward_motion_is_permitted(bench: Bench, mode: int) -> None:
    confine(bench, 1000, 5000)
    outwards = {"position": -3000} if mode == MODE.POSITION else {"speed": speed(-20.0)}
    bench.write(0, mode=mode, **outwards)
    bench.follow(300)
    assert abs(bench.view(0).position) <= 1
    inwards = {"position": 3000} if mode == MODE.POSITION else {"speed": speed(20.0)}
    bench.write(0, mode=mode, **inwards)
    bench.follow(900)
    assert bench.view(0).position >= 2900


@pytest.mark.parametrize("sign", [1, -1])
def test_outside_the_limits_a_target_across_the_wrap_causes_no_motion(bench: Bench, sign: int) -> None:
    """Across the wrap the target is beyond the opposite limit."""
    move_counters(bench, sign * 2_100_000_000)
    confine(bench, -900_000_000, 900_000_000)
    bench.slow(2)
    before = bench.view(0).position
    bench.write(0, mode=MODE.POSITION)
    bench.follow(20)
    bench.write(0, position=-sign * 2_100_000_000)
    bench.follow(300)
    assert abs(bench.view(0).position - before) <= 1


def test_limits_narrowed_in_motion_stop_the_move(bench: Bench) -> None:
    bench.write(0, position=200_000)
    bench.follow(200)
    here = bench.view(0).position
    confine(bench, -1000, here + 20_000)
    log = bench.follow(900)
    assert max(position for _, position in log) <= here + 20_001
    assert abs(log[-1][1] - (here + 20_000)) <= 1


@pytest.mark.parametrize("ahead", [None, 3000])
@pytest.mark.parametrize("sign", [1, -1])
def test_passed_limit_stops_the_shaft_by_its_ramp(bench: Bench, sign: int, ahead: int | None) -> None:
    """A limit set behind a moving shaft or too close ahead: the shaft stops by its ramp and is not pulled back."""
    bench.write(0, position=sign * 200_000)
    bench.follow(400)
    assert abs(bench.axis(0).motion.path.speed) / 2**24 == pytest.approx(100.0, rel=1e-2)  # 314 rad/s
    reference = bench.view(0).position_ref
    limits = sorted([-sign * 1000, sign * 1000 if ahead is None else reference + sign * ahead])
    confine(bench, limits[0], limits[1])
    references = [sign * position_ref for position_ref, _ in bench.follow(900)]
    lead = 2.0 * 314.0 / COUNT / 100.0  # 2 v / omega_n, omega_n = 100 1/s
    stopping = 314.0**2 / (2.0 * 4000.0) / COUNT
    assert references == sorted(references)
    assert references[-1] - sign * reference == pytest.approx(lead + stopping, rel=0.05)
    assert bench.view(0).limits & LIMITS.POSITION


def test_stop_before_the_limit_ends_before_the_limit(bench: Bench) -> None:
    """A low acceleration limit does not move a stopping shaft beyond its soft limit."""
    bench.set_parameter("acceleration_limit", 1000.0)
    confine(bench, -1_000_000, 60_000)
    bench.write(0, mode=MODE.SPEED, speed=speed(314.0))
    while bench.view(0).position < 55_000:
        bench.follow(1)
    bench.write(0, quick_stop=1)
    assert max(position for _, position in bench.follow(1500)) <= 60_001


@pytest.mark.parametrize("beyond", [0, 100_000])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("before", [1000, 5000, 10_000, 14_000])
def test_change_to_position_mode_before_the_limit_passes_it_by_at_most_0_3_rad(
    bench: Bench, before: int, sign: int, beyond: int
) -> None:
    """Change from speed to position mode with a target at the limit: braking starts at once, overshoot <= 0.3 rad.

    That is the difference of the lag v / Kv and the remaining distance of the linear part of the approach.
    """
    confine(bench, -100_000, 100_000)
    bench.write(0, mode=MODE.SPEED, speed=speed(sign * 314.0))
    while abs(bench.view(0).position) < 100_000 - before:
        bench.follow(1)
    speeds, furthest = [], 0
    bench.write(0, mode=MODE.POSITION, position=sign * (100_000 + beyond))
    for _ in range(900):
        bench.follow(1)
        furthest = max(furthest, abs(bench.view(0).position))
        speeds.append(rad_s(bench.axis(0).motion.shaped_speed))
    accelerations = [abs(b - a) / TICK for a, b in itertools.pairwise(speeds)]
    assert max(accelerations) <= 4000.0 * 1.001
    assert (furthest - 100_000) * COUNT <= 0.3
    assert abs(bench.view(0).position) >= 100_000 - 2


@pytest.mark.parametrize("quick_stop", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_limit_moved_behind_a_rotating_shaft_causes_a_ramp(bench: Bench, sign: int, quick_stop: int) -> None:
    """The limit is moved behind the shaft: the speed set-point has no step."""
    bench.write(0, mode=MODE.SPEED, speed=speed(sign * 200.0))
    bench.follow(300)
    here = bench.view(0).position
    if quick_stop:
        bench.write(0, quick_stop=1)
    confine(bench, *sorted([-sign * 10_000, here]))
    speeds = [200.0, *bench.trace(300, lambda: sign * rad_s(bench.view(0).speed_ref))]
    steps = [a - b for a, b in itertools.pairwise(speeds)]
    assert max(steps[1:]) <= 4000.0 * 0.5e-3 * 1.001
    assert speeds[-1] == pytest.approx(0.0, abs=0.2)
    assert sign * (bench.view(0).position - here) == pytest.approx(200.0**2 / 8000.0 / COUNT, rel=0.05)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    low=st.integers(-(10**9), 10**9),
    high=st.integers(-(10**9), 10**9),
    here=st.one_of(st.integers(-(10**9), 10**9), st.none()),
    near=st.floats(0.0, 17.0),
    omega=st.integers(1, 16384),
    maximum=st.floats(0.1, 419.0),
    acceleration=st.floats(0.0, math.log(50_000.0)).map(math.exp),
)
def test_allowed_speed_over_the_distance_to_a_limit(
    core: Core, low: int, high: int, here: int | None, near: float, omega: int, maximum: float, acceleration: float
) -> None:
    """v <= (omega_n / e) distance, up to the tangent of the parabola of half the acceleration limit.

    Within 1e-3 of it, never beyond the speed limit, never towards a passed limit.
    """
    bench = Bench(core)
    axis = bench.axis(0)
    axis.parameter.features = FEATURES.POSITION_LIMITS
    here = high - round(math.exp(near)) if here is None else here
    axis.limits.position_min, axis.limits.position_max = low, high
    axis.limits.speed = speed(maximum)
    axis.limits.acceleration = speed(acceleration * TICK)
    axis.feedback.position = here
    axis.path_limits = core.lib.soft_limits_path(axis.config, core.ffi.addressof(axis.limits), omega)
    allowed = core.lib.soft_limits_speed(core.ffi.addressof(axis))

    def expected(counts: int) -> float:
        k, a = omega / 65536 / TICK / math.e, 0.5 * acceleration
        distance = max(counts * COUNT, 0.0)
        if distance > a / k**2:
            return min(maximum, math.sqrt(2.0 * a * (distance - 0.5 * a / k**2)) - 0.5 * a * TICK)
        return min(maximum, k * distance)

    assert rad_s(allowed.max) == pytest.approx(expected(high - here), rel=1e-3, abs=0.1 * acceleration * TICK)
    assert rad_s(allowed.min) == pytest.approx(-expected(here - low), rel=1e-3, abs=0.1 * acceleration * TICK)
