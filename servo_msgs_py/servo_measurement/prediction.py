"""Prediction of a loop of a board by the tuning code: same model and margins as in its report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import AXES
from servo_tuning.linear import Margins, Omega, margins
from servo_tuning.loops import In, Out, ShaftLoops
from servo_tuning.reading import parse
from servo_tuning.restore import restore_table
from servo_tuning.sensors import EdgeDelay, edge_delay
from servo_tuning.tuned import Tuned, tuned

from servo_measurement.access import BoardAccess

_GRID: Final = 200
_TIMEOUTS: Final = (0.5, 0.5)
"""Of the host and of commands [s]; required in a configuration, but without effect on gains."""


def tuned_of_blocks(access: BoardAccess, axis: int, blocks: Sequence[Mapping[str, int]]) -> Tuned:
    """Gains and nominal values of configuration blocks; a `ConfigError` if no configuration corresponds to them."""
    configuration = parse(restore_table(blocks, _TIMEOUTS, access.catalogue), access.catalogue)
    return tuned(configuration.axes[axis], configuration)


def tuned_of_board(access: BoardAccess, axis: int) -> Tuned:
    """Gains and nominal values of the active configuration of a board; see `tuned_of_blocks`."""
    return tuned_of_blocks(access, axis, [read_block(access, number) for number in range(AXES)])


@dataclass(frozen=True)
class Prediction:
    """Model of an open loop by the tuning code."""

    it: Tuned  # gains and nominal values
    loop: str  # ``current``, ``current_d``, ``speed`` or ``position``
    speed: float  # of the shaft [rad/s], for the measurement delay of the M/T method; 0: edges are frequent
    observed: bool  # whether the speed observer is on

    @property
    def nyquist(self) -> float:
        """Highest frequency [Hz]."""
        step = self.it.board.period if self.loop.startswith("current") else self.it.board.tick
        return 0.5 / step

    @property
    def _shaft(self) -> ShaftLoops:
        return self.it.shaft(observed=self.observed)

    @property
    def _delay(self) -> EdgeDelay | None:
        if self.observed or self.speed == 0.0:
            return None
        return edge_delay(self.it.axis("encoder.lines"), self.it.board.tick, abs(self.speed))

    def _open(self, omega: Omega) -> NDArray[np.complex128]:
        if self.loop.startswith("current"):
            return self.it.current_loop("d" if self.loop == "current_d" else "q").open.response(omega)
        if self.loop == "speed":
            return self._shaft.speed_open(omega, self._delay)
        return self._shaft.position_open(omega)

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
        shaft = self._shaft
        if self.loop == "position":
            per_speed = shaft.speed.channel(Out.SPEED, In.SET_POINT).response(omega)
            per_current = shaft.speed.channel(Out.CURRENT, In.SET_POINT).response(omega)
            return float(np.abs(sensitivity * per_speed).max()), float(np.abs(sensitivity * per_current).max())
        if self.loop == "speed":
            per_current = shaft.open.channel(Out.SPEED, In.CURRENT).response(omega)
            return float(np.abs(sensitivity * per_current).max()), float(np.abs(sensitivity).max())
        return 0.0, float(np.abs(sensitivity).max())


def predict(access: BoardAccess, axis: int, loop: str, speed: float) -> Prediction:
    """Model of a loop of a board, with its configuration and its features.

    Raises
    ------
    ConfigError
        If no configuration corresponds to the one of the board.
    """
    word = int(access.read("param.features")[axis])
    observed = any(flag.name == "SPEED_OBSERVER" for flag in access.catalogue.active("features", word))
    return Prediction(tuned_of_board(access, axis), loop, speed, observed)
