"""Names in rerun recordings: of the time line and of the curves. For everything that writes, lays out or reads one."""

from __future__ import annotations

from typing import Final

TIMELINE: Final = "board_time"
"""Seconds of board ticks since the recording began."""

PLOT: Final = "plot"
BURST: Final = "burst"
"""Roots of the curves of the telemetry and of the bursts."""

BOARD: Final = "board"
SET_POINT: Final = "set_point"
"""Last parts of a path: what was measured on the board, and what was asked of it."""

_REFERENCE: Final = "_ref"


def telemetry_parts(variable: str) -> tuple[str, ...]:
    """Where a variable of the telemetry lies: ``plot/axis1/i_q/board``; its reference ``plot/axis1/i_q/set_point``."""
    if variable.endswith(_REFERENCE):
        return (PLOT, *variable.removesuffix(_REFERENCE).split("."), SET_POINT)
    return (PLOT, *variable.split("."), BOARD)


def burst_parts(variable: str, source: str = BOARD) -> tuple[str, ...]:
    """Where a variable of the bursts lies: ``burst/axis1/i_q/board``."""
    return (BURST, *variable.split("."), source)
