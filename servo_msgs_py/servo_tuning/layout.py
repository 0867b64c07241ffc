"""Tables and numbers of the report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from servo_msgs_py.table_text import aligned

from servo_tuning.linear import Margins


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Table with headings; the first column left-aligned, the others right-aligned."""
    for line in aligned(rows, "<>"):
        yield f"     {line}"


def hertz(value: float | None) -> str:
    """Text of a frequency [Hz]."""
    return "never" if value is None else f"{value:.4g} Hz"


def phase(margins: Margins) -> str:
    """Text of a phase margin [deg]."""
    return "-" if margins.phase is None else f"{margins.phase:.1f} deg"


def ratio(value: float | None) -> str:
    """Text of a gain margin (ratio)."""
    return "-" if value is None else f"{value:.2f}"


def factor(value: float | None) -> str:
    """Text of a gain margin (ratio), also in dB."""
    return "-" if value is None else f"{ratio(value)} ({20.0 * math.log10(value):.1f} dB)"


def notes(rows: Sequence[tuple[str, str, str]]) -> Iterator[str]:
    """Table of names, values and notes."""
    for line in aligned(rows, "<><"):
        yield f"    {line}"
