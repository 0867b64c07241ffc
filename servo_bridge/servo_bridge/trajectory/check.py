"""Check of the limits of a path over its whole duration: exact extrema of every piece."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from servo_msgs_py.rounding import rounded_up

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import DEGREE, Path
from servo_bridge.trajectory.polynomials import derivative, enclosure, extrema, first_above, roots
from servo_bridge.trajectory.waypoints import DURATION_MAX, Array

_ROUNDING = 1.0e-9
"""Tolerance of a limit for rounding, relative to the larger of the limit and 1."""

_SHORT = 1.0e-6
"""Fraction of a piece: in shorter parts, as between its end at rest and the root there, the sign of the velocity is
that of a rounding error."""

_UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "torque": "N m"}


@dataclass(frozen=True)
class Limits:
    """Limits of one joint (infinite: no limit), and the rigid model for the torque.

    torque = inertia * acceleration + viscous * velocity + coulomb * sign(velocity) + effort

    Raises
    ------
    ValueError
        If a number is NaN, a magnitude is negative, or `position_min` is above `position_max`.
    """

    position_min: float = -math.inf  # [rad]
    position_max: float = math.inf  # [rad]
    velocity_max: float = math.inf  # magnitude [rad/s]
    acceleration_max: float = math.inf  # magnitude [rad/s^2]
    torque_max: float = math.inf  # magnitude [N m]
    inertia: float = 0.0  # of rotor and load [kg m^2]
    viscous: float = 0.0  # friction [N m s/rad]
    coulomb: float = 0.0  # friction [N m]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if math.isnan(value) or (value < 0.0 and not name.startswith("position")):
                raise ValueError(f"{name} is {value:g}; write a number that is not negative")
        if self.position_min > self.position_max:
            raise ValueError(f"position_min {self.position_min:g} is above position_max {self.position_max:g}")


@dataclass(frozen=True)
class Violation:
    """First time at which a path exceeds a limit."""

    joint: str  # name
    quantity: str  # ``position``, ``velocity``, ``acceleration`` or ``torque``
    time: float  # at which the limit is exceeded, in path time [s]
    since_start: float  # `time` minus the start of the path [s]
    value: float  # extremum in this piece of the path, in the unit of the quantity
    limit: float  # in the unit of the quantity

    def __str__(self) -> str:
        unit, side = _UNITS[self.quantity], "above" if self.value > self.limit else "below"
        return (
            f"{self.quantity} of {self.joint} is {side} its limit {self.limit:g} {unit} at {self.since_start:.6g} s "
            f"with a peak of {self.value:g} {unit}"
        )


def first_violation(path: Path, limits: Sequence[Limits], *, returning: bool = False) -> Violation | None:
    """Find the first violation; None if all limits hold at all times.

    Parameters
    ----------
    path : Path
        Motion.
    limits : sequence of Limits
        Per joint of the path.
    returning : bool
        A piece that begins outside of the position limits may lead towards them, as on the board.
    """
    found = [v for axis, limit in enumerate(limits) for v in _violations(path, axis, limit, returning)]
    return min(found, key=lambda violation: violation.time, default=None)


def require(path: Path, limits: Sequence[Limits]) -> None:
    """Refuse a path that exceeds a limit; from outside of the position limits it may return.

    Raises
    ------
    TrajectoryError
        With the text of `first_violation`, and what to change.
    """
    violation = first_violation(path, limits, returning=True)
    if violation is not None:
        raise TrajectoryError(f"{violation}; {_remedy(path, limits, violation)}, or change the limit")


def least(holds: Callable[[float], bool], first: float, largest: float) -> float | None:
    """Smallest number, to a thousandth, for which a condition holds that also holds for every larger one.

    Parameters
    ----------
    holds : callable
        Condition.
    first : float
        The result, if the condition holds for it; above 0.
    largest : float
        No larger number is tried.

    Returns
    -------
    float or None
        A number for which the condition holds; None if there is none.
    """
    high = first
    while not holds(high):
        high *= 2.0
        if high > largest:
            return None
    low = max(0.5 * high, first)
    while high > 1.001 * low:
        middle = math.sqrt(high * low)
        if holds(middle):
            high = middle
        else:
            low = middle
    return high


def _remedy(path: Path, limits: Sequence[Limits], violation: Violation) -> str:
    if violation.quantity == "position":
        return "move the waypoints inside the limit"
    if path.state(path.start_time).velocity.any():
        return "use more time for the motion"  # which begins with the same speed then: the shape changes
    dynamic = [replace(limit, position_min=-math.inf, position_max=math.inf) for limit in limits]

    def holds(time: float) -> bool:
        return first_violation(path.in_time(time), dynamic) is None

    time = least(holds, path.duration, DURATION_MAX)
    if time is None:
        return "use less effort" if violation.quantity == "torque" else "use another path"
    return f"use {rounded_up(time):g} s or more for the motion instead of {path.duration:g} s"


def _violations(path: Path, axis: int, limits: Limits, returning: bool) -> Iterator[Violation]:
    """First violation of each quantity of one joint."""
    h = np.diff(path.times)[:, None]
    position = path.coefficients[:, axis] * h ** np.arange(DEGREE + 1)
    velocity = derivative(position) / h
    acceleration = derivative(velocity) / h
    # The Coulomb term, sign(velocity), is added in `_in_piece`.
    torque = limits.inertia * acceleration + limits.viscous * velocity
    torque[:, 0] += path.efforts[:-1, axis]
    torque[:, 1] += np.diff(path.efforts[:, axis])
    for quantity, polynomials, low, high, coulomb in (
        ("position", position, limits.position_min, limits.position_max, 0.0),
        ("velocity", velocity, -limits.velocity_max, limits.velocity_max, 0.0),
        ("acceleration", acceleration, -limits.acceleration_max, limits.acceleration_max, 0.0),
        ("torque", torque, -limits.torque_max, limits.torque_max, limits.coulomb),
    ):
        smallest, largest = enclosure(polynomials)
        lows, highs = np.full(len(h), low), np.full(len(h), high)
        if returning and quantity == "position":
            lows, highs = np.minimum(lows, position[:, 0]), np.maximum(highs, position[:, 0])
        for k in np.flatnonzero((smallest - coulomb < lows) | (largest + coulomb > highs)):
            hit = _in_piece(polynomials[k], velocity[k], coulomb, float(lows[k]), float(highs[k]))
            if hit is not None:
                s, value, limit = hit
                since = float(path.times[k] - path.start_time + s * h[k, 0])
                yield Violation(path.joints[axis], quantity, path.start_time + since, since, value, limit)
                break


def _in_piece(
    polynomial: Array, velocity: Array, coulomb: float, low: float, high: float
) -> tuple[float, float, float] | None:
    """First violation in a piece: s, the extremum on this side of the limits, and the limit."""
    hits: list[tuple[float, float, float]] = []
    cuts = np.concatenate(([0.0], roots(velocity) if coulomb else [], [1.0]))
    for begin, end in pairwise(cuts):
        if end - begin < _SHORT:
            continue
        shifted = polynomial.copy()
        shifted[0] += coulomb * np.sign(np.polynomial.polynomial.polyval(0.5 * (begin + end), velocity))
        s, values = extrema(shifted, float(begin), float(end))
        for sign, limit in ((1.0, high), (-1.0, low)):
            peak = float((sign * values).max())
            bound = sign * limit + _ROUNDING * max(1.0, abs(limit))
            if peak > bound:
                hits.append((first_above(sign * shifted, s, sign * values, bound), sign * peak, limit))
        if hits:
            return min(hits)
    return None
