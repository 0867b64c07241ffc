"""Encoder and quad timers: count, reload, emulated index and its reversal error, captures at analytic times."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from native_library import Native, c_axis, c_config, ideal_plant

EDGE = 2 * math.pi / 4000  # [rad]
TICK_NS = 1280


class Encoder:
    """An encoder whose shaft is moved to positions given in counts."""

    def __init__(self, plant_c: Native, start: float = 0.5, lines: int = 1000, period: int = 4000) -> None:
        self.native = plant_c
        self.edge = 2 * math.pi / (4 * lines)
        self.c = plant_c.ffi.new("plant_encoder_t *")
        axis = ideal_plant(theta_start=start * self.edge, encoder_lines=lines).axes[0]
        plant_c.lib.plant_encoder_init(self.c, c_axis(plant_c, axis))
        plant_c.lib.plant_encoder_start(self.c, period)
        self.at = start
        self.now_ns = 0

    def move_to(self, position: float, duration_ns: int = 10_000) -> None:
        """Move to a position at constant speed."""
        speed = (position - self.at) * self.edge / (duration_ns * 1e-9)
        self.move(position, speed, speed, duration_ns)

    def move(self, position: float, omega_0: float, omega_1: float, duration_ns: int) -> None:
        movement = {
            "theta_0": self.at * self.edge,
            "theta_1": position * self.edge,
            "omega_0": omega_0,
            "omega_1": omega_1,
            "duration_ns": float(duration_ns),
        }
        self.native.lib.plant_encoder_move(self.c, self.native.ffi.new("plant_movement_t *", movement), self.now_ns)
        self.at = position
        self.now_ns += duration_ns

    def count_to(self, position: float) -> None:
        """Move without times of the edges."""
        self.native.lib.plant_encoder_count(self.c, position * self.edge)
        self.at = position

    @property
    def count(self) -> int:
        """Counter as a two's complement number."""
        value = int(self.c.count)
        return value - 0x10000 if value >= 0x8000 else value

    def take(self) -> tuple[int, int] | None:
        count, time = self.native.ffi.new("uint16_t *"), self.native.ffi.new("uint16_t *")
        if not self.native.lib.plant_encoder_take(self.c, count, time):
            return None
        return int(count[0]), int(time[0])

    def age(self) -> int:
        return int(self.native.lib.plant_encoder_age(self.c, self.now_ns))


class Model:
    """The timers of one axis edge by edge, from the words of the reference design (DRM 2.4.1, 2.4.2)."""

    def __init__(self, position: int, period: int) -> None:
        self._last = period - 1
        self.position, self.count, self.index, self.oflag = position, 0, 0, False

    def step(self, up: bool) -> None:
        boundary = self.position + 1 if up else self.position
        self.position += 1 if up else -1
        if boundary % 2 == 0:  # an edge of B
            self.oflag = False
        compare = self._last if up else -self._last
        self.count = 0 if self.count == compare else self.count + (1 if up else -1)
        if self.count == compare and not self.oflag:
            self.index += 1
            self.oflag = True


@pytest.mark.parametrize("timed", [True, False])
@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    start=st.integers(-9000, 9000),
    period=st.sampled_from([4000, 4000, 400, 32768]),
    moves=st.lists(
        st.one_of(st.integers(-30, 30), st.integers(-9000, 9000), st.sampled_from([-4000, 4000, 3999, -3999])),
        max_size=12,
    ),
)
def test_agrees_with_the_timers_edge_by_edge(
    plant_c: Native, timed: bool, start: int, period: int, moves: list[int]
) -> None:
    encoder, model = Encoder(plant_c, start + 0.5, period=period), Model(start, period)
    for move in moves:
        (encoder.move_to if timed else encoder.count_to)(encoder.at + move)
        for _ in range(abs(move)):
            model.step(move > 0)
        assert (encoder.count, encoder.c.index, encoder.c.oflag) == (model.count, model.index & 0xFFFF, model.oflag)
        # the angle is correct after any number of reloads
        assert (encoder.count - (model.position - start)) % period == 0


def test_a_preset_shifts_the_angle_and_reloads_as_before(plant_c: Native) -> None:
    encoder = Encoder(plant_c)
    encoder.c.count = 1000
    encoder.move_to(3000.5)
    assert encoder.count == 0
    encoder.c.count = 0x10000 - 10
    encoder.move_to(3020.5)
    assert encoder.count == 10


