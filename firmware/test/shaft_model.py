"""Model of a shaft in a stator field, for the rotor search of DRM 2.4.3."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

COUNTS = 4000
SLOW = 0.5e-3


@dataclass
class Shaft:
    """Permanent-magnet rotor with Coulomb friction and an encoder that starts at 0."""

    theta_e: float  # electrical angle at time 0 [rad]
    inertia: float = 0.8e-5  # [kg m^2]
    friction: float = 2e-3  # Coulomb friction [N m]
    pole_pairs: int = 2
    psi: float = 0.0154  # flux linkage of the magnets [Wb]
    resistance: float = 0.55  # winding resistance [ohm]
    locked: bool = False  # blocked shaft
    counted: bool = True  # the encoder counts; motion while False is lost
    backwards: bool = False  # the encoder counts in the other direction
    stops: tuple[float, float] = (-math.inf, math.inf)  # mechanical end stops, from the angle at time 0 [rad]
    load: float = 0.0  # external torque against positive motion [N m]
    speed: float = field(default=0.0, init=False)  # mechanical speed [rad/s]
    moved: float = field(default=0.0, init=False)  # mechanical angle since time 0 [rad]
    missed: float = field(default=0.0, init=False)  # motion that the encoder did not count [rad]

    @property
    def angle(self) -> float:
        """Present electrical angle, -pi .. pi [rad]."""
        angle = self.theta_e + self.pole_pairs * self.moved
        return math.remainder(angle, 2.0 * math.pi)

    @property
    def counts(self) -> int:
        """Encoder position since time 0 [counts]."""
        counts = math.floor((self.moved - self.missed) / (2.0 * math.pi) * COUNTS + 0.5)
        return -counts if self.backwards else counts

    def emf_across(self, vector: float) -> float:
        """Back-EMF across a vector at an electrical angle [V]."""
        return self.pole_pairs * self.speed * self.psi * math.cos(self.angle - vector)

    def slow_tick(self, current: float, vector: float, shorted: bool, steps: int = 10) -> None:
        """Run 0.5 ms with a current vector [A] at an electrical angle [rad], or with shorted windings."""
        dt, k_t = SLOW / steps, 1.5 * self.pole_pairs * self.psi
        for _ in range(steps):
            if shorted:
                torque = -k_t * self.pole_pairs * self.psi * self.speed / self.resistance
            else:
                torque = k_t * current * math.sin(vector - self.angle)
            torque -= self.load
            if self.locked:
                self.speed = 0.0
            if self.locked or (self.speed == 0.0 and abs(torque) <= self.friction):
                return  # at rest until the vector changes
            direction = math.copysign(1.0, self.speed if self.speed != 0.0 else torque)
            speed = self.speed + (torque - direction * self.friction) / self.inertia * dt
            self.speed = 0.0 if speed * direction < 0.0 else speed  # friction does not reverse the motion
            step = self.speed * dt
            if not self.stops[0] <= self.moved + step <= self.stops[1]:
                step = self.speed = 0.0
            self.moved += step
            self.missed += 0.0 if self.counted else step
