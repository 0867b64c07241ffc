"""From commands to i_q*: new writes, modes, ramps, limits (DRM 2.5..2.7)."""

from __future__ import annotations

import itertools
import math

import pytest
from core_library import Core
from servo_bench import COUNT, FEATURES, LIMITS, MODE, SUBSTATE, TICK, Bench, amps, rad_s, speed

# ---- fresh writes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["position", "speed", "i_q"])
def test_set_point_from_before_spin_does_not_move_the_axis(core: Core, name: str) -> None:
    bench = Bench(core)
    bench.to_stop()
    mode = {"position": MODE.POSITION, "speed": MODE.SPEED, "i_q": MODE.TORQUE}[name]
    value = {"position": 5000, "speed": speed(100.0), "i_q": amps(1.0)}[name]
    bench.write(0, mode=mode, **{name: value})
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.ALIGN)
    bench.write(0, mode=mode, **{name: value})
    bench.to_substate(0, SUBSTATE.SPIN)
    for _ in range(100):
        bench.slow()
        view = bench.view(0)
        assert (view.i_q_ref, view.speed_ref) == (0, 0)
        assert abs(view.position_ref - view.position) <= 1
    bench.write(0, **{name: value})
    bench.slow(20)
    view = bench.view(0)
    assert (view.i_q_ref, view.speed_ref) != (0, 0), "accepted when written again"


def test_motion_state_is_reset_after_a_fault(bench: Bench) -> None:
    """The ramp and the integral part of the speed controller are reset."""
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.slow(200)  # the shaft does not move: the integrator winds up
    assert bench.view(0).i_q_ref > amps(3.0)
    bench.hal.axis[0].over_current = True
    bench.slow(2)
    bench.hal.axis[0].over_current = False
    bench.clear(0)
    bench.to_spin(0)
    for _ in range(50):
        assert (bench.view(0).speed_ref, bench.view(0).i_q_ref) == (0, 0)
        bench.slow()


def test_write_of_the_other_axis_is_no_new_command(core: Core) -> None:
    bench = Bench(core)
    bench.to_spin(0, 1)
    bench.servo.command.position[0] = 4000  # in memory, without a write
    bench.write(1, position=2000)
    bench.slow(50)
    assert bench.view(0).position_ref == bench.view(0).position
    assert bench.view(1).position_ref > 0


def test_both_axes_start_in_the_same_tick(core: Core) -> None:
    bench = Bench(core)
    bench.to_spin(0, 1)
    bench.write_raw("cmd.position", [3000, -3000])
    bench.slow(20)
    assert bench.view(0).position_ref - bench.view(0).position > 0
    assert bench.view(1).position_ref - bench.view(1).position < 0
    a, b = (abs(bench.axis(i).motion.path.ramp) for i in range(2))
    assert a == b


