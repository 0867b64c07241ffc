"""Position from the quadrature counter and the emulated index (DRM 2.4.1, 2.4.2, 2.7.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from hypothesis import given, settings
from hypothesis import strategies as st
from quad_timer import COUNTS, QuadTimer


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


@pytest.fixture(scope="module")
def config(core: Core) -> Any:
    return core.ffi.addressof(core.lib.probe_config().axis[0].encoder)


class Encoder:
    """The C module on a quad timer."""

    def __init__(self, core: Core, config: Any, timer: QuadTimer | None = None) -> None:
        self._lib, self._config = core.lib, config
        self.c = core.ffi.new("encoder_t *")
        self.timer = timer or QuadTimer()
        self._lib.encoder_reset(self.c, self.timer.raw, self.timer.index)

    def update(self, edges: int = 0) -> bool:
        """Turn the shaft, then sample as a slow loop does."""
        self.timer.move(edges)
        return bool(self._lib.encoder_update(self.c, self._config, self.timer.raw, self.timer.index))

    def preset(self, count: int) -> None:
        self.timer.count = count
        self._lib.encoder_preset(self.c, self._config, count & 0xFFFF)


# ---- angles ---------------------------------------------------------------------------------------------------------


def test_angles_of_f12_over_both_directions(core: Core, config: Any) -> None:
    """count x 65536 / 4000, wrapped to 16 bits, for every counter value; electrical: twice that."""
    size = 2 * COUNTS - 1
    mechanical, electrical = np.zeros(size, dtype=np.int16), np.zeros(size, dtype=np.int16)
    core.lib.probe_encoder_angles(
        config, core.ffi.from_buffer("int16_t[]", mechanical), core.ffi.from_buffer("int16_t[]", electrical)
    )
    counts = np.arange(-COUNTS + 1, COUNTS)
    for angles, pole_pairs in ((mechanical, 1), (electrical, 2)):
        exact = counts * pole_pairs * 65536 / COUNTS
        error = (angles - exact + 32768) % 65536 - 32768
        assert np.max(np.abs(error)) <= 0.55


@pytest.mark.parametrize(
    ("count", "angle"), [(0, 0), (1000, 16384), (2000, -32768), (3000, -16384), (-1000, -16384), (-2000, -32768)]
)
def test_quarters_of_a_turn(core: Core, config: Any, count: int, angle: int) -> None:
    assert core.lib.encoder_theta_m(config, count & 0xFFFF) == angle


def test_directions_meet_at_the_wrap(core: Core, config: Any) -> None:
    """c upwards and c - 4000 downwards are the same place."""
    for count in range(1, COUNTS):
        up, down = count, (count - COUNTS) & 0xFFFF
        mechanical = core.lib.encoder_theta_m(config, up) - core.lib.encoder_theta_m(config, down)
        assert (mechanical + 1) % 65536 <= 2  # one LSB
        electrical = core.lib.encoder_theta_e(config, up) - core.lib.encoder_theta_e(config, down)
        assert (electrical + 1) % 65536 <= 2


def test_count_at_an_angle_reads_back(core: Core, config: Any) -> None:
    for theta in range(-32768, 32768, 13):
        count = core.lib.encoder_count_at(config, theta)
        assert -COUNTS // 4 <= count <= COUNTS // 4
        error = (core.lib.encoder_theta_e(config, count & 0xFFFF) - theta + 32768) % 65536 - 32768
        assert abs(error) <= 65536 * 2 / COUNTS / 2 + 1  # half a count


# ---- wraps ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("previous", "count", "moved"),
    [(3990, 10, 20), (-3990, -10, -20), (10, -10, -20), (-10, 10, 20), (0, 3999, -1), (1500, -2400, 100), (5, 5, 0)],
)
def test_differences_are_wrapped(core: Core, config: Any, previous: int, count: int, moved: int) -> None:
    assert core.lib.encoder_difference(config, count & 0xFFFF, previous & 0xFFFF) == moved


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("stride", [1, 7, 166, 1999])
def test_turns_in_both_directions(core: Core, config: Any, direction: int, stride: int) -> None:
    encoder = Encoder(core, config)
    for _ in range(3 * COUNTS // stride):
        assert encoder.update(direction * stride)
        assert encoder.c.position == encoder.timer.shaft
    assert encoder.c.turns == int(encoder.timer.shaft / COUNTS)


def test_wrap_in_one_sample(core: Core, config: Any) -> None:
    """ENC(k) - ENC(k-1) = -3980 has the wrong sign; the shaft has moved by +20 and into its next turn."""
    encoder = Encoder(core, config)
    encoder.update(1995)
    encoder.update(1995)
    assert encoder.update(20)
    assert encoder.timer.count == 10
    assert (encoder.c.turns, encoder.c.position) == (1, 4010)


def test_touch_and_turn_back(core: Core, config: Any) -> None:
    """The index pulse comes with the compare value, one count before the reload: a shaft that turns back there has
    not begun a new turn, and the next wrap, downwards, counts one down."""
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
    assert encoder.timer.index == 2  # at -3999 minus the turn that went by
    assert encoder.update(-1)
    assert encoder.c.position == encoder.timer.shaft


def test_dithering_on_the_compare_value(core: Core, config: Any) -> None:
    encoder = Encoder(core, config)
    encoder.update(1999)
    encoder.update(1999)
    for k in range(400):
        assert encoder.update((1, 1, -1, -1, 1, -1, 2, -2, 3, -3)[k % 10])
        assert encoder.c.position == encoder.timer.shaft


@pytest.mark.parametrize("direction", [1, -1])
def test_missing_index_pulse_is_found_at_the_wrap(core: Core, config: Any, direction: int) -> None:
    encoder = Encoder(core, config)
    encoder.timer.index_works = False
    results = [encoder.update(direction * 100) for _ in range(39)]
    assert all(results)
    assert not encoder.update(direction * 100)


def test_stale_pulse_does_not_hide_a_missing_one(core: Core, config: Any) -> None:
    """Touch the compare value, turn back past half a turn, lose the pulse of the real wrap."""
    encoder = Encoder(core, config)
    encoder.update(1999)
    encoder.update(1999)
    encoder.update(1)
    encoder.update(-1999)
    encoder.update(-1000)
    encoder.timer.index_works = False
    encoder.update(1999)
    assert encoder.update(999)
    assert not encoder.update(100)


def test_resync_believes_the_differences(core: Core, config: Any) -> None:
    encoder = Encoder(core, config)
    encoder.timer.index_works = False
    for _ in range(41):
        encoder.update(100)
    assert not encoder.update(0)
    encoder.timer.index_works = True
    core.lib.encoder_resync(encoder.c, config)
    assert encoder.c.position == 4100
    for step in [1500] * 5 + [-1500] * 10:
        assert encoder.update(step)
    assert encoder.c.position == encoder.timer.shaft


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


def test_f27_by_turning_the_shaft(core: Core, config: Any) -> None:
    """The same places reached by motion: 1000 -> 2000 in the next turn, on to 2.. and back through zero."""
    encoder = Encoder(core, config, QuadTimer(count=1000))
    for _ in range(5):
        encoder.update(1000)
    assert (encoder.c.turns, encoder.timer.count) == (1, 2000)
    assert encoder.c.position / COUNTS == 1.25
    for _ in range(4):
        encoder.update(-1000)
    assert (encoder.c.turns, encoder.timer.count) == (1, -2000)
    assert encoder.c.position / COUNTS == 0.25


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
    """A new alignment writes the counter; turns and position survive it (E41)."""
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


def test_index_counter_wraps(core: Core, config: Any) -> None:
    timer = QuadTimer()
    timer.index = 0xFFFF
    encoder = Encoder(core, config, timer)
    for _ in range(10):
        assert encoder.update(1000)
    assert timer.index == 1
    assert encoder.c.position == 10000
