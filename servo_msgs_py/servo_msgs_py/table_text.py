"""Tables as plain text: the same in a terminal, a pipe and a file."""

from __future__ import annotations

from collections.abc import Sequence


def aligned(rows: Sequence[Sequence[str]], sides: str = "<") -> list[str]:
    """Lines of a table with aligned columns, two blanks apart.

    Parameters
    ----------
    rows : sequence of sequence of str
        Cells, with equally many in every row.
    sides : str
        Alignment of each column, ``<`` left or ``>`` right; the last one is that of all further columns.

    Raises
    ------
    ValueError
        If the numbers of cells differ.
    """
    columns = list(zip(*rows, strict=True))
    sides = sides.ljust(len(columns), sides[-1])
    formats = [f"{side}{max(map(len, cells))}" for side, cells in zip(sides, columns, strict=False)]
    return ["  ".join(map(format, row, formats)).rstrip() for row in rows]
