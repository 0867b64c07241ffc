"""Only a newly written command starts or accelerates a shaft."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from core_library import Core
from servo_bench import COUNT, FEATURES, LIMITS, MODE, REFERENCE_FEATURES, STATE, SUBSTATE, Bench, amps, rad_s, speed


@pytest.fixture
def bench(core: Core) -> Bench:
    bench = Bench(core)
    bench.to_spin(0)
    bench.slow(100)
    return bench


def speed_of(bench: Bench) -> float:
    return abs(rad_s(bench.view(0).speed_ref))


# ---- limits widen only with a command -------------------------------------------------------------------------------


def held_by_soft_limit(bench: Bench) -> None:
    """Commanded to 50 rad/s and held at a soft limit 10 rad ahead."""
    bench.switch_on(0, FEATURES.POSITION_LIMITS)
    bench.set_parameter("position_max", 10.0)
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    bench.follow(2000)
    assert speed_of(bench) < 0.01
    assert bench.view(0).position * COUNT == pytest.approx(10.0, abs=0.01)
    assert bench.view(0).limits & LIMITS.POSITION


@pytest.mark.parametrize(
    "widen",
    [
        pytest.param(lambda bench: bench.set_parameter("position_max", 1000.0), id="limit"),
        pytest.param(lambda bench: bench.write_raw("param.features", [REFERENCE_FEATURES] * 2), id="feature"),
    ],
)
def test_shaft_held_by_a_soft_limit_stays_when_the_limit_is_removed(
    bench: Bench, widen: Callable[[Bench], None]
) -> None:
    held_by_soft_limit(bench)
    before = bench.view(0).position
    widen(bench)
    bench.follow(2000)
    assert abs(bench.view(0).position - before) <= 1
    bench.write(0, speed=speed(50.0))
    bench.follow(200)
    assert speed_of(bench) == pytest.approx(50.0, rel=1e-3)


def test_speed_reduced_by_a_limit_is_restored_by_a_set_point(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.follow(200)
    bench.set_parameter("speed_limit", 20.0)
    bench.follow(200)
    assert speed_of(bench) == pytest.approx(20.0, rel=1e-3)
    bench.set_parameter("speed_limit", 200.0)
    bench.follow(400)
    assert speed_of(bench) == pytest.approx(20.0, rel=1e-3)
    bench.write(0, speed=speed(100.0))
    bench.follow(200)
    assert speed_of(bench) == pytest.approx(100.0, rel=1e-3)


def test_position_move_keeps_the_speed_limit_of_its_start(bench: Bench) -> None:
    bench.set_parameter("speed_limit", 50.0)
    bench.write(0, mode=MODE.POSITION, position=1_000_000)
    bench.follow(1000)
    bench.set_parameter("speed_limit", 300.0)
    bench.follow(1000)
    assert speed_of(bench) == pytest.approx(50.0, rel=1e-2)
    bench.write(0, position=1_000_000)
    bench.follow(1000)
    assert speed_of(bench) == pytest.approx(300.0, rel=1e-2)


def test_current_reduced_by_a_limit_is_restored_by_a_set_point(bench: Bench) -> None:
    bench.write(0, mode=MODE.TORQUE, i_q=amps(2.0))
    bench.slow(2)
    bench.set_parameter("i_q_limit", 0.5)
    bench.slow(2)
    assert bench.view(0).i_q_ref == pytest.approx(amps(0.5), abs=1)
    bench.set_parameter("i_q_limit", 4.0)
    bench.slow(20)
    assert bench.view(0).i_q_ref == pytest.approx(amps(0.5), abs=1)
    bench.write(0, i_q=amps(2.0))
    bench.slow(2)
    assert bench.view(0).i_q_ref == pytest.approx(amps(2.0), abs=1)


def test_ramp_keeps_the_acceleration_of_its_start(bench: Bench) -> None:
    bench.set_parameter("acceleration_limit", 100.0)
    bench.write(0, mode=MODE.SPEED, speed=speed(300.0))
    bench.follow(200)
    bench.set_parameter("acceleration_limit", 4000.0)
    before = speed_of(bench)
    bench.follow(200)
    assert speed_of(bench) - before == pytest.approx(100.0 * 0.1, rel=1e-2)
    bench.write(0, speed=speed(300.0))
    bench.follow(200)
    assert speed_of(bench) == pytest.approx(300.0, rel=1e-3)


def test_enable_applies_the_present_limits(bench: Bench) -> None:
    bench.set_parameter("speed_limit", 20.0)
    bench.follow(10)
    bench.write(0, enable=0)
    bench.slow(2500)
    bench.set_parameter("speed_limit", 200.0)
    bench.to_spin(0)
    assert rad_s(bench.axis(0).limits.speed) == pytest.approx(200.0)


# ---- set-points expire ----------------------------------------------------------------------------------------------


@pytest.fixture
def expiring(bench: Bench) -> Bench:
    """Set-points expire after 0.1 s."""
    bench.set_parameter("command_timeout", 0.1)
    return bench


def test_set_points_expire_half_a_second_after_reset(core: Core) -> None:
    bench = Bench(core)
    core.lib.servo_init(bench.servo, bench.hal, core.lib.probe_config())
    assert bench.servo.parameter.command_timeout * 0.5e-3 == 0.5


@pytest.mark.parametrize("sign", [1, -1])
def test_expired_speed_set_point_causes_a_stop_and_a_hold(expiring: Bench, sign: int) -> None:
    bench = expiring
    bench.write(0, mode=MODE.SPEED, speed=speed(sign * 100.0))
    bench.follow(199)
    assert speed_of(bench) == pytest.approx(100.0, rel=1e-2)
    assert not bench.view(0).limits & LIMITS.EXPIRED
    bench.follow(int(100.0 / 4000.0 / 0.5e-3) + 5)
    assert speed_of(bench) < 1.0
    assert bench.view(0).limits & LIMITS.EXPIRED
    assert (bench.view(0).state, bench.view(0).substate, bench.view(0).faults) == (STATE.RUN, SUBSTATE.SPIN, 0)
    bench.follow(100)
    held = bench.view(0).position
    bench.follow(2000)
    assert abs(bench.view(0).position - held) <= 1
    assert bench.view(0).limits & LIMITS.EXPIRED, "until the next set-point"
    bench.write(0, speed=speed(sign * 100.0))
    bench.follow(100)
    assert speed_of(bench) == pytest.approx(100.0, rel=1e-2)
    assert not bench.view(0).limits & LIMITS.EXPIRED


def test_expired_torque_set_point_causes_a_stop(expiring: Bench) -> None:
    bench = expiring
    bench.turn(0, 100.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(1.0))
    bench.slow(199)
    assert bench.view(0).i_q_ref == pytest.approx(amps(1.0), abs=1)
    bench.slow(20)
    assert bench.view(0).i_q_ref < 0, "the shaft is braked"
    assert bench.view(0).limits & LIMITS.EXPIRED


@pytest.mark.parametrize(
    ("mode", "name", "value"), [(MODE.SPEED, "speed", speed(50.0)), (MODE.TORQUE, "i_q", amps(0.5))]
)
def test_renewed_set_point_stays_active(expiring: Bench, mode: int, name: str, value: int) -> None:
    bench = expiring
    bench.write(0, mode=mode)
    for _ in range(20):
        bench.write(0, **{name: value})
        bench.follow(150)
        assert not bench.view(0).limits & LIMITS.EXPIRED
    assert bench.view(0).i_q_ref == value if mode == MODE.TORQUE else speed_of(bench) == pytest.approx(50.0, rel=1e-3)


@pytest.mark.parametrize(
    "other", [{"position": 5}, {"i_q": 100}, {"mode": MODE.SPEED}, {"enable": 1}, {"clear_faults": 1}]
)
def test_other_commands_do_not_renew_a_speed(expiring: Bench, other: dict[str, int]) -> None:
    bench = expiring
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    for _ in range(30):
        bench.write(0, **other)
        bench.follow(10)
    assert speed_of(bench) < 1.0


def test_set_point_of_one_axis_does_not_renew_that_of_the_other(expiring: Bench) -> None:
    bench = expiring
    bench.write(1, enable=1)
    bench.to_substate(1, SUBSTATE.SPIN)
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    bench.write(1, mode=MODE.SPEED)
    for _ in range(30):
        bench.write(1, speed=speed(10.0))
        bench.follow(10)
    assert bench.view(0).limits & LIMITS.EXPIRED
    assert not bench.view(1).limits & LIMITS.EXPIRED


def test_longer_time_out_does_not_restore_an_expired_set_point(expiring: Bench) -> None:
    bench = expiring
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    bench.follow(400)
    for seconds in (30.0, 0.0):
        bench.set_parameter("command_timeout", seconds)
        bench.follow(200)
        assert speed_of(bench) < 0.1


def test_positions_and_axes_at_rest_do_not_expire(expiring: Bench) -> None:
    bench = expiring
    bench.write(0, mode=MODE.POSITION, position=4000)
    bench.follow(2000)
    assert abs(bench.view(0).position - 4000) <= 1
    assert not bench.view(0).limits & LIMITS.EXPIRED
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.follow(2000)
    assert not bench.view(0).limits & LIMITS.EXPIRED, "nothing was lost"


def test_expired_torque_set_point_ends_in_a_reported_hold(expiring: Bench) -> None:
    bench = expiring
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.slow(300)
    assert bench.view(0).limits & LIMITS.EXPIRED


def test_time_out_of_zero_disables_the_expiry(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(50.0))
    bench.follow(70_000)  # more than 16 bits of slow ticks
    assert speed_of(bench) == pytest.approx(50.0, rel=1e-3)
