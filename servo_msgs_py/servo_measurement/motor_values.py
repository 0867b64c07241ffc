"""Estimated motor values with uncertainties, and the limits of a measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.table_text import aligned

COVERAGE: Final = 1.96
"""Half the width of a 95 % interval, relative to the standard uncertainty."""

VOLTAGE_USE: Final = 0.6
"""Largest resistive voltage drop, relative to the voltage."""

UNITS: Final[Mapping[str, str]] = {
    "r_s": "ohm",
    "l_d": "H",
    "l_q": "H",
    "psi_m": "V s",
    "pole_pairs": "",
    "inertia": "kg m^2",
    "friction": "N m",
    "viscous": "N m s",
    "load": "N m",
    "dead_voltage": "V",
    "delay": "s",
    "gain_ratio": "",
    "offset_alpha": "A",
    "offset_beta": "A",
}
"""Values that can be estimated, and their units.

``r_s`` excludes the resistance of the switches. ``dead_voltage`` is the voltage lost in a leg by dead time and switches
together, which cannot be separated at one bus voltage. ``gain_ratio`` is the gain of phase a relative to phases b and
c; the offsets remain after the calibration of the board, along phase a and perpendicular to it.
"""


@dataclass(frozen=True)
class Estimate:
    """A value and its uncertainty."""

    value: float  # SI
    sigma: float  # standard uncertainty

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval, in the unit of the value."""
        return self.value - COVERAGE * self.sigma, self.value + COVERAGE * self.sigma

    @property
    def part(self) -> float:
        """Half the width of the interval relative to the value, not negative."""
        return COVERAGE * self.sigma / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class MotorEstimates:
    """Results of a measurement of an axis."""

    values: Mapping[str, Estimate]  # by the names of `UNITS`
    undetermined: Mapping[str, str]  # cause of an undetermined value, by name

    def __getitem__(self, name: str) -> float:
        return self.values[name].value

    def rows(self) -> list[tuple[str, Estimate, str]]:
        """Name, estimate and unit, in the order of `UNITS`."""
        return [(name, self.values[name], unit) for name, unit in UNITS.items() if name in self.values]

    def lines(self) -> list[str]:
        """Table of values and intervals."""
        cells = [["", "value", "95 % interval", ""]]
        for name, estimate, unit in self.rows():
            low, high = estimate.interval
            span = f"{low:.4g} .. {high:.4g}" if estimate.sigma else ""
            cells.append([name, f"{estimate.value:.5g}", span, unit])
        return aligned(cells, "<><")


@dataclass(frozen=True)
class Limits:
    """Limits and known values given by the user."""

    voltage: float  # nominal voltage of the bus [V]
    current: float  # largest current [A, peak]
    speed: float = 200.0  # largest speed [rad/s]
    turns: float = 20.0  # largest rotation of the shaft in each direction [revolutions]
    energy: float = 0.4  # energy that the bus can absorb from a decelerating shaft [J]
    r_on: float = 0.0  # resistance of a switch, which a measurement cannot separate from the winding [ohm]

    def __post_init__(self) -> None:
        for name in ("voltage", "current", "speed", "turns", "energy"):
            value: float = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}; write a number above 0")
        if not self.r_on >= 0.0:
            raise ValueError(f"r_on is {self.r_on!r}; write the resistance of a switch, or 0")
