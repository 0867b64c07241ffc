"""Space-vector modulation: the eight states of T3, the times of E28..E30, and the voltage that comes out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from hypothesis import given
from hypothesis import strategies as st

FULL = 32767
SQRT3 = math.sqrt(3.0)
I16 = st.one_of(st.sampled_from([-32768, -32767, -1, 0, 1, 16384, 28378, 32767]), st.integers(-32768, 32767))

# T3 with spec's corrections: state of the legs a b c, angle of the vector in degrees.
ACTIVE = [
    ((1, 0, 0), 0),
    ((1, 1, 0), 60),
    ((0, 1, 0), 120),
    ((0, 1, 1), 180),
    ((0, 0, 1), 240),
    ((1, 0, 1), 300),
]


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


def duties(core: Core, alpha: int, beta: int) -> tuple[tuple[int, int, int], int]:
    result = core.lib.svm({"alpha": alpha, "beta": beta})
    return (result.duty.a, result.duty.b, result.duty.c), result.sector


def vector(length: float, degrees: float) -> tuple[int, int]:
    x = [round(32768 * length * f(math.radians(degrees))) for f in (math.cos, math.sin)]
    return (min(max(x[0], -32768), 32767), min(max(x[1], -32768), 32767))


def voltage(duty: tuple[int, int, int]) -> complex:
    """Mean space vector over 2/3 u_dc that three high-side duties give (E2)."""
    a = complex(-0.5, SQRT3 / 2.0)
    return sum(d / FULL * a**k for k, d in enumerate(duty))


@pytest.mark.parametrize(("legs", "degrees"), ACTIVE)
def test_active_states(core: Core, legs: tuple[int, int, int], degrees: int) -> None:
    duty, _ = duties(core, *vector(1.0, degrees))
    assert duty == pytest.approx([FULL * leg for leg in legs], abs=2)


@pytest.mark.parametrize(("legs", "degrees"), ACTIVE)
def test_phase_and_line_voltages_of_t3(core: Core, legs: tuple[int, int, int], degrees: int) -> None:
    duty, _ = duties(core, *vector(1.0, degrees))
    a, b, c = (d / FULL for d in duty)
    mean = sum(legs) / 3.0
    assert (a - (a + b + c) / 3.0) == pytest.approx(legs[0] - mean, abs=1e-4)  # U_a in u_dc
    assert (a - b, b - c, c - a) == pytest.approx((legs[0] - legs[1], legs[1] - legs[2], legs[2] - legs[0]), abs=1e-4)


def test_zero_vector_shares_its_time_between_000_and_111(core: Core) -> None:
    duty, _ = duties(core, 0, 0)
    assert duty[0] == duty[1] == duty[2]
    assert duty[0] == pytest.approx(FULL / 2, abs=1)


@pytest.mark.parametrize("sector", range(1, 7))
def test_sectors_are_numbered_from_zero_degrees(core: Core, sector: int) -> None:
    for inside in (1.0, 30.0, 59.0):
        assert duties(core, *vector(0.5, 60.0 * (sector - 1) + inside))[1] == sector


def test_times_of_e28_to_e30(core: Core) -> None:
    """T1, T2 from the projection on the two neighbours, T0 shared: duties of the three legs, within 2 LSB."""
    rng = np.random.default_rng(3)
    for length, degrees in zip(rng.uniform(0.0, SQRT3 / 2.0, 3000), rng.uniform(0.0, 360.0, 3000), strict=True):
        alpha, beta = vector(length, degrees)
        sector = int(degrees // 60)
        rest = math.radians(degrees - 60 * sector)
        t1 = length * math.sin(math.pi / 3.0 - rest) * 2.0 / SQRT3  # on U_x
        t2 = length * math.sin(rest) * 2.0 / SQRT3  # on U_(x+60)
        t0 = 1.0 - t1 - t2
        first, second = ACTIVE[sector][0], ACTIVE[(sector + 1) % 6][0]
        expected = [FULL * (t0 / 2.0 + t1 * x + t2 * y) for x, y in zip(first, second, strict=True)]
        assert duties(core, alpha, beta)[0] == pytest.approx(expected, abs=2.5), (length, degrees)


@given(alpha=I16, beta=I16)
def test_result_is_the_wanted_vector_or_the_longest_in_its_direction(core: Core, alpha: int, beta: int) -> None:
    duty, _ = duties(core, alpha, beta)
    assert all(0 <= d <= FULL for d in duty)
    wanted = complex(alpha, beta) / 32768.0
    got = voltage(duty)
    angle = math.atan2(beta, alpha) % (math.pi / 3.0)
    edge = SQRT3 / 2.0 / math.cos(angle - math.pi / 6.0)  # the hexagon's side in this direction
    expected = wanted if abs(wanted) <= edge else wanted / abs(wanted) * edge
    assert abs(got - expected) <= 3e-4


@given(alpha=I16, beta=I16)
def test_pulses_are_centred(core: Core, alpha: int, beta: int) -> None:
    """The zero time before the first and after the last switching is the same: most + least = 100 %."""
    duty, _ = duties(core, alpha, beta)
    assert abs(max(duty) + min(duty) - FULL) <= 1


def test_opposite_vectors_are_mirrored(core: Core) -> None:
    for degrees in range(0, 360, 7):
        plus, _ = duties(core, *vector(0.7, degrees))
        minus, _ = duties(core, *vector(-0.7, degrees))
        assert plus == pytest.approx([FULL - d for d in minus], abs=3)


def test_duties_are_continuous_over_a_turn(core: Core) -> None:
    """No jump at a sector border: at most what the vector itself moves, and two LSB."""
    degrees = np.arange(0.0, 360.5, 0.05)
    inputs = core.ffi.new("ab_t[]", [vector(0.86, d) for d in degrees])
    results = core.ffi.new("svm_t[]", len(degrees))
    core.lib.probe_svm_many(inputs, results, len(degrees))
    duty = np.array([(r.duty.a, r.duty.b, r.duty.c) for r in results])
    assert np.max(np.abs(np.diff(duty, axis=0))) <= 0.86 * 32768 * math.radians(0.05) * 2.0 / SQRT3 + 4
