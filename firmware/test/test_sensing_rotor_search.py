"""Initial rotor position by bisection (DRM 2.4.3, F15, F16) on a shaft with friction."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from shaft_model import SLOW, Shaft

PULL, REST, FOUND, FAILED = range(4)
FULL_CURRENT = 8.25  # A
DEGREE = math.pi / 180.0


class Result(NamedTuple):
    phase: int
    error: float  # electrical degrees between what was found and where the shaft is
    searches: int
    seconds: float
    currents: list[float]  # A, one per slow tick
    vectors: list[float]  # degrees, one per vector tried
    travel: int  # counts between the outermost positions


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


def search(core: Core, shaft: Shaft, axis: int = 0, patience: float = 3.0) -> Result:
    config = core.ffi.addressof(core.lib.probe_config().axis[axis].rotor_search)
    s: Any = core.ffi.new("rotor_search_t *")
    core.lib.rotor_search_start(s, shaft.counts)
    currents: list[float] = []
    vectors = [0.0]
    positions = [shaft.counts]
    while s.phase in (PULL, REST) and len(currents) < patience / SLOW:
        vector = core.lib.rotor_search_angle(s) * math.pi / 32768.0
        shaft.slow_tick(s.current / 2**31 * FULL_CURRENT, vector, shorted=s.phase == REST)
        positions.append(shaft.counts)
        before = s.searches
        core.lib.rotor_search_step(s, config, shaft.counts)
        currents.append(s.current / 2**31 * FULL_CURRENT)
        if s.searches != before:
            vectors.append(core.lib.rotor_search_angle(s) * 180.0 / 32768.0)
    found = core.lib.rotor_search_angle(s) * math.pi / 32768.0
    error = math.remainder(found - shaft.angle, 2.0 * math.pi) / DEGREE
    return Result(s.phase, error, s.searches, len(currents) * SLOW, currents, vectors, max(positions) - min(positions))


@pytest.mark.parametrize("degrees", range(-180, 180, 15))
@pytest.mark.parametrize("axis", [0, 1])
def test_from_every_15_degrees(core: Core, degrees: int, axis: int) -> None:
    """Found within 1.5 degrees, in eight searches and 1.2 s; two more vectors where the first one cannot move it."""
    shaft = (
        Shaft(degrees * DEGREE)
        if axis == 0
        else Shaft(degrees * DEGREE, inertia=1.2e-5, friction=1.5e-3, psi=0.0138, resistance=0.45)
    )
    result = search(core, shaft, axis)
    assert result.phase == FOUND
    assert abs(result.error) < 1.5
    aligned = degrees in (0, -180)
    assert result.searches <= (10 if aligned else 8)
    assert result.seconds < 1.2
    assert max(result.currents) <= 4.0 + 1e-3


def test_experiment_of_f16(core: Core) -> None:
    """From 30 degrees: theta_M goes 0, then back up between the bounds; eight searches, done within 1.2 s."""
    result = search(core, Shaft(30.0 * DEGREE))
    assert result.phase == FOUND
    assert result.vectors[0] == 0.0
    assert result.vectors[1] == pytest.approx(90.0, abs=6.0)
    assert result.vectors[2] == pytest.approx(45.0, abs=8.0)
    assert result.searches <= 8
    assert result.seconds <= 1.2


def test_shaft_hardly_moves(core: Core) -> None:
    """The windings are shorted as soon as something moves: a few degrees, not an alignment."""
    for degrees in range(-170, 180, 20):
        assert search(core, Shaft(degrees * DEGREE)).travel < 100, degrees  # 9 degrees mechanical


@pytest.mark.parametrize("degrees", [180.0, 179.8, -179.7, 179.0])
def test_opposite_rotor_is_not_taken_for_aligned(core: Core, degrees: float) -> None:
    """No torque at 180 degrees: the first vector moves nothing, the one at 90 degrees does."""
    result = search(core, Shaft(degrees * DEGREE))
    assert result.phase == FOUND
    assert abs(result.error) < 1.5


def test_rotor_on_the_first_vector(core: Core) -> None:
    result = search(core, Shaft(0.2 * DEGREE))
    assert result.phase == FOUND
    assert result.vectors[1] == pytest.approx(90.0, abs=1.0)
    assert abs(result.error) < 1.5


@pytest.mark.parametrize("degrees", [0.0, 30.0, 180.0])
def test_blocked_shaft_is_refused(core: Core, degrees: float) -> None:
    """Two vectors at right angles at full current, then FAILED: never an angle that was not seen to be true."""
    result = search(core, Shaft(degrees * DEGREE, locked=True))
    assert result.phase == FAILED
    assert result.searches == 2
    assert result.currents[-1] == 0.0
    assert max(result.currents) == pytest.approx(4.0, abs=1e-3)


@pytest.mark.parametrize("friction", [0.0, 0.5e-3, 2e-3, 8e-3, 20e-3])
@pytest.mark.parametrize("degrees", [-100.0, 30.0, 77.0, 150.0])
def test_friction(core: Core, friction: float, degrees: float) -> None:
    """The current grows until the shaft lets go; the angle left is where the friction holds it at full current."""
    result = search(core, Shaft(degrees * DEGREE, friction=friction))
    held = math.degrees(math.asin(min(1.0, friction / (0.0462 * 4.0))))
    assert result.phase == FOUND
    assert abs(result.error) < 1.5 + held


def test_heavy_load_takes_more_current(core: Core) -> None:
    light = search(core, Shaft(60.0 * DEGREE, friction=1e-3))
    heavy = search(core, Shaft(60.0 * DEGREE, friction=15e-3))
    assert max(heavy.currents[:200]) > 2.0 * max(light.currents[:50])


def test_current_starts_from_zero_at_every_vector(core: Core) -> None:
    currents = search(core, Shaft(30.0 * DEGREE)).currents
    rises = [b - a for a, b in itertools.pairwise(currents) if b > a]
    assert max(rises) <= 4.0 / 200.0 + 1e-3  # 0.1 s to 4 A


def test_position_may_start_anywhere(core: Core) -> None:
    """Only differences count, over the wrap of 32 bits too."""
    config = core.ffi.addressof(core.lib.probe_config().axis[0].rotor_search)
    for origin in (0, 123456, 2**31 - 2, -(2**31)):
        s = core.ffi.new("rotor_search_t *")
        core.lib.rotor_search_start(s, origin)
        core.lib.rotor_search_step(s, config, origin)
        moved = (origin + 3 + 2**31) % 2**32 - 2**31
        core.lib.rotor_search_step(s, config, moved)
        assert (s.phase, s.direction) == (REST, 1)
        for _ in range(config.rest_ticks):
            core.lib.rotor_search_step(s, config, moved)
        assert s.phase == PULL
        assert s.theta_h == pytest.approx(3 * 65536 * 2 / 4000, abs=1)  # the rotor was below the vector; it moved by 3


def test_rest_lasts_until_the_shaft_has_stood_still(core: Core) -> None:
    """Every movement starts the wait anew; only then does the whole movement shift the bounds."""
    config = core.ffi.addressof(core.lib.probe_config().axis[0].rotor_search)
    s = core.ffi.new("rotor_search_t *")
    core.lib.rotor_search_start(s, 0)
    for position in range(3, 3 + 5 * config.rest_ticks):
        core.lib.rotor_search_step(s, config, position)
        assert s.phase == REST
    for _ in range(config.rest_ticks - 1):
        core.lib.rotor_search_step(s, config, position)
        assert s.phase == REST
    core.lib.rotor_search_step(s, config, position)
    assert s.phase == PULL
    assert s.theta_h == pytest.approx(position * 65536 * 2 / 4000, abs=1)


def test_bounds_follow_the_shaft(core: Core) -> None:
    """Coordinate correction of F15: both bounds and the next vector shift by the movement."""
    config = core.ffi.addressof(core.lib.probe_config().axis[0].rotor_search)
    s = core.ffi.new("rotor_search_t *")
    core.lib.rotor_search_start(s, 0)
    core.lib.rotor_search_step(s, config, -50)  # pulled down from 0: the rotor was above
    for _ in range(config.rest_ticks + 1):
        core.lib.rotor_search_step(s, config, -100)
    shift = -100 * 65536 * 2 // 4000
    assert (s.theta_l, s.theta_h) == (pytest.approx(shift, abs=1), pytest.approx(32768 + shift, abs=1))
    assert s.theta_m == pytest.approx(16384 + shift, abs=1)
    assert s.phase == PULL
