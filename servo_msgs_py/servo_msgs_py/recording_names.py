"""Names of the time line and the curves in rerun recordings."""

from __future__ import annotations

from typing import Final

TIMELINE: Final = "board_time"
"""Time on the clock of the board since the start of the recording [s]."""

PLOT: Final = "plot"
BURST: Final = "burst"
"""Roots of the curves of telemetry and bursts."""

BOARD: Final = "board"
SET_POINT: Final = "set_point"
"""Last parts of a path: measured values of the board, and set-points."""

_REFERENCE: Final = "_ref"


def telemetry_parts(variable: str) -> tuple[str, ...]:
    """Path of a telemetry variable: ``plot/axis1/i_q/board``; of its reference: ``plot/axis1/i_q/set_point``."""
    if variable.endswith(_REFERENCE):
        return (PLOT, *variable.removesuffix(_REFERENCE).split("."), SET_POINT)
    return (PLOT, *variable.split("."), BOARD)


def burst_parts(variable: str, source: str = BOARD) -> tuple[str, ...]:
    """Path of a variable of a burst: ``burst/axis1/i_q/board``."""
    return (BURST, *variable.split("."), source)
