"""What a recording shows and under which names: shared by those who write it, lay it out and read it. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.joints import Joint
from servo_msgs_py.recording_names import BOARD, BURST, PLOT, SET_POINT, TIMELINE, burst_parts

__all__ = [
    "BOARD",
    "BURST",
    "BURST_RESIDUAL",
    "COLOURS",
    "ESTIMATE",
    "ESTIMATES",
    "EXTRAS",
    "PATH_STATES",
    "QUANTITIES",
    "RESIDUAL",
    "RESIDUALS",
    "SET_POINT",
    "STATE_COLOURS",
    "TIMELINE",
    "TWIN",
    "Colour",
    "Quantity",
    "axes",
    "burst_entity",
    "estimate_entity",
    "path_entity",
    "position_state",
    "residual_entity",
    "series_entity",
    "shaft_entity",
    "state_entity",
]

Colour = tuple[int, int, int]

TWIN: Final = "twin"
RESIDUAL: Final = "residual"

COLOURS: Final[dict[str, Colour]] = {
    SET_POINT: (150, 155, 165),
    BOARD: (42, 120, 214),
    TWIN: (240, 130, 30),
    RESIDUAL: (200, 50, 90),
}
"""One colour per source, the same in every view and picture."""

STATE_COLOURS: Final[dict[str, Colour]] = {
    "FAULT": (200, 40, 40),
    "INIT": (130, 130, 140),
    "STOP": (95, 105, 120),
    "RUN/CALIB": (190, 160, 50),
    "RUN/READY": (70, 140, 190),
    "RUN/ALIGN": (200, 130, 40),
    "RUN/SPIN": (50, 160, 80),
    "RUN/FREEWHEEL": (120, 150, 120),
    "RUN/STARTUP": (170, 120, 190),
    "DISCONNECTED": (60, 60, 60),
    "UNKNOWN": (95, 105, 120),
    "ASSUMED": (190, 160, 50),
    "HOMING": (200, 130, 40),
    "KNOWN": (50, 160, 80),
    "CONNECTED": (50, 160, 80),
    "FOLLOWS": (50, 160, 80),
    "APART": (200, 130, 40),
    "NOTHING CHANGED": (50, 160, 80),
    "CHANGED": (200, 130, 40),
    "NO PATH": (95, 105, 120),
    "ON PATH": (50, 160, 80),
}
"""States of the axes and of what their positions are worth, of the link, the twin, the diagnosis and the path."""

PATH_STATES: Final = ("NO PATH", "ON PATH")
"""States of the path: whether the axes follow one."""


@dataclass(frozen=True)
class Quantity:
    """One plot per axis: the columns of the telemetry that it shows."""

    name: str
    title: str
    unit: str
    measured: str
    set_point: str

    def of_joint(self, joint: Joint, motor: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the joint [SI], same shape; currents and what a monitor output shows remain those of the motor."""
        if self.name == "position":
            return joint.position(motor)
        return joint.velocity(motor) if self.name == "speed" else motor

    def column(self, source: str, axis: int) -> str:
        """Column of the telemetry for a series."""
        return f"{axis_name(axis)}.{self.set_point if source == SET_POINT else self.measured}"


QUANTITIES: Final = (
    Quantity("position", "position", "rad", "position", "position_ref"),
    Quantity("speed", "speed", "rad/s", "speed", "speed_ref"),
    Quantity("i_q", "current i_q", "A", "i_q", "i_q_ref"),
)

EXTRAS: Final = (
    Quantity("i_d", "current i_d", "A", "i_d", "no set-point"),
    Quantity("winding_temperature", "winding", "deg C", "winding_temperature", "no set-point"),
    Quantity("monitor", "monitor output", "of full scale", "monitor", "no set-point"),
)
"""Plots of optional telemetry, beside the residuals."""

BURST_RESIDUAL: Final = "/burst_residual"
"""Root of what the bursts of board and twin differ by."""

RESIDUALS: Final = {"position": "rad", "velocity": "rad/s", "effort": "N m"}
"""Fields of the residual, board minus twin, and their units."""


ESTIMATE: Final = "estimate"
ESTIMATES: Final = ("value", "low", "high")
"""Curves of an estimate: itself, and its 95 % interval."""


def axes() -> Iterator[tuple[int, str]]:
    """Index and name of every axis."""
    return ((axis, axis_name(axis)) for axis in range(AXES))


def series_entity(axis: int, quantity: str, source: str) -> str:
    """Where a curve lies: ``/plot/axis1/position/board``."""
    return f"/{PLOT}/{axis_name(axis)}/{quantity}/{source}"


def residual_entity(axis: int, field: str) -> str:
    """Where a residual lies: ``/plot/axis1/residual/position``."""
    return f"/{PLOT}/{axis_name(axis)}/residual/{field}"


def estimate_entity(place: str, name: str, curve: str) -> str:
    """Where an estimate of the diagnosis lies: ``/plot/axis1/estimate/inertia/low``; of the supply in ``/plot/bus``."""
    return f"/{PLOT}/{place}/estimate/{name}/{curve}"


def position_state(axis: str) -> str:
    """Name of the state that says what the position of an axis is worth."""
    return f"{axis}/position"


def state_entity(name: str) -> str:
    """Where a state lies: of an axis, the ``link``, the ``twin``, the ``diagnosis`` or the ``path``."""
    return f"/state/{name}"


def burst_entity(variable: str, source: str) -> str:
    """Where a variable of the bursts lies: ``/burst/axis1/i_q/board``; its residual: ``/burst_residual/axis1/i_q``."""
    if source == RESIDUAL:
        return f"{BURST_RESIDUAL}/{variable.replace('.', '/')}"
    return "/" + "/".join(burst_parts(variable, source))


def path_entity(source: str) -> str:
    """Where the positions of both axes against each other lie: ``/path/board``."""
    return f"/path/{source}"


def shaft_entity(axis: int, source: str) -> str:
    """Where the hand of a shaft lies: ``/shafts/axis1/board``."""
    return f"/shafts/{axis_name(axis)}/{source}"
