"""Clarke and Park transforms (DRM E2..E7, E16) against exact formulas, and their inverses."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from core_library import Core
from exact import I16, MAX16, MIN16
from hypothesis import given
from numpy.typing import NDArray


def clip(x: float) -> float:
    return min(max(x, MIN16), MAX16)


def clarke_of(core: Core, phases: NDArray[np.int64]) -> NDArray[np.int64]:
    x, result = phases.astype(np.int32), np.zeros((len(phases), 2), dtype=np.int16)
    core.lib.probe_clarke_many(core.ffi.from_buffer("abc_t[]", x), core.ffi.from_buffer("ab_t[]", result), len(x))
    return result.astype(np.int64)


def test_alpha_is_the_nearest_number_for_every_sum(core: Core) -> None:
    """E6 depends on 2 a - b - c alone: all 262141 values of it, half an LSB, saturated."""
    total = np.arange(2 * MIN16 - 2 * MAX16, 2 * MAX16 - 2 * MIN16 + 1)
    a = total // 4
    rest = 2 * a - total
    phases = np.stack([a, rest // 2, rest - rest // 2], axis=1)
    assert phases.min() == MIN16
    assert phases.max() == MAX16
    expected = np.clip((2 * total + 3) // 6, MIN16, MAX16)
    assert np.array_equal(clarke_of(core, phases)[:, 0], expected)


def test_beta_is_the_nearest_number_for_every_difference(core: Core) -> None:
    """E7 depends on b - c alone: all 131071 values of it, half an LSB, saturated."""
    difference = np.arange(MIN16 - MAX16, MAX16 - MIN16 + 1)
    b = difference // 2
    phases = np.stack([np.full_like(b, MIN16), b, b - difference], axis=1)
    # No multiple of 1/sqrt(3) comes closer than 2e-6 to a half: a double tells which number is nearest.
    expected = np.clip(np.floor(difference / math.sqrt(3.0) + 0.5), MIN16, MAX16)
    assert np.array_equal(clarke_of(core, phases)[:, 1], expected)


@given(a=I16, b=I16, c=I16)
def test_clarke_is_e6_and_e7(core: Core, a: int, b: int, c: int) -> None:
    x = core.lib.clarke({"a": a, "b": b, "c": c})
    assert abs(x.alpha - clip(float(Fraction(2 * a - b - c, 3)))) <= 0.5 + 1e-4
    assert abs(x.beta - clip((b - c) / math.sqrt(3.0))) <= 0.5 + 1e-4


def rotations() -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Vectors and angles: the whole range, and its corners at every 16th angle."""
    rng = np.random.default_rng(11)
    anywhere = rng.integers(MIN16, MAX16 + 1, (100_000, 2))
    corners = np.array([(x, y) for x in (MIN16, MIN16 + 1, 0, MAX16) for y in (MIN16, MIN16 + 1, 0, MAX16)])
    turn = np.arange(MIN16, MAX16 + 1, 16)
    vectors = np.concatenate([anywhere, np.tile(corners, (len(turn), 1))]).astype(np.int16)
    angles = np.concatenate([rng.integers(MIN16, MAX16 + 1, 100_000), np.repeat(turn, len(corners))]).astype(np.int16)
    return vectors, angles


def rotated(core: Core, inverse: bool) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Input vectors, angles, and results of one of the two transforms."""
    vectors, angles = rotations()
    result = np.zeros_like(vectors)
    into, out, function = (
        ("dq_t[]", "ab_t[]", core.lib.probe_park_inverse_many)
        if inverse
        else ("ab_t[]", "dq_t[]", core.lib.probe_park_many)
    )
    buffer = core.ffi.from_buffer
    function(buffer(into, vectors), buffer("int16_t[]", angles), buffer(out, result), len(angles))
    return vectors.astype(np.int64), angles.astype(np.int64), result.astype(np.int64)


@pytest.mark.parametrize("inverse", [False, True])
def test_rotation_is_rounded_once(core: Core, inverse: bool) -> None:
    """With the sine and cosine of the firmware: nearest number, halves upwards, saturated; at most 0.5 LSB off."""
    vectors, angles, result = rotated(core, inverse)
    sines, cosines = np.zeros(65536, dtype=np.int16), np.zeros(65536, dtype=np.int16)
    core.lib.probe_sin_cos_all(core.ffi.from_buffer("int16_t[]", sines), core.ffi.from_buffer("int16_t[]", cosines))
    s, c = sines.astype(np.int64)[angles], cosines.astype(np.int64)[angles]
    x, y = vectors.T
    direction = -1 if inverse else 1
    exact = np.stack([x * c + direction * y * s, y * c - direction * x * s], axis=1)
    assert np.array_equal(result, np.clip((exact + 2**14) >> 15, MIN16, MAX16))


@pytest.mark.parametrize("inverse", [False, True])
def test_rotation_is_within_2_52_lsb_of_the_exact_one(core: Core, inverse: bool) -> None:
    """E16, e^(-j theta) and e^(j theta): 1.01 LSB of the sine, 1.01 LSB of the cosine, 0.5 LSB of the rounding."""
    vectors, angles, result = rotated(core, inverse)
    z = (vectors[:, 0] + 1j * vectors[:, 1]) * np.exp((1j if inverse else -1j) * np.pi * angles / 32768.0)
    exact = np.clip(np.stack([z.real, z.imag], axis=1), MIN16, MAX16)
    assert np.max(np.abs(result - exact)) <= 2.52
