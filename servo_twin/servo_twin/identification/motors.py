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
