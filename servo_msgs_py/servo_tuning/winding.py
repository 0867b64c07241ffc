"""Thermal model of a winding: integers, checks, and steady-state values.

One heat capacity C and one thermal resistance R_th to ambient (``firmware/diagnosis/winding_model.h``)::

    C dT/dt = P(T) - (T - T_ambient) / R_th,    P = 3/2 R_s (1 + 0.00393/K (T - 25 deg C)) I^2
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

from servo_tuning.configuration import Axis
from servo_tuning.conversion import Converter, Value
from servo_tuning.errors import either, higher, lower

COPPER: Final = 3.93e-3
"""Temperature coefficient of the resistance of copper, relative to the resistance at `COLD` [1/K]."""

COLD: Final = 25.0
"""Temperature of the value `motor.r_s` [deg C]."""

FULL: Final = 256.0
"""Full scale of the temperatures in the firmware [K]."""

STEP_TICKS: Final = 64
"""Slow ticks per step of the model."""

_FIT: Final = 1.01  # tolerance of the temperature rise by the rated current: data sheets are rounded


@dataclass(frozen=True)
class Winding:
    """Nominal values of a winding."""

    r_s: float  # resistance of a phase at `COLD` [ohm]
    resistance: float  # thermal, to ambient [K/W]
    capacity: float  # heat capacity [J/K]
    ambient: float  # ambient temperature [deg C]
    derating: float  # temperature where the derating begins [deg C]
    maximum: float  # temperature where the derating ends [deg C]
    current: float  # current limit at `derating` [A]
    rated: float  # current limit at `maximum` [A]

    @classmethod
    def of(cls, axis: Axis) -> Winding:
        """Winding of an axis. If the thermal resistance is omitted, the rated current heats to the maximum."""
        low, high = axis("winding.ambient"), axis("winding.maximum")
        given = axis.given("winding.thermal_resistance")
        rated_loss = _loss(axis("motor.r_s"), axis("motor.rated_current"), high)
        return cls(
            r_s=axis("motor.r_s"),
            resistance=axis("winding.thermal_resistance") if given else (high - low) / rated_loss,
            capacity=axis("winding.heat_capacity"),
            ambient=low,
            derating=axis("winding.derating"),
            maximum=high,
            current=axis("limits.current"),
            rated=axis("motor.rated_current"),
        )

    def loss(self, current: float, temperature: float) -> float:
        """Copper losses of a current vector of this magnitude [W]."""
        return _loss(self.r_s, current, temperature)

    def limit(self, temperature: float) -> float:
        """Derated current limit at a temperature [deg C] [A]."""
        part = (self.maximum - temperature) / (self.maximum - self.derating)
        return min(self.current, self.rated + (self.current - self.rated) * min(max(part, 0.0), 1.0))

    def equilibrium(self, current: float) -> float:
        """Steady-state temperature at a constant current; infinite if it does not settle [deg C]."""
        cold = self.resistance * self.loss(current, COLD)
        growth = 1.0 - COPPER * cold
        return math.inf if growth <= 0.0 else self.ambient + cold * (1.0 + COPPER * (self.ambient - COLD)) / growth

    def time_to(self, temperature: float, current: float) -> float:
        """Time from ambient to a temperature at constant current [s]; may be infinite."""
        loss = self.loss(current, COLD)
        rate = (1.0 / self.resistance - COPPER * loss) / self.capacity  # [1/s], below 0: thermal runaway
        slope = loss * (1.0 + COPPER * (self.ambient - COLD)) / self.capacity
        rise = temperature - self.ambient
        if rise <= 0.0:
            return 0.0
        if slope <= 0.0 or (rate > 0.0 and rate * rise >= slope):
            return math.inf
        return rise / slope if rate == 0.0 else -math.log1p(-rate * rise / slope) / rate

    def settled(self) -> tuple[float, float]:
        """Steady-state current and temperature at the derated current limit [A], [deg C]."""
        low, high = self.ambient, max(self.maximum, self.equilibrium(self.rated))
        if self.equilibrium(self.current) <= self.derating:
            return self.current, self.equilibrium(self.current)
        if math.isinf(high):
            return self.rated, high
        for _ in range(60):
            middle = 0.5 * (low + high)
            warms = self.loss(self.limit(middle), middle) > (middle - self.ambient) / self.resistance
            low, high = (middle, high) if warms else (low, middle)
        return self.limit(low), low


def _loss(r_s: float, current: float, temperature: float) -> float:
    return 1.5 * r_s * (1.0 + COPPER * (temperature - COLD)) * current**2


def check_winding(axis: Axis) -> None:
    """Check the order of the temperatures, and that the rated current does not heat beyond the maximum.

    Raises
    ------
    ConfigError
        If a check fails.
    """
    for below, above in itertools.pairwise(("ambient", "derating", "maximum", "fault")):
        if axis(f"winding.{below}") >= axis(f"winding.{above}"):
            reason = f"not below winding.{above} = {axis(f'winding.{above}'):g} deg C"
            raise axis.refused(f"winding.{below}", reason, lower(f"winding.{below}"), higher(f"winding.{above}"))
    if axis("winding.initial") > axis("winding.maximum"):
        reason = f"above winding.maximum = {axis('winding.maximum'):g} deg C"
        raise axis.refused("winding.initial", reason, lower("winding.initial"))
    if not axis.given("winding.thermal_resistance"):
        return
    winding = Winding.of(axis)
    steady = winding.equilibrium(winding.rated)
    if steady - winding.ambient > _FIT * (winding.maximum - winding.ambient):
        reason = f"continuously it heats the winding to {steady:.4g} deg C, above winding.maximum = {winding.maximum:g}"
        advice = "omit winding.thermal_resistance if it is not known"
        raise axis.refused("motor.rated_current", reason, lower("motor.rated_current"), advice)


def winding_constants(to: Converter) -> dict[str, Value]:
    """Fields of ``winding_model_config_t``."""
    s, winding = to.s, Winding.of(to.axis)
    step = STEP_TICKS * to.board.tick
    name, slower = "winding_model", [either("winding.heat_capacity")]
    if to.axis.given("winding.thermal_resistance"):
        slower.append(either("winding.thermal_resistance"))
    degrees = ("ambient", "initial", "derating", "maximum", "fault")
    return {
        f"{name}.heating": to.of(
            "heating of the winding", winding.loss(s.i, COLD) * step / winding.capacity / FULL, *slower
        ),
        f"{name}.cooling": to.of("cooling of the winding", step / (winding.resistance * winding.capacity), *slower),
        **{f"{name}.{key}": to.at(f"winding.{key}", 1.0 / FULL) for key in degrees},
        f"{name}.rated_current": to.at("motor.rated_current", 1.0 / s.i),
    }
