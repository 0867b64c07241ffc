"""Tables as plain text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_msgs_py.table_text import aligned

CELL = st.text("abc-1", max_size=6)


@given(rows=st.integers(1, 4).flatmap(lambda width: st.lists(st.lists(CELL, min_size=width, max_size=width))))
def test_every_cell_is_in_its_column(rows: list[list[str]]) -> None:
    lines = aligned(rows, "<>")
    assert len(lines) == len(rows)
    begin = 0
    for k, cells in enumerate(zip(*rows, strict=True)):
        width = max(map(len, cells))
        for line, cell in zip(lines, cells, strict=True):
            part = line.ljust(begin + width)[begin : begin + width]
            assert part == (cell.rjust(width) if k else cell.ljust(width))
        begin += width + 2


def test_a_wide_table_is_not_cut_and_a_short_row_is_refused() -> None:
    assert aligned([["x" * 300, "y"], ["a", "b"]]) == ["x" * 300 + "  y", "a" + " " * 301 + "b"]
    with pytest.raises(ValueError, match="argument 2"):
        aligned([["a", "b"], ["c"]])