def test_other_line_counts_do_not_change_the_timers(plant_c: Native) -> None:
    encoder = Encoder(plant_c, lines=500)
    encoder.move_to(3999.5)
    encoder.move_to(4000.5)
    assert encoder.count == 0


class TestCapture:
    def test_no_capture_before_arming(self, plant_c: Native) -> None:
        encoder = Encoder(plant_c)
        encoder.move_to(100.5)
        assert encoder.take() is None

    def test_latches_the_next_b_edge_once(self, plant_c: Native) -> None:
        encoder = Encoder(plant_c)
        encoder.move_to(1.5)
        plant_c.lib.plant_encoder_arm(encoder.c)
        encoder.move_to(9.5, duration_ns=80_000)
        # from 1.5 at one edge per 10 us: B edge 2 comes after 5 us, later ones are not captured
        assert encoder.take() == (2, (10_000 + 5_000) // TICK_NS)
        assert encoder.take() is None
        encoder.move_to(20.5)
        assert encoder.take() is None

    def test_a_edges_are_not_captured(self, plant_c: Native) -> None:
        encoder = Encoder(plant_c)
        plant_c.lib.plant_encoder_arm(encoder.c)
        encoder.move_to(1.5)
        assert not encoder.c.captured
        encoder.move_to(2.5)
        assert encoder.c.captured

    def test_arming_again_discards_a_pending_capture(self, plant_c: Native) -> None:
        encoder = Encoder(plant_c)
        plant_c.lib.plant_encoder_arm(encoder.c)
        encoder.move_to(2.5)
        plant_c.lib.plant_encoder_arm(encoder.c)
        assert encoder.take() is None
        encoder.move_to(4.5)
        assert encoder.take() is not None

    @settings(max_examples=100, deadline=None, derandomize=True)
    @given(
        position=st.integers(-5000, 5000),
        omega_0=st.floats(0.0, 400.0),
        omega_1=st.floats(0.0, 400.0),
        sign=st.sampled_from([1, -1]),
    )
    def test_capture_time_is_on_the_curve_of_the_movement(
        self, plant_c: Native, position: int, omega_0: float, omega_1: float, sign: int
    ) -> None:
        encoder = Encoder(plant_c, start=position + 0.5)
        duration_ns = 1_000_000
        t_end = duration_ns * 1e-9
        acceleration = (omega_1 - omega_0) / t_end
        travel = sign * (omega_0 + omega_1) / 2 * t_end / EDGE
        encoder.now_ns = 1_000_000
        plant_c.lib.plant_encoder_arm(encoder.c)
        encoder.move(encoder.at + travel, sign * omega_0, sign * omega_1, duration_ns)
        boundary = 2 * (math.floor((position + 0.5) / 2) + 1) if sign > 0 else 2 * math.floor((position + 0.5) / 2)
        distance = abs(boundary - position - 0.5) * EDGE
        if abs(travel) * EDGE < distance:
            assert encoder.take() is None
            return
        root = math.sqrt(max(omega_0**2 + 2 * acceleration * distance, 0.0))
        first_ns = 2 * distance / (omega_0 + root) * 1e9
        capture = encoder.take()
        assert capture is not None
        ticks = (1_000_000 + first_ns) / TICK_NS
        assert abs((capture[1] - ticks + 0x8000) % 0x10000 - 0x8000) < 1.0 + 1e-3


def test_time_of_an_edge_after_the_shaft_has_turned_back(plant_c: Native) -> None:
    """The shaft stops after 1 us of a step, reverses, and crosses the edge again 1.05 us later."""
    acceleration, edge = 2e8, 3 * 2 * EDGE
    plant = ideal_plant(theta_start=edge + 1e-5, inertia=1e-10)
    state = plant_c.ffi.new("plant_t *")
    plant_c.lib.plant_init(state, c_config(plant_c, plant))
    axis = state.axis[0]
    axis.motor.load, axis.motor.omega = acceleration * 1e-10, acceleration * 1e-6
    crossing_ns = 1000 + math.sqrt(2 * (0.5 * acceleration * 1e-12 + 1e-5) / acceleration) * 1e9
    for begin_ns, tick in [(100 * TICK_NS - int(crossing_ns) + 10, 100), (100 * TICK_NS - int(crossing_ns) - 10, 99)]:
        trial = plant_c.ffi.new("plant_t *", state[0])
        encoder = plant_c.ffi.addressof(trial.axis[0], "encoder")
        plant_c.lib.plant_encoder_arm(encoder)
        plant_c.lib.plant_step(trial, begin_ns)
        time = plant_c.ffi.new("uint16_t *")
        assert plant_c.lib.plant_encoder_take(encoder, plant_c.ffi.new("uint16_t *"), time)
        assert time[0] == tick


class TestAge:
    def test_restarts_at_captured_edges_only(self, plant_c: Native) -> None:
        encoder = Encoder(plant_c)
        encoder.now_ns = 10 * TICK_NS
        assert encoder.age() == 10
        plant_c.lib.plant_encoder_arm(encoder.c)
        encoder.move_to(2.45, duration_ns=20 * TICK_NS)  # the B edge at 2 comes after 15.4 ticks
        assert encoder.age() == 5
        encoder.move_to(200.5, duration_ns=100 * TICK_NS)  # blocked until it is armed again
        assert encoder.age() == 105
        plant_c.lib.plant_encoder_arm(encoder.c)
        assert encoder.age() == 105

    def test_overflow_stays_until_the_next_captured_edge(self, plant_c: Native) -> None:
        encoder = Encoder(plant_c)
        encoder.now_ns = 0xFFFF * TICK_NS
        assert encoder.age() == 0xFFFF
        for later in (0x10000, 0x10001, 0x20005, 0x12345678):
            encoder.now_ns = later * TICK_NS
            assert encoder.age() == 0x10000
        plant_c.lib.plant_encoder_arm(encoder.c)
        encoder.move_to(2.45, duration_ns=4 * TICK_NS)
        assert encoder.age() == 1


def test_unplugged_encoder_loses_the_motion(plant_c: Native) -> None:
    encoder = Encoder(plant_c)
    encoder.move_to(10.5)
    plant_c.lib.plant_encoder_arm(encoder.c)
    plant_c.lib.plant_encoder_connect(encoder.c, False, encoder.at * EDGE)
    encoder.move_to(50.5)
    assert encoder.count == 10
    assert not encoder.c.captured
    plant_c.lib.plant_encoder_connect(encoder.c, True, encoder.at * EDGE)
    encoder.move_to(53.5)
    assert encoder.count == 13


@pytest.mark.parametrize("line", [0, 1])
@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("start", [0.5, 1.5, 2.5, 3.5])
def test_with_a_dead_line_the_count_alternates(plant_c: Native, line: int, direction: int, start: float) -> None:
    """Only every second edge occurs, and the decoder counts the two edges of a period in opposite directions."""
    encoder = Encoder(plant_c, start=start)
    plant_c.lib.plant_encoder_stick(encoder.c, line, True, False)
    counts = [encoder.count]
    for k in range(1, 41):
        encoder.move_to(start + direction * k)
        counts.append(encoder.count)
    steps = [b - a for a, b in itertools.pairwise(counts) if a != b]
    assert len(steps) == 20
    assert all(a == -b for a, b in itertools.pairwise(steps))
    assert {abs(step) for step in steps} == {1}


def test_direction_of_the_edges_of_a_single_line(plant_c: Native) -> None:
    """Upwards A rises at 1: with B low a step up. B rises at 2: with A low a step down."""
    for line, position, step in ((1, 1.5, 1), (0, 2.5, -1)):
        encoder = Encoder(plant_c, start=0.5)
        plant_c.lib.plant_encoder_stick(encoder.c, line, True, False)
        encoder.move_to(position)
        assert encoder.count == step


def test_a_reversed_encoder_counts_the_other_way(plant_c: Native) -> None:
    encoder = Encoder(plant_c, start=10.5)
    plant_c.lib.plant_encoder_reverse(encoder.c, encoder.at * EDGE)
    encoder.move_to(15.5)
    assert encoder.count == -5
    encoder.move_to(3.5)
    assert encoder.count == 7


def test_a_plugged_in_encoder_has_both_lines_again(plant_c: Native) -> None:
    encoder = Encoder(plant_c)
    plant_c.lib.plant_encoder_stick(encoder.c, 0, True, False)
    plant_c.lib.plant_encoder_connect(encoder.c, True, encoder.at * EDGE)
    encoder.move_to(20.5)
    assert encoder.count == 20
