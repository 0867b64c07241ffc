"""Path filter (DRM 2.6, E38..E40): S curves that end exactly on their target."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from hypothesis import given, settings
from hypothesis import strategies as st

ONE = 2**24  # one count
COUNTS_PER_TURN = 4000
SPEED_LIMIT = 200 * ONE  # counts per slow tick: 314 rad/s
OMEGAS = (1, 65, 1957, 3276, 16384)


class Path:
    """The C path with numbers in counts."""

    def __init__(self, core: Core, omega_n_ts: int, position: int = 0, step: int = 0) -> None:
        self._lib = core.lib
        self.omega = omega_n_ts
        self.c: Any = core.ffi.new("path_t *")
        self._lib.path_reset(self.c, position, step, omega_n_ts)

    def step(self, target: int, step_limit: int = SPEED_LIMIT) -> float:
        self._lib.path_step(self.c, target, step_limit, self.omega)
        return self.output

    @property
    def output(self) -> float:
        return float(self.c.output / ONE)

    @property
    def position(self) -> int:
        return int(self._lib.path_position(self.c))


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


@pytest.mark.parametrize("omega_n_ts", OMEGAS[1:])
def test_equals_e40_in_floating_point(core: Core, omega_n_ts: int) -> None:
    path, w = Path(core, omega_n_ts), omega_n_ts / 65536.0
    x = m = y = 0.0
    for k in range(4000):
        target = 50000 if k < 2500 else 20000
        x += min(max(target - x, -30.0), 30.0)
        m += w * (x - 2.0 * m - y)
        y += w * m
        assert path.step(target, 30 * ONE) == pytest.approx(y, abs=0.01)


def test_ramp_becomes_an_s_curve(core: Core) -> None:
    """F23, F24: the speed of the output has no steps and is never above that of the ramp."""
    path = Path(core, 3276)
    y = np.array([path.step(100_000, 100 * ONE) for _ in range(1500)])
    speed = np.diff(y, prepend=0.0)
    assert np.max(speed) <= 100.0 + 1e-3
    assert np.max(speed) > 99.9
    assert np.min(speed) >= -1e-6
    assert np.max(np.abs(np.diff(speed, prepend=0.0))) < 100.0 * 3276 / 65536 * 1.05  # a v omega_n at most
    assert path.position == 100_000


@given(
    start=st.integers(-(2**30), 2**30),
    distance=st.integers(-20000, 20000),
    limit=st.integers(ONE // 8, SPEED_LIMIT),
    omega_n_ts=st.sampled_from(OMEGAS[2:]),
)
@settings(max_examples=60)
def test_ends_exactly_on_target_without_overshoot(
    core: Core, start: int, distance: int, limit: int, omega_n_ts: int
) -> None:
    path, target = Path(core, omega_n_ts, start), start + distance
    limit = max(limit, abs(distance) * ONE // 1500)
    furthest = 0.0
    for _ in range(2500 + 30 * 65536 // omega_n_ts):
        path.step(target, limit)
        beyond = (path.c.output - target * ONE) / ONE * (1 if distance >= 0 else -1)
        furthest = max(furthest, beyond)
    assert path.position == target
    assert abs(path.c.output - target * ONE) <= ONE // 256
    assert furthest <= 1.0 / 256.0


def test_100_turns(core: Core) -> None:
    path, target = Path(core, 1957), 100 * COUNTS_PER_TURN
    for _ in range(target // 200 + 1000):
        path.step(target)
    assert path.position == target
    for _ in range(target // 200 + 1000):
        path.step(-target)
    for _ in range(target // 200 + 1000):
        path.step(-target)
    assert path.position == -target


def test_slow_filter_carries_enough_bits(core: Core) -> None:
    """omega_n = 2 rad/s: with 16 fraction bits it would stop counts short of the target."""
    path = Path(core, 65)
    for _ in range(30000):
        path.step(1000)
    assert path.position == 1000


@pytest.mark.parametrize("omega_n_ts", OMEGAS)
@pytest.mark.parametrize("position", [0, 12345, -(2**31), 2**31 - 1, -954929659, 954929659])
def test_standing_start_stays(core: Core, omega_n_ts: int, position: int) -> None:
    path = Path(core, omega_n_ts, position)
    assert path.position == position
    for _ in range(50):
        path.step(position)
    assert path.position == position
    assert core.lib.path_at_rest(path.c, position)


@pytest.mark.parametrize("step", [150 * ONE, -150 * ONE, ONE // 3])
@pytest.mark.parametrize("omega_n_ts", OMEGAS[1:])
def test_moving_start_is_bumpless(core: Core, step: int, omega_n_ts: int) -> None:
    """Taken over at speed, the output goes on at that speed from the first tick."""
    path = Path(core, omega_n_ts, 5000, step)
    far, previous = (10**9 if step > 0 else -(10**9)), 5000.0
    for _ in range(300):
        now = path.step(far, abs(step))
        assert now - previous == pytest.approx(step / ONE, rel=1e-4)
        previous = now


def test_rest_is_told_only_at_rest(core: Core) -> None:
    path = Path(core, 3276)
    told = []
    for _ in range(400):
        path.step(3000, 100 * ONE)
        told.append(bool(core.lib.path_at_rest(path.c, 3000)))
        if told[-1]:
            assert path.position == 3000
    assert not any(told[:30])
    assert all(told[300:])
    assert not core.lib.path_at_rest(path.c, 3001)


def test_rounding_to_counts(core: Core) -> None:
    path = core.ffi.new("path_t *")
    for counts, expected in ((0.49, 0), (0.5, 1), (-0.5, 0), (-0.51, -1), (-1.5, -1), (7.25, 7)):
        path.output = round(counts * ONE)
        assert core.lib.path_position(path) == expected
