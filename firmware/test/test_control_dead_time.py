"""Compensation of dead time and switch drops: every bit, and the voltage of the formula."""

from __future__ import annotations

from typing import Any

from core_library import Core
from exact import FRACTION16, I16, MAX16, clip, clip16, edges, nearest, product
from hypothesis import example, given, settings
from hypothesis import strategies as st

BUS_MIN = 8192
SLOPE_ONE = 2**8
BUS = edges(BUS_MIN, MAX16)


def compensated(core: Core, config: tuple[int, int, int], duty: list[int], current: list[int], bus: int) -> list[int]:
    """Duties of the three phases; `config` is dead time, drop, slope."""
    c: Any = core.ffi.new("dead_time_config_t *", config)
    x = core.lib.dead_time_compensate(c, duty, current, 2**29 // bus)
    return [x.a, x.b, x.c]


@given(
    config=st.tuples(I16, I16, I16),
    duty=st.tuples(I16, FRACTION16, edges(MAX16 - 40, MAX16)),
    current=st.tuples(I16, I16, I16),
    bus=BUS,
)
@example(config=(0, 4096, 4 * SLOPE_ONE), duty=(1, 16384, MAX16), current=(MAX16, -1, 1), bus=16385)  # a half, upwards
@settings(max_examples=300)
def test_agrees_with_integers_in_every_bit(
    core: Core, config: tuple[int, int, int], duty: tuple[int, ...], current: tuple[int, ...], bus: int
) -> None:
    """Drop over bus rounded to an LSB, sign of the current downwards, their product rounded; duties in 0..100 %."""
    dead_time, v_drop, slope = config
    loss = clip16(dead_time + clip16(nearest(v_drop * (2**29 // bus), 2**14)))
    expected = []
    for d, i in zip(duty, current, strict=True):
        sign = clip16(i * slope // SLOPE_ONE)
        expected.append(clip(d + product(loss, sign), 0, MAX16) if 0 < d < MAX16 else d)
    assert compensated(core, config, list(duty), list(current), bus) == expected


@given(
    dead_time=st.integers(0, 3276),
    v_drop=st.integers(0, 3276),
    slope=st.integers(0, 127 * SLOPE_ONE),
    duty=st.integers(1, MAX16 - 1),
    current=I16,
    bus=BUS,
)
@settings(max_examples=300)
def test_compensation_follows_the_formula_within_1_8_lsb(
    core: Core, dead_time: int, v_drop: int, slope: int, duty: int, current: int, bus: int
) -> None:
    """(t_d f + V_drop / u_dc) times the softened sign, in reals: at most 1.8 LSB off.

    Half an LSB each for drop over bus and product, one for the sign times a loss of at most a half, and up to 0.2 for
    the truncated reciprocal of the bus.
    """
    sign = max(-1.0, min(1.0, current / 2**15 * slope / SLOPE_ONE))
    exact = duty + (dead_time + v_drop / bus * 2**15) * sign
    out = compensated(core, (dead_time, v_drop, slope), [duty] * 3, [current] * 3, bus)
    assert out[0] == out[1] == out[2]
    assert abs(out[0] - max(0.0, min(float(MAX16), exact))) <= 1.8


@given(config=st.tuples(FRACTION16, FRACTION16, I16), current=st.tuples(I16, I16, I16), bus=BUS)
def test_a_leg_that_does_not_switch_is_left_alone(
    core: Core, config: tuple[int, int, int], current: tuple[int, ...], bus: int
) -> None:
    assert compensated(core, config, [0, MAX16, 0], list(current), bus) == [0, MAX16, 0]
