"""Random motors with their supply and drive, for campaigns and for the identification."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import Final

from servo_twin.plant import PlantConfig

R_S: Final = (0.03, 12.0)  # [ohm]
INDUCTANCE: Final = (15e-6, 8e-3)  # L_d [H]
POLE_PAIRS: Final = (2.0, 25.0)
INERTIA: Final = (1e-7, 1e-2)  # [kg m^2]
VOLTAGE: Final = (12.0, 33.0)  # of the bus [V]
NO_LOAD_SPEED: Final = (20.0, 700.0)  # at that voltage [rad/s]
CURRENT: Final = (0.2, 4.0)  # of the drive, peak [A]
FRICTION: Final = (0.01, 0.1)  # Coulomb friction over the torque of that current
VISCOUS: Final = (0.005, 0.05)  # viscous friction at the no-load speed over that torque
SALIENCY: Final = (1.0, 1.4)  # L_q / L_d

STALL_USE: Final = 0.6
"""Largest current over the one that the voltage drives through the winding at standstill."""
TIME_CONSTANT: Final = (5e-5, 20e-3)
"""L_d / R of motors that are built [s]; a draw outside is repeated, as outside of the next two."""
ACCELERATION_TIME: Final = (5e-3, 5.0)  # to the no-load speed with the current of the drive [s]
FLUX: Final = (1e-4, 0.5)  # [V s]

DEAD_TIME: Final = (0.8e-6, 1.2e-6)  # of an unknown inverter [s]
DROP: Final = (0.5, 0.9)  # [V]


@dataclass(frozen=True)
class RandomMotor:
    """A motor with its supply and drive."""

    r_s: float  # [ohm]
    l_d: float  # [H]
    l_q: float  # [H]
    psi_m: float  # [V s]
    pole_pairs: int
    inertia: float  # [kg m^2]
    friction: float  # Coulomb [N m]
    viscous: float  # [N m s]
    voltage: float  # of the bus [V]
    current: float  # of the drive, peak [A]
    no_load_speed: float  # at that voltage [rad/s]

    def __str__(self) -> str:
        return (
            f"{self.r_s:.3g} ohm, {1e3 * self.l_d:.3g} mH, {self.pole_pairs} pole pairs, {self.inertia:.2g} kg m^2, "
            f"{self.voltage:.3g} V, {self.current:.2g} A, {self.no_load_speed:.3g} rad/s"
        )

    def at(self, plant: PlantConfig, axis: int) -> PlantConfig:
        """Copy of a plant with this motor at an axis, and its supply."""
        names = ("r_s", "l_d", "l_q", "psi_m", "inertia", "friction", "viscous")
        values = {name: getattr(self, name) for name in names} | {"pole_pairs": float(self.pole_pairs)}
        return plant.with_axis(axis, **values).with_bus(u_source=self.voltage)


def _spread(source: random.Random, span: tuple[float, float]) -> float:
    return math.exp(source.uniform(math.log(span[0]), math.log(span[1])))


def random_motor(seed: int, number: int) -> RandomMotor:
    """Create a motor; it depends on the arguments only."""
    rng = random.Random(f"motor-campaign {seed} {number}")
    while True:
        r_s, l_d, inertia = (_spread(rng, span) for span in (R_S, INDUCTANCE, INERTIA))
        voltage = rng.uniform(*VOLTAGE)
        pairs, idle = round(_spread(rng, POLE_PAIRS)), _spread(rng, NO_LOAD_SPEED)
        phase = voltage / math.sqrt(3.0)
        current = min(_spread(rng, CURRENT), STALL_USE * phase / r_s)
        psi = phase / (pairs * idle)
        torque = 1.5 * pairs * psi * current
        spans = ((l_d / r_s, TIME_CONSTANT), (inertia * idle / torque, ACCELERATION_TIME), (psi, FLUX))
        if all(low <= value <= high for value, (low, high) in spans):
            friction, viscous = torque * _spread(rng, FRICTION), torque * _spread(rng, VISCOUS) / idle
            l_q = l_d * rng.uniform(*SALIENCY)
            return RandomMotor(r_s, l_d, l_q, psi, pairs, inertia, friction, viscous, voltage, current, idle)


def with_random_inverter(plant: PlantConfig, axis: int, seed: int, number: int) -> PlantConfig:
    """Copy of a plant with another dead time and drop of the switches of an axis."""
    rng = random.Random(f"inverter {seed} {number}")
    return plant.with_axis(axis, dead_time=rng.uniform(*DEAD_TIME), v_drop=rng.uniform(*DROP))
