"""Feed-forward against torque ripple on an axis: angle of the homed position, conditions, switching."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import pytest
from core_library import Core
from servo_bench import COUNT, FEATURES, FULL_SPEED, INPUTS, LIMITS, MODE, STATE, SUBSTATE, Bench, amps, speed

PER_TURN = 4000
FADE = 256  # slow ticks until the harmonics are in force
HERE = 1  # home_method_t
LEAD = 0.61e-3  # from the angle to the effect of the current [s]
AMPLITUDE = 0.5  # A


def with_harmonics(bench: Bench, harmonics: Sequence[tuple[int, float, float]]) -> None:
    """Configure harmonics of axis 1: order, amplitude [A], phase [turns]."""
    config = bench.core.ffi.new("axis_config_t *", bench.axis(0).config[0])
    ripple = config.torque_ripple
    ripple.lead = round(LEAD * FULL_SPEED / (2.0 * math.pi) * 2**31)  # turns at full speed
    for k, (order, amplitude, phase) in enumerate(harmonics):
        ripple.order[k], ripple.amplitude[k], ripple.phase[k] = order, amps(amplitude), round(phase * 65536) % 65536
    bench.references.append(config)
    bench.axis(0).config = config


def homed(core: Core, order: int = 1, phase: float = 0.25, features: int = 0) -> Bench:
    """Axis 1 spins at position 0 with one harmonic; at the phase of 0.25 turns its current is largest there."""
    bench = Bench(core)
    with_harmonics(bench, [(order, AMPLITUDE, phase)])
    bench.to_spin(0)
    bench.write(0, home=HERE, home_position=0)
    bench.slow(3)
    bench.switch_on(0, FEATURES.TORQUE_RIPPLE | features)
    bench.slow(FADE + 10)
    return bench


def forward(bench: Bench) -> float:
    """Feed-forward current [A]."""
    return float(bench.axis(0).ripple.current) / 2**31 * 8.25


def test_current_of_a_shaft_at_rest_follows_its_angle(core: Core) -> None:
    """In position hold, over more than a turn in both directions."""
    bench = homed(core)
    for counts in (0, 500, 500, 1500, 3000, -6000, -2000):
        bench.shaft[0].move(counts)
        bench.slow(3)
        position = bench.view(0).position
        assert forward(bench) == pytest.approx(AMPLITUDE * math.cos(position * COUNT), abs=2e-3)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_current_is_that_of_the_angle_at_which_it_acts(core: Core, direction: float) -> None:
    """At 20 rad/s and 12 periods per turn the lead is 8 degrees of a period."""
    bench = homed(core, order=12)
    bench.write(0, mode=MODE.SPEED, speed=speed(20.0 * direction))
    bench.trace(100, lambda: None)
    bench.turn(0, 20.0 * direction)
    for _ in range(50):
        bench.slow()
        angle = bench.view(0).position * COUNT + 20.0 * direction * LEAD  # the fake shaft moves once per slow tick
        assert forward(bench) == pytest.approx(AMPLITUDE * math.cos(12.0 * angle), abs=0.03)


def test_current_is_added_to_that_of_the_speed_controller(core: Core) -> None:
    bench, plain = homed(core), Bench(core)
    plain.to_spin(0)
    plain.slow(3)
    bench.slow()
    assert bench.view(0).i_q_ref - plain.view(0).i_q_ref == pytest.approx(amps(AMPLITUDE), abs=4)


def test_without_a_known_angle_there_is_no_current_and_a_limit(core: Core) -> None:
    bench = Bench(core)
    with_harmonics(bench, [(1, AMPLITUDE, 0.25)])
    bench.to_spin(0)
    bench.switch_on(0, FEATURES.TORQUE_RIPPLE)
    bench.slow(FADE)
    assert forward(bench) == 0.0
    assert bench.view(0).limits & LIMITS.ANGLE_UNKNOWN
    bench.write(0, home=HERE)
    bench.slow(FADE)
    assert abs(forward(bench)) > 0.9 * AMPLITUDE
    assert not bench.view(0).limits & LIMITS.ANGLE_UNKNOWN


def test_switching_is_gradual(core: Core) -> None:
    """Over 0.128 s in both directions, also in motion; afterwards nothing remains."""
    bench = homed(core)
    full = forward(bench)
    assert full == pytest.approx(AMPLITUDE, abs=2e-3)
    for features in (0, FEATURES.TORQUE_RIPPLE):
        bench.switch_on(0, features)
        values = [full if features == 0 else 0.0]
        for _ in range(FADE + 4):
            bench.slow()
            values.append(forward(bench))
        assert max(abs(b - a) for a, b in itertools.pairwise(values)) < 2.0 * AMPLITUDE / FADE
        assert values[-1] == pytest.approx(0.0 if features == 0 else AMPLITUDE, abs=2e-3)


@pytest.mark.parametrize("position", [-1, 2345, 4000 * 12345 - 7, -(2**29), 2**29 + 3999])
def test_angle_after_the_position_was_set(core: Core, position: int) -> None:
    """Positive remainder of the division by a turn."""
    bench = homed(core, phase=0.0)
    bench.write(0, home_position=position, home=HERE)
    bench.slow(FADE)
    here = bench.view(0).position
    assert abs(here - position) <= 2
    angle = here % PER_TURN * COUNT
    assert forward(bench) == pytest.approx(AMPLITUDE * math.sin(angle), abs=3e-3)


def test_angle_continues_where_the_position_wraps(core: Core) -> None:
    """2^32 is not a multiple of a turn."""
    bench = homed(core, phase=0.0)
    axis: Any = bench.axis(0)
    axis.encoder.position.whole = axis.feedback.position = 2**31 - 100
    bench.slow()
    before = forward(bench)
    bench.shaft[0].move(200)
    bench.slow(2)
    assert bench.view(0).position < 0
    start = math.asin(before / AMPLITUDE)
    moved = 200 * COUNT
    assert min(abs(forward(bench) / AMPLITUDE - math.sin(angle + moved)) for angle in (start, math.pi - start)) < 5e-3


def test_angle_is_followed_while_off(core: Core) -> None:
    """Turns over the wrap of the position; then on."""
    bench = homed(core)
    bench.switch_on(0, 0)
    bench.slow(FADE + 10)
    axis: Any = bench.axis(0)
    start = 2**31 - 100
    axis.encoder.position.whole = axis.feedback.position = start
    bench.slow()
    before = bench.shaft[0].shaft
    for rad_s in (200.0, 0.0):
        bench.write(0, mode=MODE.SPEED, speed=speed(rad_s))
        bench.follow(500)
    moved = bench.shaft[0].shaft - before
    assert moved > 3 * PER_TURN
    assert bench.view(0).position < 0
    bench.switch_on(0, FEATURES.TORQUE_RIPPLE)
    bench.slow(FADE + 10)
    assert bench.view(0).faults == 0
    assert forward(bench) == pytest.approx(AMPLITUDE * math.cos((start + moved) % PER_TURN * COUNT), abs=3e-3)


def i_q(bench: Bench) -> float:
    """Set-point of the current [A]."""
    return float(bench.view(0).i_q_ref) / amps(1.0)


def test_what_the_limit_leaves_is_applied(core: Core) -> None:
    """All, a part or nothing of the current; the oscillation monitor subtracts it."""
    bench = homed(core)
    axis: Any = bench.axis(0)
    axis.motion.speed_pi.integral = 0
    bench.slow()
    assert axis.ripple.applied == axis.ripple.current > 0
    bench.set_parameter("i_q_limit", 0.4 * AMPLITUDE)
    bench.write(0, mode=MODE.POSITION, position=bench.view(0).position)
    for start, part in ((0.0, 0.4), (1.0, 0.0), (-0.8, 0.6), (-1.0, 0.4), (-3.0, 0.0)):
        bench.slow(3)
        axis.motion.speed_pi.excess = 0
        axis.motion.speed_pi.integral = round(start * AMPLITUDE / 8.25 * 2**55)
        bench.slow()
        full = axis.ripple.current
        assert axis.ripple.applied == pytest.approx(part * full, abs=0.02 * full), start
    bench.write(0, mode=MODE.TORQUE, i_q=0)
    bench.slow(2)
    assert axis.ripple.applied == 0


def test_other_harmonics_fade_in_without_a_step(core: Core) -> None:
    """In motion; other members leave the feed-forward as it is."""
    bench = homed(core)
    axis: Any = bench.axis(0)
    for amplitude, phase in ((AMPLITUDE, 0.25), (AMPLITUDE, 0.75), (0.6 * AMPLITUDE, 0.25)):
        same = axis.config.torque_ripple.phase[0] == round(phase * 65536)
        before, current = i_q(bench), forward(bench)
        config = bench.core.ffi.new("axis_config_t *", axis.config[0])
        config.torque_ripple.amplitude[0] = amps(amplitude)
        config.torque_ripple.phase[0] = round(phase * 65536)
        bench.references.append(config)
        bench.core.lib.axis_take_config(bench.servo.axis, config)
        assert (forward(bench) == current) == same
        values = bench.trace(FADE + 4, lambda: i_q(bench))
        assert max(abs(b - a) for a, b in itertools.pairwise([before, *values])) < 0.02 * AMPLITUDE
        assert forward(bench) == pytest.approx(math.copysign(amplitude, 0.5 - phase), abs=2e-3)


def test_another_angle_fades_in_without_a_step(core: Core) -> None:
    """Homing to half a turn, and the start of a homing that makes the angle unknown."""
    bench = homed(core)
    before = i_q(bench)
    bench.write(0, home_position=PER_TURN // 2, home=HERE)
    values = [before, *bench.trace(FADE + 4, lambda: i_q(bench))]
    assert max(abs(b - a) for a, b in itertools.pairwise(values)) < 0.02 * AMPLITUDE
    assert forward(bench) == pytest.approx(-AMPLITUDE, abs=2e-3)
    bench.axis(0).home.state = 0
    values = [i_q(bench), *bench.trace(4, lambda: i_q(bench))]
    assert forward(bench) == 0.0
    assert max(abs(b - a) for a, b in itertools.pairwise(values)) < 0.02 * AMPLITUDE


def test_torque_mode_is_left_without_a_step(core: Core) -> None:
    """The speed controller starts with the current of the torque controller; then the feed-forward fades in."""
    bench = homed(core)
    bench.write(0, mode=MODE.TORQUE, i_q=amps(0.2))
    bench.slow(5)
    assert forward(bench) == 0.0
    assert i_q(bench) == pytest.approx(0.2, abs=1e-3)
    bench.write(0, mode=MODE.SPEED, speed=0)
    values = [0.2, *bench.trace(FADE + 4, lambda: i_q(bench))]
    assert max(abs(b - a) for a, b in itertools.pairwise(values)) < 0.02 * AMPLITUDE
    assert forward(bench) == pytest.approx(AMPLITUDE, abs=2e-3)


def test_the_load_on_a_holding_brake_is_adopted_without_a_step(core: Core) -> None:
    bench = homed(core)
    bench.configure_pins(INPUTS.BRAKE_OPEN, open_ticks=12, close_ticks=9)
    bench.write(0, enable=0)
    bench.until(lambda: bench.view(0).substate == SUBSTATE.READY or bench.view(0).state != STATE.RUN, 500)
    bench.slow(FADE)
    assert forward(bench) == 0.0
    bench.axis(0).aligned, bench.axis(0).brake.load = True, amps(0.8)
    bench.write(0, enable=1)
    bench.to_substate(0, SUBSTATE.SPIN)
    bench.slow()
    assert i_q(bench) == pytest.approx(0.8, abs=0.02)


def test_harmonics_without_the_feature_change_nothing(core: Core) -> None:
    """The outputs agree in every bit."""

    def outputs(harmonics: Sequence[tuple[int, float, float]]) -> list[tuple[int, int]]:
        bench = Bench(core)
        with_harmonics(bench, harmonics)
        bench.to_spin(0)
        bench.write(0, home=HERE)
        bench.slow(3)
        bench.write(0, position=3000)
        view = bench.view(0)
        return [(view.i_q_ref, view.u_q) for _ in range(100) if bench.follow(1)]

    assert outputs([(12, 0.6, 0.1)]) == outputs([])
