"""Prediction of a loop from the configuration block of a board: same model and margins as in the report of `tune`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import PERIOD, TICK
from servo_tuning.control_loops import ControlLoops, control_loops, softened
from servo_tuning.linear import Margins, Omega, margins
from servo_tuning.loops import In, Out, ShaftLoops
from servo_tuning.robust import ShaftModel
from servo_tuning.sensors import EdgeDelay, edge_delay

from servo_measurement.access import BoardAccess

_CURRENT_AXES: Final[Mapping[str, str]] = {"current": "q", "current_d": "d"}
_GRID: Final = 200

OBSERVER: Final = "SPEED_OBSERVER"
"""Feature of an axis whose speed is that of the observer."""


@dataclass(frozen=True)
class Candidate:
    """What a board does not have yet: a configuration, and the shaft that it is for."""

    block: Mapping[str, int]  # configuration of the axis, raw numbers by member
    shaft: ShaftModel


@dataclass(frozen=True)
class Prediction:
    """Model of an open loop."""

    block: Mapping[str, int]  # configuration of the axis, raw numbers by member
    loop: str  # ``current``, ``current_d``, ``speed`` or ``position``
    speed: float  # of the shaft [rad/s], for the measurement delay of the M/T method; 0: edges are frequent
    observed: bool  # whether the speed observer is on
    model: ShaftModel | None = None  # the shaft; None: rigid, with the inertia of the block

    @cached_property
    def loops(self) -> ControlLoops:
        """Gains and nominal motor of the block."""
        return control_loops(self.block)

    def value(self, path: str) -> float:
        """Value of a member of the block, in its unit."""
        return AxisConfigTable.load().value(path, self.block)

    @property
    def _lines(self) -> float:
        """Lines of the encoder per turn."""
        return float(round(2.0**30 / self.block["encoder.angle_per_count"]))

    @property
    def timer_clock(self) -> float:
        """Clock of the timers that measure the edges of the encoder [Hz]."""
        per_ratio = self.value("mt_speed.speed_per_ratio") * Catalogue.load().full_scale("speed")
        return per_ratio * 4.0 * self._lines / (2.0 * math.pi)

    @property
    def voltage_max(self) -> float:
        """Largest stator voltage at the nominal bus voltage [V]."""
        return 2.0 / 3.0 * self.value("current_loop.modulation_limit") * self.value("u_dc_nominal")

    @property
    def nyquist(self) -> float:
        """Highest frequency [Hz]."""
        return 0.5 / (PERIOD if self.loop in _CURRENT_AXES else TICK)

    @property
    def shaft(self) -> ShaftLoops:
        """Model of the shaft with its speed and position loop."""
        loops = self.loops.shaft(observed=self.observed)
        return loops if self.model is None else self.model.within(loops)

    @property
    def delay(self) -> EdgeDelay | None:
        """Delay of the speed of the M/T method; None: with the observer, or at standstill."""
        if self.observed or self.speed == 0.0:
            return None
        return edge_delay(self._lines, TICK, abs(self.speed))

    def _open(self, omega: Omega) -> NDArray[np.complex128]:
        if self.loop in _CURRENT_AXES:
            return self.loops.current_loop(_CURRENT_AXES[self.loop]).open.response(omega)
        if self.loop == "speed":
            return self.shaft.speed_open(omega, self.delay)
        return self.shaft.position_open(omega)

    def response(self, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Open-loop frequency response at frequencies [Hz]."""
        return self._open(2.0 * math.pi * np.asarray(frequency, np.float64))

    @property
    def margins(self) -> Margins:
        """Crossover and margins."""
        return margins(self._open, 2.0 * math.pi * self.nyquist)

    def excursion(self, f_min: float, f_max: float) -> tuple[float, float]:
        """Largest effect of the test signal of the loop within a band [Hz], relative to its amplitude.

        Returns
        -------
        tuple of float
            Speed of the shaft, and set-point of the current [rad/s, A per A or per rad/s].
        """
        omega = 2.0 * math.pi * np.geomspace(f_min, max(f_max, 1.01 * f_min), _GRID)
        sensitivity = 1.0 / (1.0 + self._open(omega))
        shaft = self.shaft
        if self.loop == "position":
            per_speed = shaft.speed.channel(Out.SPEED, In.SET_POINT).response(omega)
            per_current = shaft.speed.channel(Out.CURRENT, In.SET_POINT).response(omega)
            return float(np.abs(sensitivity * per_speed).max()), float(np.abs(sensitivity * per_current).max())
        if self.loop == "speed":
            per_current = shaft.open.channel(Out.SPEED, In.CURRENT).response(omega)
            return float(np.abs(sensitivity * per_current).max()), float(np.abs(sensitivity).max())
        return 0.0, float(np.abs(sensitivity).max())


def is_observed(access: BoardAccess, axis: int) -> bool:
    """Whether the speed of an axis of a board is that of the observer."""
    word = int(access.read("param.features")[axis])
    return any(flag.name == OBSERVER for flag in access.catalogue.active("features", word))


def predict(
    access: BoardAccess,
    axis: int,
    loop: str,
    speed: float,
    gain: float = 1.0,
    candidate: Candidate | None = None,
    observed: bool | None = None,
) -> Prediction:
    """Model of a loop of a board.

    Parameters
    ----------
    access : BoardAccess
        The board.
    axis : int
        Index.
    loop : str
        As of `Prediction`.
    speed : float
        Of the shaft [rad/s].
    gain : float
        Part of the bandwidths of speed and position control in use.
    candidate : Candidate, optional
        Configuration and shaft; None: the configuration of the board, and a rigid shaft.
    observed : bool, optional
        Whether the speed observer is on; None: as on the board.
    """
    if observed is None:
        observed = is_observed(access, axis)
    block = read_block(access, axis) if candidate is None else candidate.block
    model = None if candidate is None else candidate.shaft
    return Prediction(block if gain == 1.0 else softened(block, gain), loop, speed, observed, model)
