"""Homing: position set, found at a hard stop or a switch; motion limited until the position is known."""

from __future__ import annotations

import pytest
from core_library import Core
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from servo_bench import COUNT, MODE, STATE, SUBSTATE, Bench, amps, rad_s, speed
from servo_msgs_py.catalogue import Catalogue

CATALOGUE = Catalogue.load()
HOME_STATE, METHOD, RESULT = (CATALOGUE.enums[f"home_{name}_t"] for name in ("state", "method", "result"))
HOMING_FAULT = CATALOGUE.flag("faults", "HOMING").mask
NOT_HOMED = CATALOGUE.flag("limits", "NOT_HOMED").mask
HOMING = CATALOGUE.flag("features", "HOMING").mask
POSITION_LIMITS = CATALOGUE.flag("features", "POSITION_LIMITS").mask
INPUT_HOME, INPUT_LIMIT_MIN, INPUT_LIMIT_MAX, INPUT_BRAKE_OPEN = 1, 2, 4, 16


def request_homing(bench: Bench, method: str, value: int = 0, axis: int = 0) -> None:
    bench.write(axis, home_position=value, home=METHOD[method])


def result(bench: Bench, axis: int = 0) -> str:
    return next(name for name, number in RESULT.items() if number == bench.axis(axis).home.result)


def state(bench: Bench, axis: int = 0) -> str:
    return next(name for name, number in HOME_STATE.items() if number == bench.view(axis).home_state)


def reach(bench: Bench) -> int:
    return int(bench.axis(0).config.home.reach)


# ---- setting ---------------------------------------------------------------------------------------------------------


