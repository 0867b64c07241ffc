"""Initial rotor position by bisection (DRM 2.4.3, F15, F16) on a shaft with friction."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from core_library import Core
from hypothesis import given
from hypothesis import strategies as st
from servo_tuning.rotor_search import GROWTH_MAX, LOW_CURRENT, LOW_CURRENT_PERIODS
from shaft_model import SLOW, Shaft

PULL, BRAKE, REST, VERIFY, TURN, FOUND, HELD, BLIND, REVERSED, STARVED, HOLD, DIRECTION = range(12)
COUNT = 2.0 * math.pi / 4000  # mechanical [rad]
FULL_CURRENT, FULL_VOLTAGE = 8.25, 24.2  # A, V
INDUCTANCE = 0.4575e-3  # H
DEGREE = math.pi / 180.0
PERIODS = 8  # PWM periods per slow tick


class Result(NamedTuple):
    phase: int
    error: float  # error of the found angle [electrical degrees]
    searches: int
    seconds: float  # duration of the search [s]
    currents: list[float]  # A, one per slow tick
    vectors: list[float]  # degrees, one per vector
    travel: int  # counts between the outermost positions
    twitch: int  # counts, the longest movement of one vector until the shaft rests


def axis_shaft(axis: int, degrees: float, **changes: Any) -> Shaft:
    """Shaft with the nominal values of an axis."""
    data: dict[str, Any] = {"inertia": 0.8e-5, "friction": 2e-3, "psi": 0.0154, "resistance": 0.55}
    if axis == 1:
        data = {"inertia": 1.2e-5, "friction": 1.5e-3, "psi": 0.0138, "resistance": 0.45}
    return Shaft(degrees * DEGREE, **(data | changes))


def search(
    core: Core, shaft: Shaft, axis: int = 0, timeout: float = 5.0, each_tick: Callable[[Any], None] | None = None
) -> Result:
    """Search until it ends; `each_tick` may change the shaft during the search."""
    config = core.ffi.addressof(core.lib.probe_config().axis[axis].rotor_search)
    s: Any = core.ffi.new("rotor_search_t *")
    core.lib.rotor_search_start(s, shaft.counts)
    currents: list[float] = []
    vectors = [0.0]
    positions = [shaft.counts]
    twitches = [0]
    before = 0.0
    while (s.phase < FOUND or s.phase == DIRECTION) and len(currents) < timeout / SLOW:
        driven = core.lib.rotor_search_drives(s)
        assert driven or s.phase == REST
        assert driven or s.current == 0
        vector = core.lib.rotor_search_angle(s) * math.pi / 32768.0
        current = s.current / 2**31 * FULL_CURRENT
        shaft.slow_tick(current, vector, shorted=not driven)
        positions.append(shaft.counts)
        if driven:
            turned = math.remainder(vector - before, 2.0 * math.pi) if s.phase == TURN else 0.0
            across = shaft.emf_across(vector) + turned / SLOW * INDUCTANCE * current
            measured, voltage = s.current >> 16, round(across / FULL_VOLTAGE * 32768)
            for _ in range(PERIODS):
                core.lib.rotor_search_add(s, config, measured, voltage)
        before = vector
        searches = s.searches
        if s.phase not in (VERIFY, TURN, DIRECTION):
            twitches[-1] = max(twitches[-1], abs(shaft.counts - s.origin))
        core.lib.rotor_search_step(s, config, shaft.counts)
        currents.append(current)
        if s.searches != searches:
            vectors.append(core.lib.rotor_search_angle(s) * 180.0 / 32768.0)
            twitches.append(0)
        if each_tick is not None:
            each_tick(s)
    found = core.lib.rotor_search_angle(s) * math.pi / 32768.0
    error = math.remainder(found - shaft.angle, 2.0 * math.pi) / DEGREE
    travel = max(positions) - min(positions)
    return Result(s.phase, error, s.searches, len(currents) * SLOW, currents, vectors, travel, max(twitches))


class Stepped:
    """A search without a shaft model, with the configuration of the first axis."""

    def __init__(self, core: Core, origin: int = 0) -> None:
        self.lib = core.lib
        self.config: Any = core.ffi.new("rotor_search_config_t *", core.lib.probe_config().axis[0].rotor_search)
        self.state: Any = core.ffi.new("rotor_search_t *")
        self.lib.rotor_search_start(self.state, origin)

    def step(self, *positions: int) -> None:
        for position in positions:
            self.lib.rotor_search_step(self.state, self.config, position)

    def until(self, phase: int, position: int = 0, maximum: int = 500) -> None:
        """At most `ticks` slow ticks at one position, until a phase."""
        for _ in range(maximum):
            if self.state.phase == phase:
                return
            self.step(position)
        assert self.state.phase == phase

    def to_verification(self) -> None:
        """Assume the rotor at theta_M, 0, with the shaft at 0."""
        self.state.reach = 128
        self.until(VERIFY)

    def to_full_current(self, position: int = 0) -> None:
        while self.state.current < self.config.current_limit << 16:
            self.step(position)

    def ticks(self, positions: Callable[[int], int]) -> int:
        """Duration of the phase [slow ticks]."""
        phase = self.state.phase
        for tick in range(100_000):
            if self.state.phase != phase:
                return tick
            self.step(positions(tick))
        return -1


@pytest.fixture
def stepped(core: Core) -> Stepped:
    return Stepped(core)


@pytest.mark.parametrize("degrees", range(-180, 180, 15))
@pytest.mark.parametrize("axis", [0, 1])
def test_rotor_is_found_from_every_15_degrees(core: Core, degrees: int, axis: int) -> None:
    """Found within half a degree and 0.6 s, in eight searches at most."""
    result = search(core, axis_shaft(axis, degrees), axis)
    assert result.phase == FOUND
    assert abs(result.error) < 0.5
    assert result.searches <= 8
    assert result.seconds < 0.6
    assert max(map(abs, result.currents)) <= 4.0 + 1e-3


def test_vectors_of_f16_are_reproduced(core: Core) -> None:
    """From 30 degrees: theta_M is 0, then increases between the bounds; eight searches within 1.2 s."""
    result = search(core, Shaft(30.0 * DEGREE))
    assert result.phase == FOUND
    assert result.vectors[0] == 0.0
    assert result.vectors[1] == pytest.approx(90.0, abs=6.0)
    assert result.vectors[2] == pytest.approx(45.0, abs=8.0)
    assert result.searches <= 8
    assert result.seconds <= 1.2


@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("inertia", [0.3, 1.0, 10.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_movement_of_the_search_is_small(core: Core, axis: int, inertia: float, friction: float) -> None:
    """A movement takes the counts of its detection, as many for braking, and those of one or two slow ticks,
    at any inertia and without friction."""
    seen = core.lib.probe_config().axis[axis].rotor_search.move_counts
    for degrees in range(-170, 180, 20):
        nominal = axis_shaft(axis, degrees)
        shaft = axis_shaft(
            axis, degrees, inertia=inertia * nominal.inertia, friction=friction * nominal.friction, resistance=20.0
        )
        result = search(core, shaft, axis)
        assert result.phase == FOUND
        assert abs(result.error) < 1.0, degrees
        assert result.twitch <= 2 * (seen + 2), degrees
        assert result.travel <= result.searches * 2 * (seen + 2), degrees


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 180.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_blocked_shaft_ends_in_held(core: Core, axis: int, degrees: float) -> None:
    """Full current in three directions and a rotation of the vector: HELD; an unverified angle is never accepted."""
    result = search(core, axis_shaft(axis, degrees, locked=True), axis)
    assert result.phase == HELD
    assert result.searches == 3
    assert result.seconds < 1.0
    assert max(result.currents) == pytest.approx(4.0, abs=1e-3)


@pytest.mark.parametrize("friction", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("inertia", [1.0, 3.0])
@pytest.mark.parametrize("degrees", range(-165, 180, 30))
@pytest.mark.parametrize("axis", [0, 1])
def test_dead_encoder_is_distinguished_from_a_blocked_shaft(
    core: Core, axis: int, degrees: int, inertia: float, friction: float
) -> None:
    nominal = axis_shaft(axis, degrees)
    shaft = axis_shaft(
        axis, degrees, counted=False, inertia=inertia * nominal.inertia, friction=friction * nominal.friction
    )
    result = search(core, shaft, axis)
    assert result.phase == BLIND
    assert result.seconds < 1.0


@pytest.mark.parametrize("twitches", range(1, 5))
def test_shaft_blocked_during_the_search_ends_in_held(core: Core, twitches: int) -> None:
    """A shaft without movement is not accepted as a rotor on the vector."""
    shaft = Shaft(-101.0 * DEGREE)

    def block(s: Any) -> None:
        shaft.locked = s.searches > twitches

    assert search(core, shaft, each_tick=block).phase == HELD


@pytest.mark.parametrize("twitches", range(1, 5))
def test_encoder_failed_during_the_search_is_detected(core: Core, twitches: int) -> None:
    shaft = Shaft(-101.0 * DEGREE)

    def die(s: Any) -> None:
        shaft.counted = s.searches <= twitches

    assert search(core, shaft, each_tick=die).phase == BLIND


@pytest.mark.parametrize("vector", [1, 2, 3])
def test_shaft_released_during_the_search_is_found(core: Core, vector: int) -> None:
    """Blocked for one vector only, at 0, beside it, or during the rotation of the vector: the angle is still found."""
    shaft = Shaft(50.0 * DEGREE)

    def hold(s: Any) -> None:
        shaft.locked = s.phase != TURN if vector == 3 else s.searches == vector
        if vector == 3 and s.searches > 3:
            shaft.locked = False

    result = search(core, shaft, each_tick=hold)
    assert result.phase == FOUND
    assert abs(result.error) < 1.5


@pytest.mark.parametrize("stop", [-1.0, 1.0])
@pytest.mark.parametrize("degrees", range(-175, 180, 10))
def test_rotor_at_an_end_stop_is_found(core: Core, degrees: int, stop: float) -> None:
    """The shaft can only move away from the stop: the angle is found without error."""
    low, high = (0.0, math.inf) if stop < 0.0 else (-math.inf, 0.0)
    result = search(core, Shaft(degrees * DEGREE, stops=(low, high)))
    assert result.phase == FOUND
    assert abs(result.error) < 1.5


@pytest.mark.parametrize("inertia", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("stop", [-3.0, -1.4, -0.6, 0.6, 1.4, 3.0])
def test_rotor_close_to_an_end_stop_is_found(core: Core, stop: float, inertia: float) -> None:
    """One vector moves the shaft off the stop, the next one back: no movement there is no aligned rotor."""
    low, high = (stop * COUNT, math.inf) if stop < 0.0 else (-math.inf, stop * COUNT)
    for degrees in range(-172, 180, 15):
        result = search(core, Shaft(degrees * DEGREE, stops=(low, high), inertia=inertia * 0.8e-5))
        assert result.phase == FOUND, degrees
        assert abs(result.error) < 0.7, degrees


@pytest.mark.parametrize("friction", [0.1, 1.0, 3.0])
@pytest.mark.parametrize(("below", "above"), [(3.6, 0.5), (0.5, 3.6), (2.0, 2.0), (0.5, 0.5)])
def test_obstructed_shaft_with_play_is_found_or_held(core: Core, below: float, above: float, friction: float) -> None:
    """The shaft moves between the stops only: the result is the true angle or HELD."""
    phases = []
    for degrees in range(-172, 180, 15):
        shaft = Shaft(degrees * DEGREE, stops=(-below * COUNT, above * COUNT), friction=friction * 2e-3)
        result = search(core, shaft)
        phases.append(result.phase)
        assert result.phase == HELD or (result.phase == FOUND and abs(result.error) < 0.7), degrees
        assert result.seconds < 3.0
    assert HELD in phases


@pytest.mark.parametrize("friction", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("inertia", [0.3, 1.0, 10.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_encoder_that_counts_backwards_is_detected(core: Core, axis: int, inertia: float, friction: float) -> None:
    """Every movement agrees with a rotor at the opposite angle, which is not a stable position."""
    for degrees in range(-165, 180, 30):
        nominal = axis_shaft(axis, degrees)
        shaft = axis_shaft(
            axis, degrees, backwards=True, inertia=inertia * nominal.inertia, friction=friction * nominal.friction
        )
        result = search(core, shaft, axis)
        assert result.phase == REVERSED, degrees
        assert result.seconds < 2.6


@pytest.mark.parametrize("phase", [PULL, BRAKE, REST, VERIFY, DIRECTION])
def test_end_of_the_time_leaves_time_for_the_direction(core: Core, phase: int) -> None:
    """In every phase, if the shaft has run away; before there is nothing to test."""
    shaft = axis_shaft(1, 65.0, backwards=True)
    ticks: list[int] = []  # phases from the end of the time on

    def time_out(s: Any) -> None:
        if s.runaways == 0:
            assert not core.lib.rotor_search_tests_direction(s, shaft.counts)
            assert s.phase != DIRECTION
        elif ticks or s.phase == phase:
            ticks.append(s.phase)
            if s.phase != REVERSED:
                assert core.lib.rotor_search_tests_direction(s, shaft.counts)

    assert search(core, shaft, axis=1, each_tick=time_out).phase == REVERSED
    assert ticks[0] == phase
    assert set(ticks[1:-1]) == {DIRECTION}
    assert len(ticks) * SLOW < 0.9


@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0])
@pytest.mark.parametrize("inertia", [0.3, 3.0, 30.0])
def test_encoder_that_counts_right_is_not_called_reversed(core: Core, inertia: float, friction: float) -> None:
    """Also if the shaft swings longer than the search waits, or was turned during the bisection."""
    for degrees in range(-165, 180, 30):
        shaft = axis_shaft(0, degrees, inertia=inertia * 0.8e-5, friction=friction * 2e-3)

        def disturb(s: Any, shaft: Shaft = shaft) -> None:
            if s.phase == VERIFY and s.current == 0 and s.runaways < 2:
                s.theta_m = s.vector = (s.theta_m + 32768 + 28000) % 65536 - 32768  # 154 degrees off

        assert search(core, shaft, each_tick=disturb).phase not in (REVERSED, BLIND), degrees
        shaft = axis_shaft(0, degrees, inertia=inertia * 0.8e-5, friction=friction * 2e-3)
        assert search(core, shaft).phase not in (REVERSED, BLIND), degrees


def test_missing_current_ends_in_starved(stepped: Stepped) -> None:
    """An unplugged motor: STARVED without current, long before the encoder could be suspected."""
    s, config = stepped.state, stepped.config
    ticks = 0
    while s.phase == PULL:
        for _ in range(PERIODS):
            stepped.lib.rotor_search_add(s, config, s.current >> 19, 0)  # an eighth of the set-point
        stepped.step(0)
        ticks += 1
    assert (s.phase, s.current) == (STARVED, 0)
    assert ticks * SLOW == pytest.approx(0.025 + 0.004, abs=0.002)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_quarter_of_the_current_is_enough(stepped: Stepped, sign: int) -> None:
    s, config = stepped.state, stepped.config
    for _ in range(180):
        for period in range(PERIODS):
            stepped.lib.rotor_search_add(s, config, sign * ((s.current >> 18) + 1) if period else 0, 0)
        stepped.step(0)
    assert s.phase == PULL


@pytest.mark.parametrize("origin", [0, 123456, 2**31 - 2, -(2**31)])
def test_search_does_not_depend_on_the_start_position(core: Core, origin: int) -> None:
    """Only differences matter, also across the wrap of 32 bits."""
    stepped, moved = Stepped(core, origin), (origin + 3 + 2**31) % 2**32 - 2**31
    s = stepped.state
    stepped.step(origin, moved)
    assert (s.phase, s.direction) == (BRAKE, 1)
    stepped.until(PULL, moved)
    # the rotor was below the vector, so it is a quarter turn below now; and it has moved by 3
    assert s.theta_m == pytest.approx(-16384 + 3 * 65536 * 2 / 4000, abs=1)
    assert s.reach == 16384


def test_dither_of_one_count_does_not_extend_the_pull_without_limit(stepped: Stepped) -> None:
    """A blocked shaft on a dithering edge ends in HELD after four times the usual waiting time."""
    s, config = stepped.state, stepped.config
    ticks = 0
    while s.phase < FOUND and ticks < 10000:
        stepped.step(ticks & 1)
        ticks += 1
    assert s.phase == HELD
    assert ticks < 3 * (200 + 4 * config.hold_ticks + 10 * config.rest_ticks) + 2 * config.follow.ticks + 10


@pytest.mark.parametrize("factor", [1, 350])
def test_long_times_do_not_wrap(stepped: Stepped, factor: int) -> None:
    """Ten times the longest rest is more than 16 bits."""
    stepped.config.rest_ticks = 20 * factor
    stepped.step(3)
    stepped.until(REST, 3)
    assert stepped.ticks(lambda tick: 3 + (tick & 1)) == 10 * stepped.config.rest_ticks


@pytest.mark.parametrize("error", [-400, 0, 400])
@pytest.mark.parametrize("friction", [0, 500, 1500])
def test_verification_measures_the_angle(stepped: Stepped, error: int, friction: int) -> None:
    """The shaft lags behind the vector by its friction in both directions; the true angle is found."""
    s = stepped.state
    stepped.to_verification()
    position, count = 0, 65536 * 2 / 4000
    for _ in range(2000):
        vector = wrapped(s.vector)
        while vector - (error + (position + 0.5) * count) > friction:
            position += 1
        while vector - (error + (position - 0.5) * count) < -friction:
            position -= 1
        stepped.step(position)
        if s.verified:
            break
    assert s.phase == REST, "the shaft has just moved"
    stepped.until(FOUND, position, 100)
    assert wrapped(s.vector) == pytest.approx(error + position * count, abs=count)


def test_verification_rotates_the_vector_to_both_sides(stepped: Stepped) -> None:
    """Rotation to the largest angle of both sides; the shaft does not follow, so a vector from the side is next."""
    s, config = stepped.state, stepped.config
    stepped.to_verification()
    angles = []
    while s.phase == VERIFY:
        angles.append(wrapped(s.vector))
        stepped.step(0)
    maximum = config.verify_angle + config.verify_step
    assert config.verify_angle <= max(angles) < maximum
    assert config.verify_angle <= -min(angles) < maximum
    assert (s.phase, s.side, s.verify_failures) == (REST, 1, 1)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_direction_is_tested_after_the_second_runaway(stepped: Stepped, sign: int) -> None:
    """Farther than a quarter of an electrical turn from the assumed position: once may be a disturbance."""
    s = stepped.state
    stepped.to_verification()
    far = 4000 // (4 * 2) - 1
    stepped.step(sign * far)
    assert s.phase == VERIFY
    stepped.step(sign * (far + 2))
    assert (s.phase, s.runaways) == (REST, 1)
    s.phase, s.origin = VERIFY, 0
    stepped.step(sign * (far + 2))
    assert (s.phase, s.runaways) == (REST, 2)
    stepped.until(DIRECTION, sign * (far + 2))


@pytest.mark.parametrize(
    ("counted", "phase"), [(-1.6, HELD), (-1.4, REVERSED), (-0.6, REVERSED), (-0.4, HELD), (0.0, HELD), (1.0, HELD)]
)
def test_only_an_encoder_that_counts_against_the_vector_is_reversed(
    stepped: Stepped, counted: float, phase: int
) -> None:
    """`counted`: movement of the count over the rotation of the vector."""
    s = stepped.state
    stepped.to_verification()
    s.runaways = 2
    s.phase, s.current, s.current_decaying, s.timer = REST, 0, False, 0
    stepped.until(DIRECTION)
    stepped.to_full_current()
    turned, before = 0.0, s.vector
    while s.phase == DIRECTION:
        stepped.step(round(counted * turned * 4000 / (65536 * 2)))
        turned += (s.vector - before) % 65536
        before = s.vector
    assert turned == pytest.approx(1.5 * 65536, rel=0.01)
    assert s.phase == phase


@pytest.mark.parametrize("step", [4096, 6000, 8192])
def test_the_direction_is_found_with_the_fastest_rotation(stepped: Stepped, step: int) -> None:
    """The largest steps that a board accepts: the vector must not rotate by half a turn or more per tick."""
    s, config = stepped.state, stepped.config
    stepped.to_verification()
    s.runaways = 2
    s.phase, s.current, s.current_decaying, s.timer = REST, 0, False, 0
    stepped.until(DIRECTION)
    stepped.to_full_current()
    config.verify_step = step
    turned, before = 0.0, s.vector
    while s.phase == DIRECTION:
        stepped.step(round(-turned * 4000 / (65536 * 2)))
        turned += (s.vector - before) % 65536
        before = s.vector
    assert s.phase == REVERSED


def test_rest_lasts_until_standstill(stepped: Stepped) -> None:
    """Every movement restarts the waiting time; the bounds are shifted by the total movement at its end."""
    s, config = stepped.state, stepped.config
    stepped.step(3)
    stepped.until(REST, 3)
    for position in range(4, 4 + 5 * config.rest_ticks):
        stepped.step(position)
        assert s.phase == REST
    for _ in range(config.rest_ticks - 1):
        stepped.step(position)
        assert s.phase == REST
    stepped.step(position)
    assert s.phase == PULL
    assert s.theta_m == pytest.approx(-16384 + position * 65536 * 2 / 4000, abs=1)


def test_dither_of_one_count_is_accepted_as_rest(core: Core) -> None:
    """Dither on an edge, or of an encoder with one dead line; continued movement is no rest."""
    for step, rests in ((0, True), (1, False)):
        stepped = Stepped(core)
        stepped.step(3)
        stepped.until(REST, 3)
        for k in range(10 * stepped.config.rest_ticks - 1):
            stepped.step(3 + (k & 1) + step * (k // 15))
            assert stepped.state.phase == REST
        stepped.step(3 + step * 14, 4 + step * 14)
        assert (stepped.state.phase == PULL) == rests


@pytest.mark.parametrize("moving", [1, 2, 5])
def test_brake_lasts_four_times_as_long_as_the_shaft_has_moved(stepped: Stepped, moving: int) -> None:
    """Counted from the first movement; a shaft that keeps moving is released then."""
    s = stepped.state
    for position in [0] * 100 + [-1] * (moving - 1) + [-3]:
        stepped.step(position)
    assert (s.phase, s.moving) == (BRAKE, moving)
    ticks = 0
    while s.phase == BRAKE:
        ticks += 1
        stepped.step(-3 - ticks)
    assert ticks == 4 * moving


def wrapped(angle: int) -> int:
    """Angle with 2^16 per revolution, wrapped to half a revolution."""
    return (angle + 32768) % 65536 - 32768


def twitch(stepped: Stepped, position: int) -> None:
    """Move the shaft to a position when the next vector pulls; it stays there until the following vector."""
    stepped.until(PULL, stepped.state.origin)
    stepped.step(position)
    assert stepped.state.phase == BRAKE
    for _ in range(100):
        stepped.step(position)
        if stepped.state.phase in (PULL, VERIFY):
            return
    pytest.fail("the search does not continue")


def test_interval_halves_exactly(stepped: Stepped) -> None:
    """Eight halvings of a revolution: rounding errors do not accumulate in the bounds."""
    s, config = stepped.state, stepped.config
    reaches = [s.reach]
    for k in range(8):
        twitch(stepped, 3 * (1 - (k & 1)))
        reaches.append(s.reach)
    assert s.phase == VERIFY
    assert reaches == [32768 >> k for k in range(9)]
    assert 2 * reaches[-1] <= config.interval < 2 * reaches[-2]


@pytest.mark.parametrize("at", range(1, 7))
@pytest.mark.parametrize("degrees", [-140.0, -33.0, 12.0, 71.0])
def test_external_displacement_causes_no_wrong_angle(core: Core, degrees: float, at: int) -> None:
    """An external displacement against one of the vectors is first accepted as a response and then rejected."""
    shaft = Shaft(degrees * DEGREE)
    knocked = False

    def knock(s: Any) -> None:
        nonlocal knocked
        if s.searches == at and s.phase == PULL and not knocked:
            knocked = True
            vector = core.lib.rotor_search_angle(s) * math.pi / 32768.0
            away = -math.copysign(1.0, math.sin(vector - shaft.angle))
            shaft.moved += away * 4.5 * COUNT

    result = search(core, shaft, each_tick=knock)
    assert result.phase == FOUND
    assert abs(result.error) < 0.8  # the angle at which friction balances the torque, and a count


def test_the_full_current_pulls_four_times_as_long_at_an_edge_that_dithers(stepped: Stepped) -> None:
    stepped.to_full_current()
    assert stepped.ticks(lambda tick: 1 - tick % 2) == 4 * stepped.config.hold_ticks


@pytest.mark.parametrize(("side", "counts"), [(0, 3), (1, 6), (-1, 6)])
def test_counts_that_end_the_pull_depend_on_the_side(stepped: Stepped, side: int, counts: int) -> None:
    stepped.state.side = side
    stepped.step(counts - 1)
    assert stepped.state.phase == PULL
    stepped.step(counts)
    assert stepped.state.phase == BRAKE


def test_the_brake_reverses_the_full_current_in_four_steps_and_holds_it_as_long_as_the_pull(stepped: Stepped) -> None:
    stepped.to_full_current()
    stepped.step(1, 1, 1, 1, 1, 3)
    full = stepped.state.current * 2
    currents: list[int] = []
    while stepped.state.phase == BRAKE and len(currents) < 10:
        currents.append(stepped.state.current)
        stepped.step(3)
    reversal = [full // 2, 0, -full // 2, -full]
    assert full == stepped.config.current_limit << 16
    assert currents == [*reversal, *[-full] * 5, -full + stepped.config.current_step]


@pytest.mark.parametrize(
    ("reach", "times"), [(32768, 1), (16384, 1), (8192, 2), (4096, GROWTH_MAX), (2048, GROWTH_MAX)]
)
def test_the_current_grows_faster_within_narrower_bounds(stepped: Stepped, reach: int, times: float) -> None:
    stepped.state.reach = reach
    stepped.step(0)
    assert stepped.state.current == times * stepped.config.current_step


@pytest.mark.parametrize(("periods", "phase"), [(LOW_CURRENT_PERIODS - 1, PULL), (LOW_CURRENT_PERIODS, STARVED)])
def test_missing_current_for_64_consecutive_periods_ends_in_starved(stepped: Stepped, periods: int, phase: int) -> None:
    stepped.to_full_current()
    for current, times in ((0, 63), (stepped.config.current_limit, 1), (0, periods)):
        for _ in range(times):
            stepped.lib.rotor_search_add(stepped.state, stepped.config, current, 0)
    stepped.step(0)
    assert stepped.state.phase == phase


@pytest.mark.parametrize(
    ("requested", "measured", "phase"),
    [
        (1.0, 0.98 * LOW_CURRENT, STARVED),
        (1.0, 1.02 * LOW_CURRENT, PULL),
        (1.02 * LOW_CURRENT, 0.0, STARVED),
        (0.98 * LOW_CURRENT, 0.0, PULL),
    ],
)
def test_the_tuning_rules_know_which_current_is_low(
    stepped: Stepped, requested: float, measured: float, phase: int
) -> None:
    """Currents relative to the limit, and measured relative to the requested one."""
    current = requested * stepped.config.current_limit
    stepped.state.current = round(current) << 16
    for _ in range(LOW_CURRENT_PERIODS):
        stepped.lib.rotor_search_add(stepped.state, stepped.config, round(measured * current), 0)
    stepped.step(0)
    assert stepped.state.phase == phase


def test_dither_of_two_counts_is_no_rest(stepped: Stepped) -> None:
    stepped.step(3)
    stepped.until(REST, 3)
    for tick in range(12 * stepped.config.rest_ticks):
        stepped.step(3 + 2 * (tick % 2))
    assert stepped.state.phase == REST


def test_a_verified_shaft_that_coasts_beyond_six_counts_is_accepted(stepped: Stepped) -> None:
    stepped.state.phase, stepped.state.verified = REST, True
    stepped.step(2, 4, 6)
    assert stepped.state.phase == REST
    stepped.step(7)
    assert stepped.state.phase == FOUND


@pytest.mark.parametrize(("counts", "follows"), [(2, False), (3, True)])
def test_a_shaft_follows_the_vector_by_three_counts(stepped: Stepped, counts: int, follows: bool) -> None:
    s = stepped.state
    stepped.to_verification()
    stepped.step(counts)
    assert (s.phase, s.follows) == (VERIFY, follows)


@pytest.mark.parametrize(("before", "phase"), [(1, REST), (2, HELD)])
def test_a_shaft_that_does_not_follow_three_times_is_blocked(stepped: Stepped, before: int, phase: int) -> None:
    s = stepped.state
    stepped.to_verification()
    s.verify_failures = before
    while s.phase == VERIFY:
        stepped.step(0)
    assert (s.phase, s.verify_failures) == (phase, before + 1)


def test_a_shaft_is_free_after_three_counts(stepped: Stepped) -> None:
    stepped.until(TURN, maximum=2000)
    stepped.step(2)
    assert (stepped.state.phase, stepped.state.verify_failures) == (TURN, 0)
    stepped.step(3)
    assert (stepped.state.phase, stepped.state.verify_failures) == (REST, 1)


@given(st.integers(0, 2**32 - 1), st.integers(1, 400))
def test_any_positions_keep_the_search_in_range(core: Core, seed: int, ticks: int) -> None:
    """Any counter values, also jumps by half its range: defined behaviour, within the current limit, a valid phase."""
    draw = random.Random(seed)
    position = draw.randint(-(2**31), 2**31 - 1)
    stepped = Stepped(core, position)
    s, config = stepped.state, stepped.config
    for _ in range(ticks):
        if draw.random() < 0.1:
            position = draw.randint(-(2**31), 2**31 - 1)
        core.lib.rotor_search_add(s, config, draw.randint(-32768, 32767), draw.randint(-32768, 32767))
        stepped.step(position)
        assert abs(s.current) <= config.current_limit << 16
        assert s.phase in range(9)
        assert 128 <= s.reach <= 32768
