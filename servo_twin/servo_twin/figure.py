"""Pictures without a window."""

from __future__ import annotations

from typing import Any

from servo_twin.board import SimulationError


def new_figure(width: float, height: float, dpi: int) -> Any:
    """A matplotlib figure of this size [inch] with automatic layout.

    Raises
    ------
    SimulationError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise SimulationError("pictures need matplotlib: pip install 'servo_twin[viewer]'") from None
    return Figure(figsize=(width, height), dpi=dpi, layout="constrained")
