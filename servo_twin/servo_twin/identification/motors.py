"""Random motors for the identification."""

from __future__ import annotations

import math
import random
from typing import Final

from servo_twin.plant import PlantConfig

PAIRS: Final = (1, 2, 2, 3, 4, 4, 5, 7)
R_S: Final = (0.15, 3.0)  # [ohm]
TIME_CONSTANT: Final = (0.3e-3, 3e-3)  # L_d / R [s]
SALIENCY: Final = (1.0, 1.8)  # L_q / L_d
INDUCTANCE: Final = (0.1e-3, 5e-3)  # [H]
NO_LOAD_SPEED: Final = (120.0, 450.0)  # no-load speed at 24 V [rad/s]
TIME_TO_SPEED: Final = (0.02, 0.4)  # acceleration time to half the no-load speed with 2 A [s]
FRICTION: Final = (0.01, 0.08)  # Coulomb friction, relative to the torque of 2 A
VISCOUS: Final = (0.005, 0.08)  # viscous friction at the no-load speed, relative to the torque of 2 A
DEAD_TIME: Final = (0.8e-6, 1.2e-6)  # [s]
DROP: Final = (0.5, 0.9)  # [V]
CURRENT: Final = 2.0  # [A]


def random_motor(plant: PlantConfig, axis: int, seed: int) -> PlantConfig:
    """Copy of a plant with a random motor at an axis; the motor depends on the seed only."""
    source = random.Random(f"motor {axis} {seed}")

    def spread(span: tuple[float, float]) -> float:
        return math.exp(source.uniform(math.log(span[0]), math.log(span[1])))

    pairs = source.choice(PAIRS)
    r_s = spread(R_S)
    l_d = min(max(r_s * spread(TIME_CONSTANT), INDUCTANCE[0]), INDUCTANCE[1])
    idle = spread(NO_LOAD_SPEED)
    psi = 24.0 / math.sqrt(3.0) / (pairs * idle)
    torque = 1.5 * pairs * psi * CURRENT
    friction = torque * spread(FRICTION)
    return plant.with_axis(
        axis,
        r_s=r_s,
        l_d=l_d,
        l_q=l_d * source.uniform(*SALIENCY),
        psi_m=psi,
        pole_pairs=float(pairs),
        inertia=torque * spread(TIME_TO_SPEED) / (0.5 * idle),
        friction=friction,
        viscous=torque * spread(VISCOUS) / idle,
        dead_time=source.uniform(*DEAD_TIME),
        v_drop=source.uniform(*DROP),
    )


WIDE_PAIRS: Final = (2, 24)
WIDE_R_S: Final = (0.03, 12.0)  # [ohm]
WIDE_INDUCTANCE: Final = (15e-6, 8e-3)  # [H]
WIDE_TIME_CONSTANT: Final = (0.1e-3, 5e-3)  # L_d / R [s]
WIDE_VOLTAGE: Final = (12.0, 33.0)  # of the supply [V]
WIDE_NO_LOAD_SPEED: Final = (20.0, 450.0)  # at that voltage [rad/s]
WIDE_INERTIA: Final = (1e-7, 1e-2)  # [kg m^2]
WIDE_CURRENT: Final = (0.3, 4.0)  # permitted [A]
WIDE_DROP: Final = 0.6  # largest voltage of the permitted current at standstill, relative to the available voltage
WIDE_TIME_TO_SPEED: Final = (
    0.01,
    1.0,
)  # acceleration time to half the no-load speed with half the permitted current [s]


def wide_motor(plant: PlantConfig, axis: int, seed: int) -> tuple[PlantConfig, float]:
    """Copy of a plant with a random motor of a wide range and its supply, and the permitted current [A].

    The resistance, inductance, speed and inertia are independent of each other, except that the current has to be
    possible and the shaft has to accelerate in `WIDE_TIME_TO_SPEED`.
    """
    source = random.Random(f"wide motor {axis} {seed}")

    def spread(span: tuple[float, float]) -> float:
        return math.exp(source.uniform(math.log(span[0]), math.log(span[1])))

    while True:
        pairs, voltage, idle = source.randint(*WIDE_PAIRS), source.uniform(*WIDE_VOLTAGE), spread(WIDE_NO_LOAD_SPEED)
        r_s, l_d, current, inertia = (
            spread(WIDE_R_S),
            spread(WIDE_INDUCTANCE),
            spread(WIDE_CURRENT),
            spread(WIDE_INERTIA),
        )
        available = voltage / math.sqrt(3.0)
        psi = available / (pairs * idle)
        torque = 0.75 * pairs * psi * current
        if (
            r_s * current < WIDE_DROP * available
            and WIDE_TIME_CONSTANT[0] < l_d / r_s < WIDE_TIME_CONSTANT[1]
            and WIDE_TIME_TO_SPEED[0] < 0.5 * idle * inertia / torque < WIDE_TIME_TO_SPEED[1]
        ):
            break
    motor = plant.with_axis(
        axis,
        r_s=r_s,
        l_d=l_d,
        l_q=l_d * source.uniform(*SALIENCY),
        psi_m=psi,
        pole_pairs=float(pairs),
        inertia=inertia,
        friction=torque * spread(FRICTION),
        viscous=torque * spread(VISCOUS) / idle,
        dead_time=source.uniform(*DEAD_TIME),
        v_drop=source.uniform(*DROP),
    )
    return motor.with_bus(u_source=voltage), current
