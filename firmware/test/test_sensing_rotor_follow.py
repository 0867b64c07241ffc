"""Detection of a rotor that follows a rotating vector by the flux linkage across it, without the encoder."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from core_library import Core
from hypothesis import given
from hypothesis import strategies as st

FULL_VOLTAGE = 24.2  # V
PERIOD = 62.5e-6  # s
PERIODS = 8  # per slow tick
FRAC16 = st.integers(-32768, 32767)
PSI, INDUCTANCE, CURRENT = (0.0154, 0.0138), (0.4575e-3, 0.402e-3), 4.0  # values of the two axes in servo.toml


def config_of(core: Core, axis: int = 0) -> Any:
    return core.ffi.addressof(core.lib.probe_config().axis[axis].rotor_search.follow)


def started(core: Core, theta: int = 0) -> Any:
    follow = core.ffi.new("rotor_follow_t *")
    core.lib.rotor_follow_start(follow, theta)
    return follow


def raw(volts: float) -> int:
    return max(-32768, min(32767, round(volts / FULL_VOLTAGE * 32768)))


def turn(
    core: Core, axis: int, follows: float, offset: float = 0.0, noise: float = 0.0, inductance: float = 1.0
) -> Any:
    """A full rotation in both directions; the rotor follows by the fraction `follows` [V offset and noise]."""
    config, follow, draw = config_of(core, axis), started(core), random.Random(axis)
    done = False
    while not done:
        way = 1.0 if follow.tick < config.ticks else -1.0
        omega = way * config.step * 2.0 * math.pi / 65536 / (PERIODS * PERIOD)
        for _ in range(PERIODS):
            volts = omega * (inductance * INDUCTANCE[axis] * CURRENT + follows * PSI[axis])
            core.lib.rotor_follow_add(follow, config, raw(volts + offset + draw.gauss(0.0, noise)))
        done = core.lib.rotor_follow_step(follow, config)
    return follow


@pytest.mark.parametrize("axis", [0, 1])
def test_constants_are_those_of_the_motor(core: Core, axis: int) -> None:
    """120 degrees in 0.1 s; threshold 0.3 of the flux change of a following rotor."""
    config = config_of(core, axis)
    angle = config.step * config.ticks / 65536 * 360
    assert config.ticks * PERIODS * PERIOD == pytest.approx(0.1)
    assert angle == pytest.approx(120.0, rel=0.01)
    minimum = 0.3 * PSI[axis] * math.radians(120.0) / FULL_VOLTAGE * 32768 / PERIOD
    assert config.flux_min == pytest.approx(minimum, abs=1)
    omega = math.radians(120.0) / 0.1
    assert config.inductive == pytest.approx(omega * INDUCTANCE[axis] * CURRENT / FULL_VOLTAGE * 32768, abs=1)


@pytest.mark.parametrize("axis", [0, 1])
def test_vector_rotates_in_both_directions(core: Core, axis: int) -> None:
    config = config_of(core, axis)
    for theta in (0, 20000, 32767, -32768):
        follow = started(core, theta)
        angles = []
        while not core.lib.rotor_follow_step(follow, config):
            angles.append((follow.theta - theta) % 65536)
        assert len(angles) == 2 * config.ticks - 1
        assert max(angles) == angles[config.ticks - 1] == config.step * config.ticks
        assert follow.theta == theta


@pytest.mark.parametrize("axis", [0, 1])
def test_a_blocked_rotor_is_distinguished_from_a_following_one(core: Core, axis: int) -> None:
    config = config_of(core, axis)
    assert not core.lib.rotor_follow_seen(turn(core, axis, 0.0), config)
    assert core.lib.rotor_follow_seen(turn(core, axis, 1.0), config)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_error_of_a_fifth_of_the_flux_does_not_change_the_result(core: Core, axis: int, sign: float) -> None:
    """Errors by offset, inductance or noise of up to 0.2 of the flux do not matter; 0.6 of it is sufficient."""
    config = config_of(core, axis)
    flux = PSI[axis] * math.radians(120.0)
    offset = sign * 0.2 * flux / (2 * config.ticks * PERIODS * PERIOD)  # increases in both directions
    wrong_inductance = 1.0 + sign * 0.2 * PSI[axis] / (INDUCTANCE[axis] * CURRENT)
    assert not core.lib.rotor_follow_seen(turn(core, axis, 0.0, offset=offset, noise=0.2), config)
    assert not core.lib.rotor_follow_seen(turn(core, axis, 0.0, inductance=wrong_inductance), config)
    assert core.lib.rotor_follow_seen(turn(core, axis, 0.6, offset=0.0, noise=0.2), config)
    assert core.lib.rotor_follow_seen(turn(core, axis, 1.0, offset=offset), config)


def test_inductive_voltage_is_subtracted(core: Core) -> None:
    """The inductive voltage leaves less than 2 % of the flux change of a following rotor."""
    follow = turn(core, 0, 0.0)
    assert follow.high - follow.low < config_of(core).flux_min / 15


@given(st.lists(st.tuples(FRAC16, st.booleans()), max_size=120))
def test_sum_and_extremes_are_exact(core: Core, periods: list[tuple[int, bool]]) -> None:
    config, follow = config_of(core), started(core)
    total = low = high = 0
    for voltage, tick in periods:
        sign = 1 if follow.tick < config.ticks else -1
        core.lib.rotor_follow_add(follow, config, voltage)
        total += voltage - sign * config.inductive
        low, high = min(low, total), max(high, total)
        assert (follow.flux, follow.low, follow.high) == (total, low, high)
        if tick:
            core.lib.rotor_follow_step(follow, config)
    assert core.lib.rotor_follow_seen(follow, config) == (high - low >= config.flux_min)


@pytest.mark.parametrize("voltage", [-32768, 32767])
def test_extremes_of_the_flux_saturate_at_32_bits(core: Core, voltage: int) -> None:
    """Longer than any rotation: the sum stays within 32 bits, and the span is compared with more bits."""
    config, follow = config_of(core), started(core)
    for extreme in (voltage, -1 - voltage):
        for _ in range(70000):
            core.lib.rotor_follow_add(follow, config, extreme)
    bound = 2**31 - 1 if voltage > 0 else -(2**31)
    assert (follow.high if voltage > 0 else follow.low) == bound
    assert core.lib.rotor_follow_seen(follow, config)
    follow.low, follow.high = -(2**31), 2**31 - 1
    assert core.lib.rotor_follow_seen(follow, config)
