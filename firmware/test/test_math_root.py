"""Square root of 64 bits: the integer root, rounded down."""

from __future__ import annotations

import math

from core_library import Core
from exact import edges, near
from hypothesis import given, settings
from hypothesis import strategies as st

POWERS = near(*(2**n for n in range(2, 63)), 2**63, 2**64 - 3)


@given(x=st.one_of(edges(0, 2**64 - 1), POWERS, st.integers(0, 64).flatmap(lambda bits: st.integers(0, 2**bits - 1))))
@settings(max_examples=3000)
def test_exact_over_the_whole_range(core: Core, x: int) -> None:
    assert core.lib.u64_sqrt(x) == math.isqrt(x)


@given(root=st.one_of(edges(1, 2**32 - 1), near(*(2**n for n in range(2, 32)), 65535 << 16)))
@settings(max_examples=2000)
def test_squares_and_their_neighbours(core: Core, root: int) -> None:
    """The root is constant from a square to the number before the next square."""
    for x in (root * root, root * root + 2 * root):
        assert core.lib.u64_sqrt(x) == root
    assert core.lib.u64_sqrt(root * root - 1) == root - 1


@given(upper=st.integers(2**15, 2**16 - 1), rest=edges(-1, 2**16), low=edges(0, 2**32 - 1))
@settings(max_examples=2000)
def test_upper_half_next_to_a_square(core: Core, upper: int, rest: int, low: int) -> None:
    """The first half of the root has no remainder or the largest one."""
    for high in (upper * upper + rest, upper * upper + 2 * upper - rest):
        x = min(max(high, 0), 2**32 - 1) << 32 | low
        assert core.lib.u64_sqrt(x) == math.isqrt(x)
