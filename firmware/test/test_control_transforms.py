"""Clarke and Park transforms (DRM E2..E7, E16) against exact formulas, and there and back."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from hypothesis import assume, given
from hypothesis import strategies as st

MIN16, MAX16 = -(2**15), 2**15 - 1
I16 = st.one_of(st.sampled_from([MIN16, MIN16 + 1, -1, 0, 1, MAX16]), st.integers(MIN16, MAX16))
ANGLE = st.integers(MIN16, MAX16)


def clip(x: float) -> float:
    return min(max(x, MIN16), MAX16)


def radians(angle: int) -> float:
    return angle * math.pi / 32768.0


@pytest.fixture(scope="module")
def core(compile_c: CompileC) -> Core:
    return load_core(compile_c)


def park(core: Core, alpha: int, beta: int, angle: int) -> tuple[int, int]:
    x = core.lib.park({"alpha": alpha, "beta": beta}, core.lib.sin_cos(angle))
    return x.d, x.q


def park_inverse(core: Core, d: int, q: int, angle: int) -> tuple[int, int]:
    x = core.lib.park_inverse({"d": d, "q": q}, core.lib.sin_cos(angle))
    return x.alpha, x.beta


@given(a=I16, b=I16, c=I16)
def test_clarke_is_e6_and_e7(core: Core, a: int, b: int, c: int) -> None:
    x = core.lib.clarke({"a": a, "b": b, "c": c})
    assert abs(x.alpha - clip(float(Fraction(2 * a - b - c, 3)))) <= 0.5 + 1e-4
    assert abs(x.beta - clip((b - c) / math.sqrt(3.0))) <= 0.5 + 1e-4


def test_clarke_of_a_balanced_system_keeps_the_amplitude(core: Core) -> None:
    """k = 2/3: a space vector is as long as the phase amplitude, and its angle is that of phase a."""
    for degrees in range(0, 360, 5):
        theta = math.radians(degrees)
        phases = [round(30000 * math.cos(theta - k * 2.0 * math.pi / 3.0)) for k in range(3)]
        x = core.lib.clarke(dict(zip("abc", phases, strict=True)))
        assert x.alpha == pytest.approx(30000 * math.cos(theta), abs=1.5)
        assert x.beta == pytest.approx(30000 * math.sin(theta), abs=1.5)


def test_common_mode_is_not_seen(core: Core) -> None:
    x = core.lib.clarke({"a": 20000, "b": 20000, "c": 20000})
    assert (x.alpha, x.beta) == (0, 0)


@given(alpha=I16, beta=I16, angle=ANGLE)
def test_park_rotates_into_the_rotor_frame(core: Core, alpha: int, beta: int, angle: int) -> None:
    """E16: i e^(-j theta). One LSB of sine and cosine, half of one for the rounding."""
    d, q = park(core, alpha, beta, angle)
    s, c = math.sin(radians(angle)), math.cos(radians(angle))
    assert abs(d - clip(alpha * c + beta * s)) <= 2.6
    assert abs(q - clip(beta * c - alpha * s)) <= 2.6


@given(d=I16, q=I16, angle=ANGLE)
def test_park_inverse_rotates_back(core: Core, d: int, q: int, angle: int) -> None:
    alpha, beta = park_inverse(core, d, q, angle)
    s, c = math.sin(radians(angle)), math.cos(radians(angle))
    assert abs(alpha - clip(d * c - q * s)) <= 2.6
    assert abs(beta - clip(q * c + d * s)) <= 2.6


@given(d=I16, q=I16, angle=ANGLE)
def test_there_and_back(core: Core, d: int, q: int, angle: int) -> None:
    assume(math.hypot(d, q) <= 32760)
    back = park(core, *park_inverse(core, d, q, angle), angle)
    assert abs(back[0] - d) <= 4
    assert abs(back[1] - q) <= 4


def test_a_vector_on_the_rotor_axis_is_pure_d(core: Core) -> None:
    for angle in range(MIN16, MAX16, 997):
        alpha = round(20000 * math.cos(radians(angle)))
        beta = round(20000 * math.sin(radians(angle)))
        d, q = park(core, alpha, beta, angle)
        assert abs(d - 20000) <= 2
        assert abs(q) <= 2
