"""Tracks a reference with limited acceleration, velocity and position, in steps of constant acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass

_SMOOTHING = 4.0
"""Steps for the correction of a small error; more steps are smoother and slower."""

_RESERVE = 0.2
"""Smallest fraction of the acceleration limit that is available for corrections."""


@dataclass
class Tracker:
    """Position and velocity of one joint."""

    position: float  # [rad]
    velocity: float  # [rad/s]
    acceleration_max: float  # limit [rad/s^2]
    velocity_max: float = math.inf  # limit [rad/s]; a faster start is decelerated
    position_min: float = -math.inf  # limit [rad]; from outside it moves towards the limits only
    position_max: float = math.inf  # limit [rad]

    def advance(
        self,
        position: float,
        velocity: float,
        acceleration: float,
        step: float,
        *,
        fastest: float = math.inf,
        strongest: float = math.inf,
    ) -> None:
        """Advance by one step.

        Parameters
        ----------
        position, velocity, acceleration : float
            Reference at the begin of the step, [rad], [rad/s] and [rad/s^2].
        step : float
            Duration [s].
        fastest : float
            Largest velocity [rad/s].
        strongest : float
            Largest acceleration of the correction of an error, beside that of the reference [rad/s^2].
        """
        forward = min(max(acceleration, -self.acceleration_max), self.acceleration_max)
        authority = max(self.acceleration_max - abs(forward), _RESERVE * self.acceleration_max)
        authority, velocity_max = min(authority, strongest), min(self.velocity_max, fastest)
        behind, slower = self.position - position, self.velocity - velocity
        u = forward + _time_optimal(behind, slower, authority, _SMOOTHING * step)
        u = min(max(u, (-velocity_max - self.velocity) / step), (velocity_max - self.velocity) / step)
        u = self._below(u, self.position_max - self.position, self.velocity, step)
        u = -self._below(-u, self.position - self.position_min, -self.velocity, step)
        u = min(max(u, -self.acceleration_max), self.acceleration_max)
        self.position += step * (self.velocity + 0.5 * step * u)
        self.velocity += step * u

    def _below(self, u: float, distance: float, velocity: float, h: float) -> float:
        """Largest acceleration up to `u` after which the joint can still stop within a distance to a limit."""
        if math.isinf(distance):
            return u
        # A stop from the velocity w in whole steps takes at most w^2 / (2 a) + h w / 2; after this step:
        # h (v + w) / 2 + w^2 / (2 a) + h w / 2 = distance.
        a, room = self.acceleration_max, max(distance - 0.5 * h * velocity, 0.0)
        w = a * (math.sqrt(h * h + 2.0 * room / a) - h)
        return min(u, (w - velocity) / h)

    def permitted(self, position: float) -> float:
        """Position within the limits that is closest to a position [rad]; from outside no further out."""
        return min(max(position, min(self.position_min, self.position)), max(self.position_max, self.position))

    def stopped(self, step: float) -> tuple[float, bool]:
        """Final position of a constant deceleration to rest within one step [rad], and whether it is within the limit.

        Parameters
        ----------
        step : float
            Duration [s].
        """
        return self.position + 0.5 * step * self.velocity, abs(self.velocity) <= step * self.acceleration_max


def _time_optimal(x1: float, x2: float, r: float, h: float) -> float:
    """Acceleration, |u| <= r, that brings an error x1 and its derivative x2 to zero without chatter.

    fhan of J. Han, From PID to Active Disturbance Rejection Control, IEEE Trans. Ind. Electron. 56(3), 2009.
    """
    d = r * h * h
    a0 = h * x2
    y = x1 + a0
    far = math.copysign(0.5 * (math.sqrt(d * (d + 8.0 * abs(y))) - d), y)
    a = a0 + (y if abs(y) <= d else far)
    return -r * a / d if abs(a) <= d else -math.copysign(r, a)
