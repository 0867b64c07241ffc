"""Friction compensation against its formula in floating point, for all speeds and plausible nominal values."""

from __future__ import annotations

import pytest
from core_library import Core
from exact import FRACTION32, I32, clip16, clip32, edges, times_gain
from hypothesis import given, settings
from hypothesis import strategies as st

FULL = 2**31
GAIN = 2**24


def current(core: Core, coulomb: int, viscous: int, smooth: int, speed: int) -> int:
    config = core.ffi.new("friction_config_t *")
    config.coulomb, config.viscous, config.smooth = coulomb, viscous, smooth
    config.slope = min(round(FULL / smooth * 2**16), 2**31 - 1)
    return int(core.lib.friction_current(config, speed))


def formula(coulomb: int, viscous: int, smooth: int, speed: int) -> float:
    x = max(-1.0, min(1.0, speed / smooth))
    exact = coulomb * 0.5 * x * (3.0 - x * x) + speed * viscous / GAIN
    return max(-float(FULL), min(FULL - 1.0, exact))


@given(
    coulomb=st.integers(0, FULL - 1),
    viscous=st.integers(0, 2**31 - 1),
    smooth=st.integers(2**17, FULL - 1),
    part=st.floats(-3.0, 3.0),
)
def test_compensation_agrees_with_the_formula(core: Core, coulomb: int, viscous: int, smooth: int, part: float) -> None:
    """Within 3 of 2^15 of the Coulomb current: the sign is computed with 15 bits, and rounded three times."""
    speed = max(-FULL, min(FULL - 1, round(part * smooth)))
    raw = current(core, coulomb, viscous, smooth, speed)
    assert abs(raw - formula(coulomb, viscous, smooth, speed)) <= 3.0 * coulomb / 2**15 + 2.0


def in_integers(coulomb: int, viscous: int, smooth: int, slope: int, speed: int) -> int:
    """The sign in 15 bits: ratio to `smooth`, its square, the cubic and the product are truncated."""
    magnitude = min(abs(speed), FULL - 1)
    x = clip16(magnitude * slope >> 32)
    sign = 2**15 if magnitude >= smooth else x * (3 * 2**15 - (x * x >> 15)) >> 16
    part = coulomb * sign >> 15
    return clip32(times_gain(speed, viscous) + (-part if speed < 0 else part))


@given(coulomb=FRACTION32, viscous=I32, smooth=edges(2**17, FULL - 1), speed=I32, part=st.floats(-1.1, 1.1))
@settings(max_examples=300)
def test_agrees_with_integers_in_every_bit(
    core: Core, coulomb: int, viscous: int, smooth: int, speed: int, part: float
) -> None:
    """Over the whole range, on both sides of `smooth`, saturation included."""
    slope = min(round(FULL / smooth * 2**16), 2**31 - 1)
    for at in (speed, clip32(round(part * smooth)), smooth - 1, smooth, -smooth, 1 - smooth):
        expected = in_integers(coulomb, viscous, smooth, slope, at)
        assert current(core, coulomb, viscous, smooth, at) == expected


@given(coulomb=st.integers(0, FULL - 1), smooth=st.integers(2**17, FULL - 1), speed=st.integers(0, FULL - 1))
def test_both_directions_are_symmetrical(core: Core, coulomb: int, smooth: int, speed: int) -> None:
    """Both directions agree in every bit."""
    forward, back = current(core, coulomb, 0, smooth, speed), current(core, coulomb, 0, smooth, -speed)
    assert forward == -back >= 0


@given(smooth=st.integers(2**17, 2**28), first=st.integers(0, 2**28), second=st.integers(0, 2**28))
def test_compensation_increases_with_the_speed(core: Core, smooth: int, first: int, second: int) -> None:
    low, high = sorted((first, second))
    assert current(core, 2**28, 2**20, smooth, low) <= current(core, 2**28, 2**20, smooth, high)


@pytest.mark.parametrize("speed", [0, 1, -1, FULL - 1, -FULL, 2**22 - 1, 2**22, -(2**22)])
def test_compensation_at_the_ends_of_the_ranges(core: Core, speed: int) -> None:
    """Zero at rest, full friction from `smooth` on, saturation instead of a wrap."""
    raw = current(core, FULL - 1, 0, 2**22, speed)
    sign = (speed > 0) - (speed < 0)
    if abs(speed) >= 2**22:
        assert raw == sign * (FULL - 1)
    else:
        assert raw == pytest.approx(formula(FULL - 1, 0, 2**22, speed), abs=3 * 2**16 + 2)
    full = current(core, FULL - 1, 2**31 - 1, 2**22, speed)
    assert -FULL <= full <= FULL - 1
    if abs(speed) >= 2**22:
        assert full == (FULL - 1 if sign > 0 else -FULL)
