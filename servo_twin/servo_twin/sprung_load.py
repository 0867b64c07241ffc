"""A load behind a spring, by its resonance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from servo_twin.plant import AxisPlant


@dataclass(frozen=True)
class SprungLoad:
    """A load behind a spring."""

    frequency: float  # resonance [Hz]
    ratio: float  # inertia of the load over that of the rotor
    damping: float  # of the resonance, over its critical damping

    def of(self, axis: AxisPlant) -> AxisPlant:
        """The axis with its inertia on both ends of the spring."""
        rotor, load = (axis.inertia * part / (1.0 + self.ratio) for part in (1.0, self.ratio))
        reduced = rotor * load / (rotor + load)
        stiffness = (2.0 * math.pi * self.frequency) ** 2 * reduced
        damping = 2.0 * self.damping * math.sqrt(stiffness * reduced)
        return replace(axis, inertia=rotor, load_inertia=load, shaft_stiffness=stiffness, shaft_damping=damping)
