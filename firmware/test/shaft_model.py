"""A shaft in a stator field: what the rotor search of DRM 2.4.3 has to deal with."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

COUNTS = 4000
SLOW = 0.5e-3


@dataclass
class Shaft:
    """Permanent-magnet rotor with Coulomb friction on an encoder that starts at 0.

    Attributes
    ----------
    theta_e : float
        Electrical angle at time 0 [rad].
    inertia, friction : float
        [kg m^2], [N m].
    locked : bool
        Held fast.
    seen : bool
        The encoder counts; what it misses is lost.
    backwards : bool
        The encoder counts the other way.
    stops : tuple of float
        End stops, mechanical, from the angle at time 0 [rad].
    load : float
        External torque against positive motion [N m].
    """

    theta_e: float
    inertia: float = 0.8e-5
    friction: float = 2e-3
    pole_pairs: int = 2
    psi: float = 0.0154
    resistance: float = 0.55
    locked: bool = False
    seen: bool = True
    backwards: bool = False
    stops: tuple[float, float] = (-math.inf, math.inf)
    load: float = 0.0
    speed: float = field(default=0.0, init=False)  # mechanical [rad/s]
    moved: float = field(default=0.0, init=False)  # mechanical [rad]
    missed: float = field(default=0.0, init=False)  # by the encoder [rad]

    @property
    def angle(self) -> float:
        """Electrical angle now [rad], wrapped to -pi .. pi."""
        angle = self.theta_e + self.pole_pairs * self.moved
        return math.remainder(angle, 2.0 * math.pi)

    @property
    def counts(self) -> int:
        """Encoder position since time 0."""
        counts = math.floor((self.moved - self.missed) / (2.0 * math.pi) * COUNTS + 0.5)
        return -counts if self.backwards else counts

    def emf_across(self, vector: float) -> float:
        """Voltage that the turning rotor induces across a vector at an electrical angle [V]."""
        return self.pole_pairs * self.speed * self.psi * math.cos(self.angle - vector)

    def slow_tick(self, current: float, vector: float, shorted: bool, steps: int = 10) -> None:
        """0.5 ms with a current vector [A] at an electrical angle [rad], or with the windings shorted."""
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
                continue
            direction = math.copysign(1.0, self.speed if self.speed != 0.0 else torque)
            speed = self.speed + (torque - direction * self.friction) / self.inertia * dt
            self.speed = 0.0 if speed * direction < 0.0 else speed  # friction stops, it does not push
            step = self.speed * dt
            if not self.stops[0] <= self.moved + step <= self.stops[1]:
                step = self.speed = 0.0
            self.moved += step
            self.missed += 0.0 if self.seen else step
