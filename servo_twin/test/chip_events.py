"""Events of a chip as a logic analyser would show them (``chip/trace.h``)."""

from __future__ import annotations

from typing import NamedTuple

_KINDS = (
    "cycle", "match", "load", "gates", "trigger", "sync", "sample", "scan_end", "enter", "leave", "write", "capture",
)  # fmt: skip


class Event(NamedTuple):
    """An event."""

    clock: int
    kind: str
    a: int
    b: int


def event(clock: int, kind: int, a: int, b: int) -> Event:
    """An event from the numbers of a ``trace_entry_t``."""
    return Event(int(clock), _KINDS[kind], int(a), int(b))
