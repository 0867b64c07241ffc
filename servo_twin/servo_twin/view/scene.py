"""Contents of a recording and names of its entities, for writing, layout and reading."""

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
    "HOME_STATES",
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
    "home_state",
    "path_entity",
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
"""Colour of each source, in all views and pictures."""

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
    "NOT HOMED": (95, 105, 120),
    "HOME ASSUMED": (190, 160, 50),
    "HOMING": (200, 130, 40),
    "HOMED": (50, 160, 80),
    "CONNECTED": (50, 160, 80),
    "HEALTHY": (50, 160, 80),
    "NOT HEALTHY": (200, 130, 40),
    "NOTHING CHANGED": (50, 160, 80),
    "CHANGED": (200, 130, 40),
    "NO PATH": (95, 105, 120),
    "ON PATH": (50, 160, 80),
}
"""States of the axes and of their homing, of link, twin, diagnosis and path."""

HOME_STATES: Final = {"UNKNOWN": "NOT HOMED", "ASSUMED": "HOME ASSUMED", "HOMING": "HOMING", "KNOWN": "HOMED"}
"""States of the homing by the names of ``home_state_t``. The position is valid in each; the zero may not be."""

PATH_STATES: Final = ("NO PATH", "ON PATH")
"""States of the path."""


@dataclass(frozen=True)
class Quantity:
    """One plot per axis and its columns of the telemetry."""

    name: str
    title: str
    unit: str
    measured: str
    set_point: str

    def of_joint(self, joint: Joint, motor: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the joint [SI], same shape; currents and monitor outputs remain motor values."""
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
"""Plots of optional telemetry, next to the residuals."""

BURST_RESIDUAL: Final = "/burst_residual"
"""Root of the residuals of bursts."""

RESIDUALS: Final = {"position": "rad", "velocity": "rad/s", "effort": "N m"}
"""Fields of the residual, board minus twin, and their units."""


ESTIMATE: Final = "estimate"
ESTIMATES: Final = ("value", "low", "high")
"""Curves of an estimate: the value and its 95 % interval."""


def axes() -> Iterator[tuple[int, str]]:
    """Index and name of every axis."""
    return ((axis, axis_name(axis)) for axis in range(AXES))


def series_entity(axis: int, quantity: str, source: str) -> str:
    """Entity of a curve: ``/plot/axis1/position/board``."""
    return f"/{PLOT}/{axis_name(axis)}/{quantity}/{source}"


def residual_entity(axis: int, field: str) -> str:
    """Entity of a residual: ``/plot/axis1/residual/position``."""
    return f"/{PLOT}/{axis_name(axis)}/residual/{field}"


def estimate_entity(source: str, name: str, curve: str) -> str:
    """Entity of an estimate of the diagnosis: ``/plot/axis1/estimate/inertia/low``; of the supply in ``/plot/bus``."""
    return f"/{PLOT}/{source}/estimate/{name}/{curve}"


def home_state(axis: str) -> str:
    """Name of the state with the homing of an axis."""
    return f"{axis}/home"


def state_entity(name: str) -> str:
    """Entity of a state: of an axis, the ``link``, the ``twin``, the ``diagnosis`` or the ``path``."""
    return f"/state/{name}"


def burst_entity(variable: str, source: str) -> str:
    """Entity of a variable of a burst: ``/burst/axis1/i_q/board``; of its residual: ``/burst_residual/axis1/i_q``."""
    if source == RESIDUAL:
        return f"{BURST_RESIDUAL}/{variable.replace('.', '/')}"
    return "/" + "/".join(burst_parts(variable, source))


def path_entity(source: str) -> str:
    """Entity of a path, one axis over the other: ``/path/board``."""
    return f"/path/{source}"


def shaft_entity(axis: int, source: str) -> str:
    """Entity of a shaft angle: ``/shafts/axis1/board``."""
    return f"/shafts/{axis_name(axis)}/{source}"