# ---- position -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", [400, 4000, -12345, 100 * 4000])
def test_position_move_ends_on_target_without_overshoot(bench: Bench, target: int) -> None:
    bench.write(0, position=target)
    log = bench.follow(500 + abs(target) // 95)
    sign = 1 if target > 0 else -1
    assert max(sign * position for _, position in log) <= abs(target) + 1
    assert abs(log[-1][1] - target) <= 1
    assert log[-1][0] == target
    assert rad_s(bench.view(0).speed_ref) == 0.0


def test_position_lag_is_that_of_a_proportional_controller(bench: Bench) -> None:
    """E44: at constant speed the lag is speed / K_v (60 1/s)."""
    bench.set_parameter("speed_limit", 100.0)
    bench.write(0, position=100_000)
    log = bench.follow(600)
    reference, position = log[-1]
    assert (reference - position) * 2 * 3.14159265 / 4000 == pytest.approx(100.0 / 60.0, rel=0.03)


def test_new_target_during_a_move_is_reached_without_a_speed_step(bench: Bench) -> None:
    bench.write(0, position=20_000)
    bench.follow(100)
    bench.write(0, position=-1000)
    log = bench.follow(900)
    references = [reference for reference, _ in log]
    steps = [b - a for a, b in itertools.pairwise(references)]
    assert max(abs(b - a) for a, b in itertools.pairwise(steps)) <= 25, "no jump of the speed"
    assert abs(log[-1][1] + 1000) <= 1


def test_speed_limit_parameter_limits_moves(bench: Bench) -> None:
    bench.set_parameter("speed_limit", 50.0)
    bench.write(0, position=40_000)
    fastest = 0.0
    for _ in range(300):
        bench.turn(0, rad_s(bench.view(0).speed_ref))
        bench.slow()
        fastest = max(fastest, rad_s(bench.view(0).speed_ref))
    assert fastest == pytest.approx(50.0, rel=1e-3)


@pytest.mark.parametrize(("amperes", "limit"), [(4.0, 314.0), (1.0, 314.0), (0.2, 314.0), (2.0, 100.0), (4.0, 419.0)])
def test_moves_need_at_most_half_of_the_current_limit(bench: Bench, amperes: float, limit: float) -> None:
    """E40 accelerates with at most omega_n v / e; the filter is slowed down by the limits of the host."""
    bench.set_parameter("i_q_limit", amperes)
    bench.set_parameter("speed_limit", limit)
    bench.write(0, position=1_000_000)
    outputs = bench.trace(1500, lambda: bench.axis(0).motion.path.output / 2**24 * 2 * 3.14159265 / 4000)
    speeds = [(b - a) / 0.5e-3 for a, b in itertools.pairwise(outputs)]
    accelerations = [(b - a) / 0.5e-3 for a, b in itertools.pairwise(speeds)]
    available = 0.0462 * amperes / 0.8e-5  # k_t i / J of axis 1
    assert 0.05 * available < max(accelerations) <= 0.53 * available
    assert max(speeds) <= limit * 1.001


@pytest.mark.parametrize("quick_stop", [0, 1])
@pytest.mark.parametrize("acceleration", [4000.0, 100.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_speed_ramps_down_to_a_lowered_limit(bench: Bench, sign: int, acceleration: float, quick_stop: int) -> None:
    """The speed ramps down at the acceleration limit."""
    bench.write(0, mode=MODE.SPEED, speed=speed(sign * 300.0))
    bench.follow(400)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(sign * 300.0, rel=1e-3)
    bench.set_parameter("acceleration_limit", acceleration)
    bench.write(0, speed=speed(sign * 300.0))
    bench.follow(1)
    bench.set_parameter("speed_limit", 10.0)
    bench.write(0, quick_stop=quick_stop)
    bench.follow(1)  # a stop begins at the measured speed
    references = [
        sign * rad_s(bench.view(0).speed_ref),
        *bench.trace(round(310.0 / acceleration / TICK), lambda: sign * rad_s(bench.view(0).speed_ref)),
    ]
    steps = [a - b for a, b in itertools.pairwise(references)]
    assert max(steps) == pytest.approx(acceleration * TICK, rel=1e-3)
    assert min(steps) >= -0.2
    assert references[-1] == pytest.approx(0.0 if quick_stop else 10.0, abs=0.2)
    if not quick_stop:
        assert bench.view(0).limits & LIMITS.SPEED


@pytest.mark.parametrize("acceleration", [20.0, 4000.0])
@pytest.mark.parametrize("then", [None, -20_000, 1000, "limits"])
def test_acceleration_limit_bounds_every_position_move(
    bench: Bench, acceleration: float, then: int | str | None
) -> None:
    """Moves from rest to rest, with a reversal or a close target in motion, and with other speed and current limits."""
    bench.set_parameter("acceleration_limit", acceleration)
    bench.write(0, position=40_000)
    path = bench.axis(0).motion.path
    outputs = [0.0, path.output * COUNT / 2**24]
    duration = 2.0 * math.sqrt(40_000 * COUNT / acceleration) / TICK
    for k in range(round(3.0 * duration) + 300):
        if k == round(0.4 * duration):
            if isinstance(then, int):
                bench.write(0, position=bench.view(0).position_ref + then if then > 0 else then)
            elif then is not None:
                bench.set_parameter("speed_limit", 40.0)
                bench.set_parameter("i_q_limit", 1.0)
        bench.follow(1)
        outputs.append(path.output * COUNT / 2**24)
    assert path.speed == 0, "arrived"
    steps = [(b - a) / TICK for a, b in itertools.pairwise(outputs)]
    accelerations = [abs(b - a) / TICK for a, b in itertools.pairwise(steps)]
    assert 0.9 * acceleration < max(accelerations) <= acceleration * 1.0003 + 0.002  # of the fraction, of the output
    assert bench.view(0).faults == 0


def test_path_is_retuned_to_a_lowered_current_after_the_slow_loop(bench: Bench, core: Core) -> None:
    """The divisions are done in a period without a slow loop; position and speed are continuous."""
    bench.write(0, position=40_000)
    bench.follow(200)
    axis = bench.axis(0)
    omega, path = axis.path_limits.omega_n_ts, axis.motion.path
    bench.set_parameter("i_q_limit", 1.0)
    bench.slow()  # ends after the slow loop
    assert axis.limits.i_q == amps(1.0)
    assert (axis.path_limits.stale, axis.path_limits.omega_n_ts) == (True, omega)
    output, step = path.output, path.filter * omega / 65536
    core.lib.probe_run(bench.servo, 3)
    assert not axis.path_limits.stale
    assert axis.path_limits.omega_n_ts == pytest.approx(omega / 4.0, rel=1e-3)
    assert path.output == output
    assert path.filter * axis.path_limits.omega_n_ts / 65536 == pytest.approx(step, rel=1e-6)


def test_path_of_a_stopped_axis_is_retuned(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    omega = bench.axis(0).path_limits.omega_n_ts
    bench.set_parameter("i_q_limit", 1.0)
    bench.set_parameter("speed_limit", 100.0)  # lower than that of the configuration: nothing is gained by it
    bench.slow(2)
    assert bench.axis(0).path_limits.omega_n_ts == pytest.approx(omega / 4.0, rel=1e-3)


@pytest.mark.parametrize("features", [0, FEATURES.SPEED_FORWARD | FEATURES.FOLLOWING_ERROR])
def test_lowered_speed_limit_slows_a_move_as_gently_as_its_path(bench: Bench, features: int) -> None:
    bench.switch_on(0, features)
    bench.write(0, position=1_000_000)
    bench.follow(400)
    bench.set_parameter("speed_limit", 50.0)
    references = [rad_s(bench.view(0).speed_ref), *bench.trace(400, lambda: rad_s(bench.view(0).speed_ref))]
    steps = [a - b for a, b in itertools.pairwise(references)]
    available = 0.0462 * 4.0 / 0.8e-5  # k_t i / J of axis 1
    assert max(steps) <= 0.55 * available * TICK
    assert references[-1] == pytest.approx(50.0, rel=1e-2)
    assert bench.view(0).faults == 0


def test_new_limits_in_motion_cause_no_step(bench: Bench) -> None:
    """In a long move the shaped set-point continues at its speed at any current limit."""
    bench.write(0, position=1_000_000)
    bench.follow(400)
    for amperes in (1.0, 4.0, 0.5, 2.0):
        bench.set_parameter("i_q_limit", amperes)
        references = [reference for reference, _ in bench.follow(200)]
        steps = [b - a for a, b in itertools.pairwise(references)]
        assert min(steps) >= 96
        assert max(steps) <= 104  # 100 counts per tick are 314 rad/s


def test_position_is_held_against_a_displacement(bench: Bench) -> None:
    """Position and speed loop command a current against the displacement."""
    bench.shaft[0].move(40)
    bench.slow(20)
    assert bench.view(0).position == 40
    assert bench.view(0).position_ref == 0
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(-60.0 * 40 * 2 * 3.14159265 / 4000, rel=0.02)
    assert bench.view(0).i_q_ref < 0


@pytest.mark.parametrize("off", [1, -1])
def test_current_that_pushes_away_from_the_target_decays(bench: Bench, off: int) -> None:
    """Friction holds the shaft one count off its target: current towards the target stays, the opposite one decays."""
    held = 40 * 65536  # about the friction current

    def rest(integral: int) -> int:
        bench.axis(0).motion.speed_pi.integral = integral * 2**24
        bench.slow(400)
        return int(bench.view(0).i_q_ref)

    bench.write(0, position=bench.view(0).position)
    bench.turn(0, off * COUNT / TICK)
    bench.slow()
    bench.turn(0, 0.0)
    bench.slow(400)
    assert bench.view(0).position - bench.view(0).position_ref == off
    assert rest(-off * held) == -off * 40
    assert 0 >= rest(off * held) * off >= -10


# ---- speed ----------------------------------------------------------------------------------------------------------


def test_speed_is_ramped_at_the_acceleration_limit(bench: Bench) -> None:
    bench.set_parameter("acceleration_limit", 1000.0)
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    references = bench.trace(260, lambda: rad_s(bench.view(0).speed_ref), follow=False)
    steps = [b - a for a, b in itertools.pairwise(references)]
    assert max(steps) == pytest.approx(1000.0 * 0.5e-3, rel=1e-3)
    assert references[-1] == pytest.approx(100.0, rel=1e-6)
    assert references[150] == pytest.approx(151 * 0.5, rel=0.01)


def test_speed_set_point_is_limited_and_flagged(bench: Bench) -> None:
    bench.set_parameter("speed_limit", 100.0)
    bench.write(0, mode=MODE.SPEED, speed=speed(200.0))
    bench.slow(200)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(100.0, rel=1e-6)
    assert bench.view(0).limits & LIMITS.SPEED
    bench.write(0, speed=speed(50.0))
    bench.slow(200)
    assert not bench.view(0).limits & LIMITS.SPEED


def test_the_current_set_point_stays_within_its_limit(bench: Bench) -> None:
    bench.set_parameter("i_q_limit", 1.0)
    bench.write(0, mode=MODE.SPEED, speed=speed(200.0))
    bench.slow(100)  # the shaft does not move
    assert bench.view(0).i_q_ref == pytest.approx(amps(1.0), abs=1)
    assert bench.view(0).limits & LIMITS.CURRENT


def test_voltage_limit_is_flagged(bench: Bench) -> None:
    bench.write(0, mode=MODE.TORQUE, i_q=amps(3.0))
    bench.slow(50)  # no current flows on this bench: the loop commands the full voltage
    assert bench.view(0).limits & LIMITS.VOLTAGE
    assert bench.view(0).faults == 0, "a limit is not a fault"


@pytest.mark.parametrize("counts", [3, 20, -20])
def test_integral_part_sums_counts_and_not_an_old_speed(bench: Bench, counts: int) -> None:
    """The M/T method reports a speed after the shaft has stopped; the integral part equals the travelled counts."""
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.slow(2)
    bench.turn(0, math.copysign(COUNT / TICK, counts))
    bench.slow(abs(counts))
    bench.turn(0, 0.0)
    speeds = []
    for _ in range(200):  # until the timer of the edges overflows
        bench.slow()
        speeds.append(abs(rad_s(bench.view(0).speed)))
    assert sum(speeds) > 10.0, "the M/T method still reports a speed"
    assert speeds[-1] == 0.0
    integral = bench.axis(0).config.speed.ki / 2**24 * speed(counts * COUNT / TICK)
    assert bench.view(0).i_q_ref == pytest.approx(-integral / 2**16, abs=1.0)


@pytest.mark.parametrize("counts", [1, -1, 300, -300, 666, -666, 667, -667, 1900, -1900])
def test_counted_speed_saturates(bench: Bench, counts: int) -> None:
    """Counts of one slow tick relative to 666.67 at full speed; more is full speed."""
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.slow()
    bench.shaft[0].move(counts)
    bench.slow()
    expected = max(min(speed(counts * COUNT / TICK), 2**31 - 1), -(2**31))
    assert bench.axis(0).feedback.mean_speed == pytest.approx(expected, abs=2**31 * 2e-6)


# ---- torque ---------------------------------------------------------------------------------------------------------


def test_torque_mode_uses_the_commanded_current(bench: Bench) -> None:
    bench.write(0, mode=MODE.TORQUE, i_q=amps(-1.5))
    bench.slow(2)
    assert bench.view(0).i_q_ref == amps(-1.5)


def test_torque_mode_limits_the_current_and_flags_it(bench: Bench) -> None:
    bench.set_parameter("i_q_limit", 2.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(3.0))
    bench.slow(2)
    assert bench.view(0).i_q_ref == pytest.approx(amps(2.0), abs=1)
    assert bench.view(0).limits & LIMITS.CURRENT


@pytest.mark.parametrize("sign", [1, -1])
def test_torque_mode_keeps_the_speed_limit(bench: Bench, sign: int) -> None:
    bench.set_parameter("speed_limit", 100.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(sign * 2.0))
    bench.turn(0, sign * 120.0)
    bench.slow(50)
    assert bench.view(0).i_q_ref * sign < 0, "above the limit it brakes"
    assert bench.view(0).limits & LIMITS.SPEED
    bench.turn(0, sign * 50.0)
    bench.slow(50)
    assert bench.view(0).i_q_ref == amps(sign * 2.0)
    assert not bench.view(0).limits & LIMITS.SPEED


# ---- change of mode-------------------------------------------------------------------------------------------------


def test_change_of_mode_without_a_set_point_stops_the_axis(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(80.0))
    bench.follow(100)
    bench.write(0, mode=MODE.POSITION)
    log = bench.follow(400)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(0.0, abs=0.5)
    assert abs(log[-1][0] - log[-1][1]) <= 1
    bench.write(0, mode=MODE.TORQUE)
    bench.slow(3)
    assert bench.view(0).i_q_ref == 0
    bench.write(0, mode=MODE.SPEED)
    bench.slow(100)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(0.0, abs=0.5)


def test_change_to_position_mode_in_motion_is_bumpless(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(100.0))
    bench.follow(200)
    bench.write(0, mode=MODE.POSITION, position=bench.view(0).position + 20_000)
    references = bench.trace(40, lambda: rad_s(bench.view(0).speed_ref))
    assert references[0] == pytest.approx(100.0, abs=3.0)
    assert min(references) > 95.0
    assert max(abs(b - a) for a, b in itertools.pairwise(references)) < 8.0


def test_change_from_torque_to_speed_mode_is_bumpless(bench: Bench) -> None:
    bench.turn(0, 60.0)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(1.0))
    bench.slow(20)
    bench.write(0, mode=MODE.SPEED, speed=speed(60.0))
    bench.slow()
    assert bench.view(0).i_q_ref == pytest.approx(amps(1.0), abs=amps(0.15))


def test_set_point_of_another_mode_is_ignored(bench: Bench) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(30.0))
    bench.slow(50)
    bench.write(0, position=9999, i_q=amps(2.0))
    bench.slow(50)
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(30.0, rel=1e-6)
    assert bench.view(0).position_ref == bench.view(0).position


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stop_ends_if_the_shaft_reverses_between_two_ticks(bench: Bench, sign: int) -> None:
    bench.write(0, mode=MODE.SPEED, speed=speed(sign * 60.0))
    bench.follow(100)
    bench.write(0, quick_stop=1)
    bench.turn(0, sign * 8.0)
    bench.slow(2)
    bench.until(lambda: bench.axis(0).motion.speed_ramp == 0, 200)
    assert bench.axis(0).motion.motion == bench.core.lib.MOTION_STOP
    bench.turn(0, -sign * 8.0)
    here = bench.view(0).position
    bench.slow(2)
    assert bench.axis(0).motion.motion == bench.core.lib.MOTION_POSITION
    assert abs(bench.view(0).position_ref - here) <= 20, "it holds the position of the reversal"


# ---- wrap of the counts ---------------------------------------------------------------------------------------------


def move_counters(bench: Bench, counts: int) -> None:
    """Set the counters of axis 1, in speed mode, to a large position."""
    bench.write(0, mode=MODE.SPEED, speed=0)
    bench.slow(2)
    axis = bench.axis(0)
    axis.feedback.position = axis.encoder.position.whole = (
        axis.encoder.position.whole + counts + 2**31
    ) % 2**32 - 2**31


@pytest.mark.parametrize("features", [0, FEATURES.SPEED_FORWARD | FEATURES.FOLLOWING_ERROR])
@pytest.mark.parametrize("direction", [1, -1])
def test_position_is_held_at_the_wrap(bench: Bench, features: int, direction: int) -> None:
    bench.switch_on(0, features)
    move_counters(bench, direction * (2**31 - 1) - bench.view(0).position)
    bench.write(0, quick_stop=1)
    bench.slow(5)
    before = bench.view(0).position
    bench.turn(0, direction * 5.0)
    for _ in range(20):
        bench.slow()
        behind = rad_s(bench.view(0).speed_ref) * -direction
        assert 0.0 <= behind <= 0.2 * 20.0, "as at any other position"
    assert bench.view(0).position * before < 0, "it has wrapped"
    assert bench.view(0).faults == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_position_mode_begins_smoothly_before_the_wrap(bench: Bench, direction: int) -> None:
    """The lag extends across the wrap."""
    move_counters(bench, direction * (2**31 - 2000) - bench.view(0).position)
    bench.write(0, speed=speed(direction * 100.0))
    bench.follow(80)
    bench.write(0, mode=MODE.POSITION, position=direction * (2**29 - 2**31))
    references = bench.trace(10, lambda: direction * rad_s(bench.view(0).speed_ref))
    assert min(references) > 60.0, references