def test_position_is_unknown_after_reset(bench: Bench) -> None:
    assert state(bench) == "UNKNOWN"
    assert result(bench) == "NONE"


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(st.integers(-900_000_000, 900_000_000), min_size=1, max_size=3),
    turns=st.floats(-40.0, 40.0),
    held=st.booleans(),
    observed=st.booleans(),
)
def test_setting_the_position_causes_no_motion_and_is_kept(
    core: Core, values: list[int], turns: float, held: bool, observed: bool
) -> None:
    """In hold or with outputs off, and across the next rotor search; the encoder cross-check raises no fault."""
    bench = Bench(core)
    if observed:
        bench.switch_on(0, 1 << 10)
    bench.to_spin(0) if held else bench.to_stop()
    for value in values:
        before = bench.axis(0).motion.speed_pi.integral
        bench.slow(100)
        request_homing(bench, "HERE", value)
        bench.slow(2)
        assert result(bench) == "DONE"
        assert state(bench) == "KNOWN"
        assert bench.view(0).position == value
        assert bench.axis(0).encoder.position.whole == value
        if held:
            assert bench.view(0).position_ref == value
            assert bench.axis(0).motion.target == value
            assert bench.view(0).speed_ref == 0
            assert bench.axis(0).motion.speed_pi.integral == before
        assert bench.axis(1).feedback.position == 0
        assert bench.view(1).home_state == HOME_STATE["UNKNOWN"]
    bench.turn_without_current(0, turns)
    bench.slow(200)
    bench.turn(0, 0.0)
    bench.slow(200)
    moved = bench.shaft[0].shaft
    start = bench.view(0).position - values[-1]
    assert abs(start - turns * 200 * 0.5e-3 / COUNT) <= 2
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).state == STATE.STOP, 4000)
    bench.write(0, mode=MODE.POSITION, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    searched = bench.shaft[0].shaft - moved
    assert bench.view(0).position == values[-1] + start + searched
    assert bench.view(0).faults == 0
    assert state(bench) == "KNOWN"


def test_zero_is_refused_in_motion(bench: Bench) -> None:
    bench.slow(2)
    bench.write(0, position=3000)
    bench.follow(50)
    request_homing(bench, "HERE", 12345)
    log = bench.follow(600)
    assert result(bench) == "MOTION"
    assert state(bench) == "UNKNOWN"
    assert abs(log[-1][1] - 3000) <= 1, "the move continues to its target"
    request_homing(bench, "HERE", 12345)
    bench.slow(2)
    assert bench.view(0).position == 12345


def test_zero_is_refused_during_the_search(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    bench.write(0, enable=1)
    bench.to_substate(0, 2)
    request_homing(bench, "HERE", 5)
    bench.slow(2)
    assert result(bench) == "MOTION"


def test_assumed_position_does_not_replace_a_known_one(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    request_homing(bench, "ASSUME", 700)
    bench.slow(2)
    assert (state(bench), bench.view(0).position) == ("ASSUMED", 700)
    request_homing(bench, "ASSUME", 800)
    bench.slow(2)
    assert (state(bench), bench.view(0).position) == ("ASSUMED", 800)
    request_homing(bench, "HERE", 900)
    bench.slow(2)
    request_homing(bench, "ASSUME", 1000)
    bench.slow(2)
    assert (state(bench), result(bench), bench.view(0).position) == ("KNOWN", "KNOWN", 900)


def test_soft_limits_apply_to_the_new_positions(bench: Bench) -> None:
    bench.write_raw("param.position_min", [-1000, 0])
    bench.write_raw("param.position_max", [1000, 0])
    bench.switch_on(0, POSITION_LIMITS)
    request_homing(bench, "HERE", 900)
    bench.slow(3)
    bench.write(0, position=5000)
    log = bench.follow(500)
    assert abs(log[-1][1] - 1000) <= 1
    assert max(position for _, position in log) <= 1001


# ---- unknown positions with the feature ------------------------------------------------------------------------------


def test_far_set_point_causes_no_motion(core: Core) -> None:
    bench = Bench(core)
    bench.switch_on(0, HOMING)
    bench.to_spin(0)
    bench.slow(2)
    bench.write(0, position=reach(bench) + 1)
    log = bench.follow(200)
    assert {position for _, position in log} == {0}
    assert bench.view(0).limits & NOT_HOMED
    bench.write(0, position=reach(bench))
    log = bench.follow(1500)
    assert abs(log[-1][1] - reach(bench)) <= 1
    assert not bench.view(0).limits & NOT_HOMED


def test_far_set_point_is_accepted_without_the_feature(bench: Bench) -> None:
    bench.slow(2)
    bench.write(0, position=2 * reach(bench))
    log = bench.follow(1500)
    assert abs(log[-1][1] - 2 * reach(bench)) <= 1


@pytest.mark.parametrize("direction", [1, -1])
def test_speed_mode_stops_within_reach(core: Core, direction: int) -> None:
    """Limited to the reach from the enable position; soft limits do not apply to unknown positions."""
    bench = Bench(core)
    bench.switch_on(0, HOMING | POSITION_LIMITS)
    bench.write_raw("param.position_min", [-10, 0])
    bench.write_raw("param.position_max", [10, 0])
    bench.to_spin(0)
    bench.write(0, mode=MODE.SPEED, speed=speed(direction * 60.0))
    log = bench.follow(1500)
    assert max(abs(position) for _, position in log) <= reach(bench) + 1
    assert direction * log[-1][1] >= reach(bench) - 12
    assert bench.view(0).limits & NOT_HOMED
    request_homing(bench, "HERE", 0)
    bench.write(0, speed=0)
    bench.slow(40)


@pytest.mark.parametrize("method", ["HERE", "ASSUME"])
def test_known_positions_are_not_limited_by_the_reach(core: Core, method: str) -> None:
    bench = Bench(core)
    bench.switch_on(0, HOMING)
    bench.to_stop()
    request_homing(bench, method, 0)
    bench.slow(3)
    bench.to_spin(0)
    bench.slow(2)
    here = bench.view(0).position
    bench.write(0, position=here + 3 * reach(bench))
    log = bench.follow(2000)
    assert abs(log[-1][1] - here - 3 * reach(bench)) <= 1
    assert not bench.view(0).limits & NOT_HOMED


def test_sensorless_axes_have_no_position(core: Core) -> None:
    bench = Bench(core)
    bench.switch_on(0, HOMING)
    bench.set_parameter("feedback", 1)
    bench.to_stop()
    bench.slow(2)
    assert bench.axis(0).written_limits.position_max != reach(bench)
    request_homing(bench, "HERE", 0)
    bench.slow(2)
    assert result(bench) == "SENSORLESS"


def test_change_of_the_feedback_discards_the_position(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    request_homing(bench, "HERE", 77)
    bench.slow(2)
    bench.set_parameter("feedback", 1)
    bench.slow(3)
    assert state(bench) == "UNKNOWN"


def test_a_lost_count_discards_the_position(bench: Bench) -> None:
    request_homing(bench, "HERE", 77)
    bench.slow(2)
    bench.axis(0).latch.captured = 1 << 5
    bench.slow(2)
    assert state(bench) == "UNKNOWN"


# ---- switches --------------------------------------------------------------------------------------------------------


def seek(bench: Bench, edge: int, direction: int, ticks: int = 8000) -> list[float]:
    """Run an ideal shaft with a switch that is active from `edge` on in a direction; return the speed set-points."""
    speeds = []
    for _ in range(ticks):
        bench.turn(0, rad_s(bench.view(0).speed_ref))
        at = bench.shaft[0].shaft
        bench.hal.axis[0].inputs = INPUT_HOME if direction * (at - edge) >= 0 else 0
        bench.slow()
        speeds.append(rad_s(bench.view(0).speed_ref))
        if state(bench) != "HOMING" and len(speeds) > 5:
            break
    return speeds


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(direction=st.sampled_from([1, -1]), ahead=st.integers(-300, 3000), value=st.integers(-800_000, 800_000))
def test_edge_of_a_switch_sets_the_position(core: Core, direction: int, ahead: int, value: int) -> None:
    """Started before or on the switch: edge within the travel of a slow tick; the shaft then rests off the switch."""
    bench = Bench(core)
    bench.servo.parameter.faults_enabled = [0, 0]
    bench.configure_pins(INPUT_HOME)
    bench.to_spin(0)
    edge = bench.shaft[0].shaft + direction * ahead
    bench.hal.axis[0].inputs = INPUT_HOME if ahead <= 0 else 0
    bench.slow(3)
    request_homing(bench, "SWITCH_POSITIVE" if direction > 0 else "SWITCH_NEGATIVE", value)
    speeds = seek(bench, edge, direction)
    assert (state(bench), result(bench)) == ("KNOWN", "DONE")
    bench.turn(0, 0.0)
    bench.slow(5)
    off = bench.view(0).position - value - (bench.shaft[0].shaft - edge)
    assert abs(off) <= 1
    assert max(abs(v) for v in speeds) <= 5.01
    assert direction * (bench.shaft[0].shaft - edge) <= -bench.axis(0).config.home.back_off + 10
    assert bench.axis(0).home.spread <= 1


@pytest.mark.parametrize("method", ["STOP_POSITIVE", "SWITCH_POSITIVE", "STOP_NEGATIVE", "SWITCH_NEGATIVE"])
def test_an_active_limit_switch_ends_the_homing(bench: Bench, method: str) -> None:
    """No torque towards a limit switch that is already active."""
    positive = method.endswith("POSITIVE")
    bench.servo.parameter.faults_enabled = [0, 0]
    bench.configure_pins(INPUT_LIMIT_MIN | INPUT_LIMIT_MAX)
    bench.hal.axis[0].inputs = INPUT_LIMIT_MAX if positive else INPUT_LIMIT_MIN
    bench.slow(3)
    request_homing(bench, method)
    pushed = bench.trace(400, lambda: bench.view(0).i_q_ref if positive else -bench.view(0).i_q_ref, follow=False)
    assert (state(bench), result(bench)) == ("UNKNOWN", "BLOCKED")
    assert max(pushed) < amps(0.2)


def test_homing_is_refused_while_the_brake_opens(core: Core) -> None:
    """A closed brake would look like a hard stop; the result is that of this request."""
    bench = Bench(core)
    bench.configure_pins(INPUT_BRAKE_OPEN, open_ticks=12, close_ticks=9)
    bench.to_stop()
    bench.axis(0).aligned = True
    bench.write(0, enable=1)
    bench.until(lambda: bench.hal.axis[0].holding_released, 100)
    request_homing(bench, "STOP_POSITIVE")
    bench.slow(3)
    assert result(bench) == "MOTION"
    assert (state(bench), bench.view(0).faults) == ("UNKNOWN", 0)


def test_homing_is_refused_while_a_quick_stop_holds(bench: Bench) -> None:
    bench.write(0, quick_stop=1)
    bench.slow(20)
    request_homing(bench, "STOP_POSITIVE")
    bench.slow(20)
    assert result(bench) == "MOTION"
    assert bench.view(0).faults == 0


def test_missing_switch_is_a_fault(bench: Bench) -> None:
    bench.servo.parameter.faults_enabled = [0, 0]
    bench.axis(0).home.timeout = 0
    request_homing(bench, "SWITCH_POSITIVE")
    limit = bench.axis(0).config.home.turns_max * 4000
    for _ in range(200_000):
        bench.turn(0, min(rad_s(bench.view(0).speed_ref) * 20, 60.0))
        bench.slow()
        if state(bench) != "HOMING" and bench.ticks > 2000:
            break
        bench.write(0, enable=1)
    assert result(bench) == "NOT_FOUND"
    assert bench.view(0).faults & HOMING_FAULT
    assert state(bench) == "UNKNOWN"
    assert limit <= abs(bench.view(0).position) <= limit + 300


# ---- the end of a homing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [{"position": 50}, {"mode": MODE.SPEED, "speed": 0}, {"quick_stop": 1}, {"enable": 0}, {"home": 0}, {"mode": 1}],
    ids=str,
)
def test_every_command_ends_a_homing(bench: Bench, command: dict[str, int]) -> None:
    request_homing(bench, "HERE", 0)
    bench.slow(3)
    request_homing(bench, "STOP_POSITIVE")
    bench.follow(100)
    assert state(bench) == "HOMING"
    assert rad_s(bench.view(0).speed_ref) == pytest.approx(5.0, rel=0.01)
    assert bench.axis(0).limits.i_q == bench.axis(0).config.home.current
    bench.write(0, **command)
    bench.follow(400)
    assert (state(bench), result(bench)) == ("UNKNOWN", "ABORTED")
    assert abs(rad_s(bench.view(0).speed_ref)) < 2.0, "it stops normally"
    assert bench.view(0).faults == 0
    assert bench.axis(0).limits.i_q == amps(4.0)


def test_homing_of_one_axis_does_not_affect_the_other(core: Core) -> None:
    bench = Bench(core)
    bench.to_spin(0, 1)
    request_homing(bench, "STOP_POSITIVE")
    bench.follow(20)
    bench.write(1, position=500)
    bench.follow(20)
    assert state(bench) == "HOMING"
    assert state(bench, 1) == "UNKNOWN"


def test_homing_is_refused_without_an_enabled_drive(core: Core) -> None:
    bench = Bench(core)
    bench.to_stop()
    request_homing(bench, "STOP_POSITIVE")
    bench.slow(3)
    assert result(bench) == "MOTION"
    assert bench.view(0).state == STATE.STOP


def test_host_time_out_ends_a_homing(bench: Bench) -> None:
    bench.keep_alive()
    request_homing(bench, "STOP_POSITIVE")
    bench.follow(1200)
    assert (state(bench), result(bench)) == ("UNKNOWN", "ABORTED")
    assert bench.view(0).faults == 1 << 6
    assert bench.view(0).state != STATE.RUN or abs(rad_s(bench.view(0).speed_ref)) < 5.0
