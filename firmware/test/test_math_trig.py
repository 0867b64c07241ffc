"""Sine, cosine and square root: every angle, and roots over the whole range."""

from __future__ import annotations

from math import isqrt

import numpy as np
import pytest
from core_library import Core
from numpy.typing import NDArray

Waves = tuple[NDArray[np.int64], NDArray[np.int64]]


@pytest.fixture(scope="module")
def waves(core: Core) -> Waves:
    """Sine and cosine of angle raw values 0 .. 65535 (0x8000 is -pi)."""
    sines, cosines = np.zeros(65536, dtype=np.int16), np.zeros(65536, dtype=np.int16)
    core.lib.probe_sin_cos_all(core.ffi.from_buffer("int16_t[]", sines), core.ffi.from_buffer("int16_t[]", cosines))
    return sines.astype(np.int64), cosines.astype(np.int64)


def test_at_most_one_lsb_off_at_every_angle(waves: Waves) -> None:
    turn = 2.0 * np.pi * np.arange(65536) / 65536.0
    for wave, exact in zip(waves, (np.sin(turn), np.cos(turn)), strict=True):
        ideal = np.clip(exact * 32768.0, -32768.0, 32767.0)
        assert np.max(np.abs(wave - np.round(ideal))) <= 1, "more than one LSB off the nearest number"
        assert np.max(np.abs(wave - ideal)) < 1.01
        assert abs(np.mean(wave - ideal)) < 0.01


def test_agrees_with_integers_in_every_bit(waves: Waves) -> None:
    """A quarter wave of 257 nearest numbers (1.0 is 32767) with linear interpolation, halves upwards."""
    table = np.minimum(np.round(32768.0 * np.sin(np.pi / 2.0 * np.arange(257) / 256.0)), 32767).astype(np.int64)
    step, part = np.divmod(np.arange(16384), 64)
    quarter = np.append((table[step] * 64 + (table[step + 1] - table[step]) * part + 32) >> 6, 32767)
    half = np.concatenate([quarter[:-1], quarter[:0:-1]])
    sines = np.concatenate([half, -half])
    assert np.array_equal(waves[0], sines)
    assert np.array_equal(waves[1], np.roll(sines, -16384))


def test_sum_of_sine_and_cosine_fits_a_rotation(waves: Waves) -> None:
    """transforms.h adds two products in 32 bits: |sin| + |cos| must stay below 2 x 32767."""
    sines, cosines = waves
    assert np.max((np.abs(sines) + np.abs(cosines)) * 32768 + 0x4000) < 2**31


def test_root_is_rounded_down(core: Core) -> None:
    rng = np.random.default_rng(7)
    around = [2 * r * r + d for r in (1, 2, 3, 127, 128, 255, 256, 23170, 32766, 32767) for d in (-2, -1, 0, 1)]
    x = np.concatenate([[0, 1, 2, 3, 2**31 - 1, 2**31 - 2, -1, -(2**31)], around, rng.integers(0, 2**31, 20000)])
    x = np.concatenate([x, (2.0 ** rng.uniform(0, 31, 20000)).astype(np.int64)]).astype(np.int32)
    roots = np.zeros(x.size, dtype=np.int16)
    core.lib.probe_f16_sqrt_many(core.ffi.from_buffer("int32_t[]", x), core.ffi.from_buffer("int16_t[]", roots), x.size)
    expected = [isqrt(int(v) // 2) if v > 0 else 0 for v in x]
    assert roots.tolist() == expected


def test_every_root_at_and_below_its_square(core: Core) -> None:
    """All 32768 results: from 2 r^2 on it is r, just below r - 1."""
    roots = np.arange(32768, dtype=np.int64)
    for beside, expected in ((-1, roots - 1), (0, roots), (1, roots)):
        x = np.maximum(2 * roots * roots + beside, -1).astype(np.int32)
        result = np.zeros(roots.size, dtype=np.int16)
        core.lib.probe_f16_sqrt_many(
            core.ffi.from_buffer("int32_t[]", x), core.ffi.from_buffer("int16_t[]", result), roots.size
        )
        assert np.array_equal(result, np.maximum(expected, 0))
