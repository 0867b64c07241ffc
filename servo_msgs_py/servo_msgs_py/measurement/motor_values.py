"""What is estimated of a motor, with its uncertainty, and what a controller is tuned for. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

COVERAGE: Final = 1.96
"""Half the width of a 95 % interval, over the standard uncertainty."""

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
"""What can be estimated, and its unit.

``r_s`` is without the switches' resistance. ``dead_voltage`` is what a leg loses in its dead time and its switches
together: at one bus voltage these are one number. ``gain_ratio`` is gain of phase a over that of b and c; the offsets
are what the board's calibration has left, along phase a and across it.
"""


@dataclass(frozen=True)
class Estimate:
    """A number and how well it is known."""

    value: float  # SI
    sigma: float  # standard uncertainty

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval, in the unit of the value."""
        return self.value - COVERAGE * self.sigma, self.value + COVERAGE * self.sigma

    @property
    def part(self) -> float:
        """Half the width of the interval over the value: a ratio, not negative."""
        return COVERAGE * self.sigma / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class MotorEstimates:
    """What a measurement has found out about an axis."""

    values: Mapping[str, Estimate]  # by the names of `UNITS`
    undetermined: Mapping[str, str]  # why a value is not known, by name

    def __getitem__(self, name: str) -> float:
        return self.values[name].value


@dataclass(frozen=True)
class Limits:
    """What the user permits, and knows."""

    voltage: float  # nominal voltage of the bus [V]
    current: float  # largest current [A, peak]
    speed: float = 200.0  # largest speed [rad/s]
    turns: float = 20.0  # the shaft stays within so many turns to both sides
    energy: float = 0.4  # that the bus can take from a braking shaft [J]
    r_on: float = 0.0  # resistance of a switch, which a measurement cannot tell from the winding's [ohm]

    def __post_init__(self) -> None:
        for name in ("voltage", "current", "speed", "turns", "energy"):
            value: float = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}; write a number above 0")
        if not self.r_on >= 0.0:
            raise ValueError(f"r_on is {self.r_on!r}; write the resistance of a switch, or 0")
