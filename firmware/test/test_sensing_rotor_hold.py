"""Initial rotor position of a shaft with a holding brake, a load and friction."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import pytest
from core_library import Core
from shaft_model import SLOW, Shaft

FOUND, HELD, REVERSED, STARVED, HOLD = 5, 6, 8, 9, 10  # rotor_search_phase_t
FULL_CURRENT = 8.25  # A
SEARCH_CURRENT = 4.0  # A, servo.toml
K_T = (0.0462, 0.0414)  # N m/A
FIELDS = ("inertia", "friction", "psi", "resistance")
SHAFTS = ((0.8e-5, 2e-3, 0.0154, 0.55), (1.2e-5, 1.5e-3, 0.0138, 0.45))
OPEN_TIME = 0.03  # s, of the brake
FRICTION_ANGLE = (
    4.0  # electrical degrees: friction 2e-3 N m relative to 0.185 and 0.092 N m of both currents, and counts
)


class Result(NamedTuple):
    phase: int
    error: float  # error of the found angle [electrical degrees]
    seconds: float  # duration of the search [s]
    travel: float  # rad, largest distance from the position held by the brake
    across: float  # A, current found to hold the load


def search(core: Core, axis: int, degrees: float, load: float = 0.0, *, locked: bool = False, **changes: Any) -> Result:
    """Search until it ends; the brake opens with its delay when it is commanded."""
    config = core.lib.probe_config().axis[axis]
    data = dict(zip(FIELDS, SHAFTS[axis], strict=True))
    shaft = Shaft(math.radians(degrees), **(data | changes), load=load)
    s: Any = core.ffi.new("rotor_search_t *")
    reference = core.ffi.addressof(config.rotor_search)
    core.lib.rotor_hold_start(s, reference, shaft.counts, config.speed_observer.acceleration_per_current)
    asked, travel = None, 0.0
    for tick in range(4000):
        shaft.locked = locked or asked is None or tick - asked < OPEN_TIME / SLOW
        shaft.slow_tick(s.current / 2**31 * FULL_CURRENT, core.lib.rotor_search_angle(s) * math.pi / 32768.0, False)
        travel = max(travel, abs(shaft.moved))
        if core.lib.rotor_hold_opens_brake(s):
            asked = tick if asked is None else asked
            s.brake_released = tick - asked > 1.25 * OPEN_TIME / SLOW
        core.lib.rotor_hold_step(s, reference, shaft.counts)
        if s.phase != HOLD:
            break
    found = core.lib.rotor_search_angle(s) * math.pi / 32768.0
    error = math.degrees(math.remainder(found - shaft.angle, 2.0 * math.pi))
    return Result(s.phase, error, tick * SLOW, travel, s.current / 2**31 * FULL_CURRENT)


@pytest.mark.parametrize("part", [0.0, 0.1, -0.25, 0.4])
@pytest.mark.parametrize("axis", [0, 1])
def test_rotor_is_found_under_load_from_every_angle(core: Core, axis: int, part: float) -> None:
    """Loads relative to the torque of the search: error within the friction, and the load current is found."""
    load = part * K_T[axis] * SEARCH_CURRENT
    for degrees in range(-180, 180, 15):
        result = search(core, axis, degrees, load)
        assert result.phase == FOUND, degrees
        assert abs(result.error) < FRICTION_ANGLE, degrees
        assert result.seconds < 1.0
        assert result.travel < 0.5, degrees
        assert result.across == pytest.approx(load / K_T[axis], abs=0.12), degrees


@pytest.mark.parametrize("inertia", [0.5, 2.0, 3.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_rotor_is_found_with_another_inertia_than_nominal(core: Core, axis: int, inertia: float) -> None:
    for degrees in range(-170, 180, 20):
        result = search(core, axis, degrees, 0.02, inertia=inertia * SHAFTS[axis][0])
        assert result.phase == FOUND, degrees
        assert abs(result.error) < FRICTION_ANGLE, degrees


@pytest.mark.parametrize("friction", [0.1, 0.5, 4.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_rotor_is_found_with_another_friction_than_usual(core: Core, axis: int, friction: float) -> None:
    """The error is at most that of the friction at both currents."""
    torque = friction * SHAFTS[axis][1]
    maximum = FRICTION_ANGLE + 3.0 * math.degrees(torque / (K_T[axis] * SEARCH_CURRENT))
    for degrees in range(-170, 180, 20):
        result = search(core, axis, degrees, 0.02, friction=torque)
        assert result.phase == FOUND, degrees
        assert abs(result.error) < maximum, degrees


def test_a_load_beyond_half_the_torque_ends_the_search(core: Core) -> None:
    """The load drops by at most an eighth of an electrical revolution plus one tick."""
    for degrees in range(-180, 180, 30):
        result = search(core, 0, degrees, 0.11)
        assert result.phase == HELD, degrees


@pytest.mark.parametrize("degrees", [-100, 0, 80])
def test_a_shaft_that_the_brake_does_not_release_ends_in_held(core: Core, degrees: int) -> None:
    assert search(core, 0, degrees, locked=True).phase == HELD


def test_an_encoder_that_does_not_count_ends_in_held(core: Core) -> None:
    assert search(core, 0, 30.0, counted=False).phase == HELD


@pytest.mark.parametrize("load", [0.0, 0.03])
def test_a_reversed_encoder_ends_the_search(core: Core, load: float) -> None:
    for degrees in range(-180, 180, 30):
        assert search(core, 0, degrees, load, backwards=True).phase in (HELD, HOLD), degrees  # its time_max


def test_the_brake_opens_with_the_full_current(core: Core) -> None:
    config = core.lib.probe_config().axis[0]
    s: Any = core.ffi.new("rotor_search_t *")
    reference = core.ffi.addressof(config.rotor_search)
    core.lib.rotor_hold_start(s, reference, 7, config.speed_observer.acceleration_per_current)
    while not core.lib.rotor_hold_opens_brake(s):
        assert s.current < config.rotor_search.current_limit << 16
        core.lib.rotor_hold_step(s, reference, 7)
    assert s.current == config.rotor_search.current_limit << 16


def test_missing_current_ends_the_search(core: Core) -> None:
    config = core.lib.probe_config().axis[0]
    s: Any = core.ffi.new("rotor_search_t *")
    reference = core.ffi.addressof(config.rotor_search)
    core.lib.rotor_hold_start(s, reference, 0, config.speed_observer.acceleration_per_current)
    for _ in range(400):
        core.lib.rotor_hold_step(s, reference, 0)
        for _ in range(8):
            core.lib.rotor_search_add(s, reference, 0, 0)
    assert s.phase == STARVED
