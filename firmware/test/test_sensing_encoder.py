"""Position from the quadrature counter and the emulated index (DRM 2.4.1, 2.4.2, 2.7.2)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import pytest
from core_library import Core
from exact import I16, I32, U16, edges, nearest, towards_zero, wrap
from hypothesis import given, settings
from hypothesis import strategies as st
from quad_timer import COUNTS, QuadTimer


@pytest.fixture(scope="module")
def config(core: Core) -> Any:
    return core.ffi.addressof(core.lib.probe_config().axis[0].encoder)


LINES = edges(100, 16384)
POLE_PAIRS = st.integers(1, 50)


def other_config(core: Core, lines: int, pole_pairs: int) -> Any:
    """Configuration of any encoder on any motor, as computed by the tuning tool."""
    return core.ffi.new("encoder_config_t *", (period_of(lines), pole_pairs, nearest(2**30, lines)))


def period_of(lines: int) -> int:
    """Counts from one reload of the counter to the next."""
    return 4 * lines if lines <= 8192 else 2 * lines


def apart(angle: int, exact: float) -> float:
    """Difference of two angles in LSB, modulo a turn."""
    return abs((angle - exact + 32768) % 65536 - 32768)


class Encoder:
    """The C module on a quad timer."""

    def __init__(self, core: Core, config: Any, timer: QuadTimer | None = None) -> None:
        self._lib, self._config = core.lib, config
        self.c = core.ffi.new("encoder_t *")
        self.timer = timer or QuadTimer()
        self._lib.encoder_reset(self.c, self.timer.raw, self.timer.index)

    def update(self, edges: int = 0) -> bool:
        """Move the shaft, then sample as in a slow loop."""
        self.timer.move(edges)
        return bool(self._lib.encoder_update(self.c, self._config, self.timer.raw, self.timer.index))

    def preset(self, count: int) -> None:
        self.timer.count = count
        self._lib.encoder_preset(self.c, self._config, count & 0xFFFF)


# ---- angles ---------------------------------------------------------------------------------------------------------


@given(lines=LINES, pole_pairs=POLE_PAIRS, count=I16)
@settings(max_examples=300)
def test_angles_of_any_encoder(core: Core, lines: int, pole_pairs: int, count: int) -> None:
    """Half an LSB, plus the rounding of the constant: half of 2^-16 LSB per count and pole pair."""
    config = other_config(core, lines, pole_pairs)
    constant = abs(count) / 2**17
    exact = count * 65536 / (4 * lines)
    here = core.ffi.new("encoder_t *", {"count": count & 0xFFFF})
    assert apart(core.lib.encoder_theta_m(config, count & 0xFFFF), exact) <= 0.5 + constant
    assert (
        apart(core.lib.encoder_theta_e(here, config, count & 0xFFFF), exact * pole_pairs) <= 0.5 + constant * pole_pairs
    )
    # the rounding itself, in integers
    whole = count * config.angle_per_count
    assert core.lib.encoder_theta_m(config, count & 0xFFFF) == wrap(nearest(whole, 65536), 16)
    assert core.lib.encoder_theta_e(here, config, count & 0xFFFF) == wrap(nearest(whole * pole_pairs, 65536), 16)


@given(lines=LINES, pole_pairs=POLE_PAIRS, theta=I16)
@settings(max_examples=300)
def test_count_at_any_angle(core: Core, lines: int, pole_pairs: int, theta: int) -> None:
    """The nearest count; a quotient truncated by less than 2^-16 below a half is rounded down."""
    config = other_config(core, lines, pole_pairs)
    count = core.lib.encoder_count_at(config, theta)
    if theta != -32768:  # half a turn of the largest encoder does not fit
        assert abs(count - theta * 4 * lines / (65536 * pole_pairs)) <= 0.5 + 2**-16
    assert count == max(nearest(towards_zero(theta * 4 * lines, pole_pairs), 65536), -32767)


# ---- wraps ----------------------------------------------------------------------------------------------------------


@given(data=st.data(), lines=LINES)
@settings(max_examples=300)
def test_difference_is_the_shorter_distance(core: Core, data: st.DataObject, lines: int) -> None:
    """Exact for all pairs of counts of any encoder; exactly half a period keeps its sign."""
    counts = period_of(lines)
    at = edges(-counts + 1, counts - 1)
    count, previous = data.draw(at), data.draw(at)
    moved = core.lib.encoder_difference(other_config(core, lines, 1), count & 0xFFFF, previous & 0xFFFF)
    assert (moved - (count - previous)) % counts == 0
    assert abs(moved) <= counts // 2
    if abs(moved) == counts // 2 and abs(count - previous) < counts:
        assert moved == count - previous


def test_reversal_at_the_compare_value_counts_no_revolution(core: Core, config: Any) -> None:
    """The index pulse is at the compare value, one count before the reload: a shaft that reverses there has
    not begun a new revolution, and the next wrap downwards counts one down."""
    encoder = Encoder(core, config)
    for _ in range(2):
        encoder.update(1999)
    assert encoder.update(1)  # 3999: the pulse
    assert encoder.timer.index == 1
    assert encoder.c.turns == 0
    for _ in range(3):
        assert encoder.update(-1333)
    assert encoder.update(-1)
    assert encoder.c.position == -1
    for _ in range(3):
        assert encoder.update(-1333)
    assert encoder.timer.index == 2  # at -3999 minus one revolution
    assert encoder.update(-1)
    assert encoder.c.position == encoder.timer.shaft


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("back", [1, 2, 5])
def test_a_reversal_across_the_reload_keeps_the_revolutions(core: Core, config: Any, direction: int, back: int) -> None:
    """Between two samples the shaft reverses to or behind its old position, but the counter has been reloaded."""
    encoder = Encoder(core, config)
    for moved in (1999, 1999, 1):
        assert encoder.update(direction * moved)
    encoder.timer.move(direction)
    assert encoder.update(-direction * back)
    assert encoder.c.position == encoder.timer.shaft
    for _ in range(3):
        assert encoder.update(direction * 1999)
        assert encoder.c.position == encoder.timer.shaft


@pytest.mark.parametrize("direction", [1, -1])
def test_missing_index_pulse_is_found_at_the_wrap(core: Core, config: Any, direction: int) -> None:
    encoder = Encoder(core, config)
    encoder.timer.index_works = False
    results = [encoder.update(direction * 100) for _ in range(39)]
    assert all(results)
    assert not encoder.update(direction * 100)


# ---- position (E41, F27) --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("turns", "count", "position"), [(1, 2000, 1.25), (2, -1000, 1.5), (1, -2000, 0.25)], ids=["p1", "p2", "p3"]
)
def test_worked_examples_of_f27(core: Core, config: Any, turns: int, count: int, position: float) -> None:
    """EncCntInit = 1000: RealZCnt + (EncCnt - EncCntInit) / 4000."""
    encoder = core.ffi.new("encoder_t *")
    core.lib.encoder_reset(encoder, 1000, 0)
    assert encoder.count_init == 1000
    encoder.turns = turns
    encoder.count = count & 0xFFFF
    core.lib.encoder_update(encoder, config, count & 0xFFFF, 0)
    assert encoder.position / COUNTS == position


@given(
    start=st.integers(-COUNTS + 2, COUNTS - 2),
    moves=st.lists(st.one_of(st.integers(-1999, 1999), st.sampled_from([-2, -1, 0, 1, 2])), min_size=1, max_size=60),
    phase=st.integers(0, 1),
)
@settings(max_examples=150)
def test_any_motion_keeps_the_position(core: Core, config: Any, start: int, moves: Sequence[int], phase: int) -> None:
    encoder = Encoder(core, config, QuadTimer(shaft=phase, count=start))
    for move in moves:
        assert encoder.update(move)
        assert encoder.c.position == encoder.timer.shaft - phase


@given(presets=st.lists(st.tuples(st.integers(-5000, 5000), st.integers(-1000, 1000)), min_size=1, max_size=6))
@settings(max_examples=60)
def test_preset_keeps_the_position(core: Core, config: Any, presets: Sequence[tuple[int, int]]) -> None:
    """A new alignment writes the counter; revolutions and position are kept (E41)."""
    encoder = Encoder(core, config)
    for distance, count in presets:
        for move in [distance // 4] * 4:
            assert encoder.update(move)
        before = encoder.c.position
        encoder.preset(count)
        assert encoder.c.position == before
        assert encoder.update(0)
        assert encoder.c.position == before
        assert encoder.update(37)
        assert encoder.c.position == before + 37


@given(
    lines=LINES,
    pole_pairs=POLE_PAIRS,
    start=st.integers(-2, 2),
    moves=st.lists(st.floats(-0.05, 0.05), min_size=1, max_size=12),
)
@settings(max_examples=50, deadline=None)
def test_electrical_angle_follows_the_shaft_across_reloads(
    core: Core, lines: int, pole_pairs: int, start: int, moves: list[float]
) -> None:
    """In every fast loop, also between a reload and the slow loop that notices it, up to 628 rad/s.

    With an odd number of pole pairs a wrong half turn is half an electrical turn.
    """
    config, timer = other_config(core, lines, pole_pairs), QuadTimer(count=start, period=period_of(lines))
    encoder = Encoder(core, config, timer)
    constant = 0.5 * 2**-16 * pole_pairs * 32768  # rounding of the angle per count
    for move in moves:
        for _ in range(2):
            timer.move(round(move * 2 * lines))
            angle = core.lib.encoder_theta_e(encoder.c, config, timer.raw)
            exact = (timer.shaft + start) * pole_pairs * 65536 / (4 * lines)
            assert apart(angle, exact) <= 0.5 + constant
        assert encoder.update()


@given(
    lines=LINES,
    start=I32,
    moves=st.lists(st.one_of(st.integers(-3000, 3000), st.sampled_from([-1, 1]), I16), min_size=1, max_size=60),
)
@settings(max_examples=300)
def test_position_of_any_encoder_is_exact(core: Core, lines: int, start: int, moves: list[int]) -> None:
    """In position counts, 1000 per line: a near one, modulo 2^32, and its fraction, without an error that adds up."""
    config, total = other_config(core, lines, 1), 0
    position = core.ffi.new("encoder_position_t *", (start, 0, lines))
    for moved in moves:
        core.lib.encoder_position_add(position, config, moved)
        total += moved
        exact = Fraction(1000 * total, lines)
        whole = total * 1000 // lines
        whole += wrap(position.whole - wrap(start + whole, 32), 32)
        assert position.rest == total * 1000 - whole * lines
        assert abs(exact - whole) <= Fraction(1, 2) + Fraction(1, 60)
        part = core.lib.encoder_position_part(position, config) / 2**24
        assert abs(part - float(exact - whole)) <= 2**-24 + 2**-16  # the fraction uses the rounded angle per count


# ---- every bit ------------------------------------------------------------------------------------------------------


class Model:
    """F14 and E41 in integers of 32 bits; every count stays within one turn of the last."""

    def __init__(self, counts: int, count: int, index: int) -> None:
        self.counts = counts
        self.count, self.index, self.pending = count, index, 0
        self.turns, self.origin, self.position, self.integral = 0, count, 0, 0

    def update(self, count: int, index: int) -> bool:
        moved, wraps = count - self.count, 0
        while abs(moved) > self.counts // 2:
            wraps += 1 if moved < 0 else -1
            moved += self.counts if moved < 0 else -self.counts
        self.pending = (self.pending + index - self.index) & 0xFFFF
        if wraps:
            if self.pending:
                self.turns = wrap(self.turns + (1 if wraps > 0 else -1), 32)
            self.pending = 0
        elif abs(count) < self.counts // 2:
            self.pending = 0
        self.count, self.index = count, index
        self.integral = wrap(self.integral + moved, 32)
        self.position = wrap(self.turns * self.counts + count - self.origin, 32)
        return self.position == self.integral

    def resync(self) -> None:
        self.origin = wrap(self.turns * self.counts + self.count - self.integral, 32)
        self.position, self.pending = self.integral, 0

    def preset(self, count: int) -> None:
        self.origin = wrap(self.turns * self.counts + count - self.position, 32)
        self.count, self.pending = count, 0

    @property
    def state(self) -> tuple[int, ...]:
        return self.count & 0xFFFF, self.index, self.pending, self.turns, self.origin, self.position, self.integral


@given(
    data=st.data(),
    lines=LINES,
    index=U16,
    far=st.tuples(I32, I32, I32, I32, st.sampled_from([0, 0, 0, 1, 65535])),
    actions=st.lists(st.sampled_from(["update"] * 8 + ["resync", "preset"]), min_size=1, max_size=12),
)
@settings(max_examples=300)
def test_agrees_with_integers_in_every_bit(
    core: Core, data: st.DataObject, lines: int, index: int, far: tuple[int, ...], actions: list[str]
) -> None:
    """Any counts and index pulses from any start, also across the wrap of 32 bits."""
    counts, config, c = period_of(lines), other_config(core, lines, 1), core.ffi.new("encoder_t *")
    at = edges(-counts + 1, counts - 1)
    start = data.draw(at)
    core.lib.encoder_reset(c, start & 0xFFFF, index)
    model = Model(counts, start, index)
    fields = ("turns", "origin", "position", "integral", "pending")
    for field, c_field, value in zip(fields, ("turns", "count_init", *fields[2:]), far, strict=True):
        setattr(model, field, value)
        setattr(c, c_field, value)
    for action in actions:
        if action == "resync":
            core.lib.encoder_resync(c, config)
            model.resync()
        elif action == "preset":
            count = data.draw(at)
            core.lib.encoder_preset(c, config, count & 0xFFFF)
            model.preset(count)
        else:
            count = data.draw(at)
            pulses = data.draw(st.sampled_from([0, 0, 1, 2, 65535]))
            index = (index + pulses) & 0xFFFF
            assert bool(core.lib.encoder_update(c, config, count & 0xFFFF, index)) == model.update(count, index)
        now = (c.count, c.index, c.pending, c.turns, c.count_init, c.position, c.integral)
        assert now == model.state


def test_reset_clears_the_state(core: Core) -> None:
    c = core.ffi.new("encoder_t *", (1, 2, 3, 1, 4, 5, 6, 7))
    core.lib.encoder_reset(c, 0xF061, 9)
    assert (c.count, c.index, c.pending, c.half_turns, c.turns) == (0xF061, 9, 0, 0, 0)
    assert (c.position, c.integral) == (0, 0)
    assert c.count_init == -3999
