"""Division of 64 by 16 bits gives the quotient of the C operator."""

from __future__ import annotations

from core_library import Core
from exact import edges, towards_zero
from hypothesis import given, settings

I64 = edges(1 - 2**63, 2**63 - 1)
DIVISOR = edges(1, 2**16 - 1)


@given(x=I64, divisor=DIVISOR)
@settings(max_examples=1000)
def test_exact_over_the_whole_range(core: Core, x: int, divisor: int) -> None:
    assert core.lib.i64_over_u16(x, divisor) == towards_zero(x, divisor)


@given(quotient=edges(-(2**47), 2**47 - 1), divisor=DIVISOR)
def test_products_divide_without_remainder_and_their_neighbours_do_not(core: Core, quotient: int, divisor: int) -> None:
    for near in (-1, 0, 1):
        x = quotient * divisor + near
        assert core.lib.i64_over_u16(x, divisor) == towards_zero(x, divisor)
