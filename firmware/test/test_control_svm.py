"""Space-vector modulation: the eight states of T3, the times of E28..E30, and the resulting voltage."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from core_library import Core
from exact import I16, MAX16, MIN16, nearest, towards_zero
from hypothesis import example, given

FULL = 32767
SQRT3 = math.sqrt(3.0)

# T3, corrected (011 is U180, 001 U240, 101 U300): state of the legs a b c, angle of the vector in degrees.
ACTIVE = [
    ((1, 0, 0), 0),
    ((1, 1, 0), 60),
    ((0, 1, 0), 120),
    ((0, 1, 1), 180),
    ((0, 0, 1), 240),
    ((1, 0, 1), 300),
]


ONE_BY_SQRT3 = 18919  # 15 fraction bits


def duties(core: Core, alpha: int, beta: int) -> tuple[tuple[int, int, int], int]:
    result = core.lib.svm({"alpha": alpha, "beta": beta})
    return (result.duty.a, result.duty.b, result.duty.c), result.sector


def vector(length: float, degrees: float) -> tuple[int, int]:
    x = [round(32768 * length * f(math.radians(degrees))) for f in (math.cos, math.sin)]
    return (min(max(x[0], -32768), 32767), min(max(x[1], -32768), 32767))


def voltage(duty: tuple[int, int, int]) -> complex:
    """Mean space vector of three high-side duties, relative to 2/3 u_dc (E2)."""
    a = complex(-0.5, SQRT3 / 2.0)
    return sum(d / FULL * a**k for k, d in enumerate(duty))


def in_integers(alpha: int, beta: int) -> tuple[tuple[int, int, int], int]:
    """E28..E30 and T3 with the roundings of svm.h: beta / sqrt(3) once, the shortening towards zero."""
    third = nearest(beta * ONE_BY_SQRT3, 2**15)
    x, y, z = 2 * third, third + alpha, third - alpha
    above = [z < 0, y >= 0, True] if x >= 0 else [z >= 0, y < 0, True]
    sector = above.index(True) + (1 if x >= 0 else 4)
    first, second = [(-z, x), (y, z), (x, -y), (z, -x), (-y, -z), (-x, y)][sector - 1]  # on U_x and U_(x+60)
    active = first + second
    if active > FULL:
        single = towards_zero((first if sector % 2 else second) * FULL, active)  # the vector with one high side
        first, second = (single, FULL - single) if sector % 2 else (FULL - single, single)
    zero = (FULL - first - second) // 2
    legs = zip(ACTIVE[sector - 1][0], ACTIVE[sector % 6][0], strict=True)
    a, b, c = (zero + first * one + second * other for one, other in legs)
    return (a, b, c), sector


@given(alpha=I16, beta=I16)
@example(alpha=0, beta=16384)  # the only exact halves in the rounding of beta / sqrt(3)
@example(alpha=0, beta=-16384)
@example(alpha=MIN16, beta=MIN16)
@example(alpha=MIN16, beta=MAX16)
def test_agrees_with_integers_in_every_bit(core: Core, alpha: int, beta: int) -> None:
    assert duties(core, alpha, beta) == in_integers(alpha, beta)


def test_every_bit_on_and_beside_the_borders(core: Core) -> None:
    """Both sides of each of the six sector borders, and of the edge of the hexagon."""
    for length in (0.0, 0.001, 0.3, 0.5, SQRT3 / 2.0, 0.99999, 1.0, 1.2):
        for degrees in range(0, 360, 30):
            alpha, beta = vector(length, degrees)
            for a in range(max(alpha - 2, MIN16), min(alpha + 3, MAX16 + 1)):
                for b in range(max(beta - 2, MIN16), min(beta + 3, MAX16 + 1)):
                    assert duties(core, a, b) == in_integers(a, b), (a, b)


def test_at_most_2_3_lsb_off_over_the_whole_range(core: Core) -> None:
    """Exact duties for 300000 vectors, inside the hexagon and shortened to its edge.

    Errors: beta / sqrt(3) in 15 bits (0.9 LSB, 1.5 times), half the zero time, 100 % is 32767.
    """
    rng = np.random.default_rng(17)
    inside = rng.uniform(-SQRT3 / 2.0, SQRT3 / 2.0, (150_000, 2)) * 32768.0
    x = np.concatenate([inside, rng.integers(MIN16, MAX16 + 1, (150_000, 2))]).astype(np.int16)
    result = core.ffi.new("svm_t[]", len(x))
    core.lib.probe_svm_many(core.ffi.from_buffer("ab_t[]", x), result, len(x))
    words = np.array([(r.duty.a, r.duty.b, r.duty.c, r.sector) for r in result])
    vectors = (x[:, 0] + 1j * x[:, 1]) / 32768.0
    edge = SQRT3 / 2.0 / np.cos(np.angle(vectors) % (np.pi / 3.0) - np.pi / 6.0)
    vectors *= np.minimum(1.0, edge / np.maximum(np.abs(vectors), 1e-9))
    phases = 2.0 / 3.0 * np.stack([(vectors * np.exp(-2j * np.pi / 3.0 * k)).real for k in range(3)], axis=1)
    centre = (phases.max(axis=1) + phases.min(axis=1)) / 2.0
    expected = FULL * (0.5 + phases - centre[:, np.newaxis])
    assert np.max(np.abs(words[:, :3] - expected)) <= 2.3
    inner = np.abs(np.angle(vectors) % (np.pi / 3.0) - np.pi / 6.0) < np.pi / 6.0 - 1e-3
    inner &= np.abs(vectors) > 0.05
    assert np.array_equal(words[inner, 3], 1 + np.angle(vectors[inner]) % (2.0 * np.pi) // (np.pi / 3.0))


def half_period(duty: tuple[int, int, int]) -> dict[tuple[int, ...], int]:
    """States of the legs from the low-side centre to the high-side centre, with their durations."""
    switching = sorted({0, *(FULL - d for d in duty), FULL})
    return {tuple(int(begin >= FULL - d) for d in duty): end - begin for begin, end in itertools.pairwise(switching)}


def test_the_eight_states_of_t3_occur(core: Core) -> None:
    """Every sector: 000, its two active vectors, 111; T1 and T2 of E28, E29, and the same share of T0 at both ends."""
    seen: set[tuple[int, ...]] = set()
    for sector in range(6):
        duty, _ = duties(core, *vector(0.5, 60.0 * sector + 30.0))
        times = half_period(duty)
        zero = [times[0, 0, 0], times[1, 1, 1]]
        active = [times[ACTIVE[sector][0]], times[ACTIVE[(sector + 1) % 6][0]]]
        assert len(times) == 4
        assert active == pytest.approx([FULL * 0.5 / SQRT3] * 2, abs=2)
        assert zero == pytest.approx([FULL * (1.0 - 1.0 / SQRT3) / 2.0] * 2, abs=2)
        seen.update(times)
    assert seen == {(0, 0, 0), (1, 1, 1), *(legs for legs, _ in ACTIVE)}
