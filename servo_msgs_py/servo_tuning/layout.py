"""Tables and numbers of the report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from servo_tuning.linear import Margins


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Table with headings; the first column left-aligned, the others right-aligned."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        cells = (cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        yield "  ".join(["   ", row[0].ljust(widths[0]), *cells]).rstrip()


def hertz(value: float | None) -> str:
    """Text of a frequency [Hz]."""
    return "never" if value is None else f"{value:.4g} Hz"


def phase(margins: Margins) -> str:
    """Text of a phase margin [deg]."""
    return "-" if margins.phase is None else f"{margins.phase:.1f} deg"


def factor(value: float | None) -> str:
    """Text of a gain margin (ratio), also in dB."""
    return "-" if value is None else f"{value:.2f} ({20.0 * math.log10(value):.1f} dB)"


def notes(rows: Sequence[tuple[str, str, str]]) -> Iterator[str]:
    """Table of names, values and notes."""
    widths = [max(len(row[k]) for row in rows) for k in range(2)]
    for name, value, note in rows:
        yield f"    {name.ljust(widths[0])}  {value.rjust(widths[1])}  {note}".rstrip()
