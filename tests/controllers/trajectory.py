"""Trajectories of the joint_trajectory_controller: points, interpolation, start at a wrapped position."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Point:
    """Waypoint, or a sampled state."""

    positions: tuple[float, ...]  # [rad]
    velocities: tuple[float, ...] = ()  # [rad/s]; empty: not given
    accelerations: tuple[float, ...] = ()  # [rad/s^2]; empty: not given
    time: float = 0.0  # from the start of the trajectory [s]


@dataclass(frozen=True)
class Sampled:
    """Result of `Trajectory.sample`."""

    state: Point  # of the reference
    reached: float  # time from the start of the trajectory of the point that begins the segment [s]
    finished: bool  # whether the last point has been reached


class Trajectory:
    """A trajectory that a controller follows.

    Parameters
    ----------
    points : sequence of Point
        At least one.
    """

    def __init__(self, points: Sequence[Point]) -> None:
        self.points = tuple(points)
        self.start: float | None = None  # time of the first sample [s]
        self._before: Point | None = None
        self._before_time = 0.0

    def set_start(self, time: float, state: Point, continuous: Sequence[bool]) -> None:
        """Set the state before the first point.

        Parameters
        ----------
        time : float
            Time of the state [s].
        state : Point
            The state.
        continuous : sequence of bool
            Joints that wrap: the state is moved by whole turns to within pi of the first point.
        """
        first = self.points[0]
        positions = tuple(
            wrapped_near(position, target) if wraps else position
            for position, target, wraps in zip(state.positions, first.positions, continuous, strict=True)
        )
        zeros = (0.0,) * len(positions)
        self._before = Point(
            positions,
            state.velocities or (zeros if first.velocities else ()),
            state.accelerations or (zeros if first.accelerations else ()),
        )
        self._before_time = time

    def sample(self, time: float) -> Sampled | None:
        """State of the reference at a time [s]; None before `set_start`."""
        if self.start is None:
            self.start = time
        if time < self._before_time:
            return None
        assert self._before is not None
        since, first = time - self.start, self.points[0]
        if since < first.time:
            begin = self._before_time - self.start
            state = _between(begin, self._before, first.time, first, since)
            return Sampled(state, first.time, False)
        for last, following in zip(self.points, self.points[1:], strict=False):
            if last.time <= since < following.time:
                return Sampled(_between(last.time, last, following.time, following, since), last.time, False)
        last = self.points[-1]
        zeros = (0.0,) * len(last.positions)
        state = replace(last, velocities=last.velocities or zeros, accelerations=last.accelerations or zeros)
        return Sampled(state, last.time, True)


def _between(t0: float, a: Point, t1: float, b: Point, t: float) -> Point:
    """Interpolate: quintic, cubic or linear, by what both ends contain."""
    h, s = t1 - t0, t - t0
    with_velocity = bool(a.velocities and b.velocities)
    with_acceleration = bool(a.accelerations and b.accelerations) and with_velocity
    if not 0.0 <= s <= h:
        s = min(max(s, 0.0), h)
        with_velocity = with_acceleration = False
    rows = []
    for k, (p0, p1) in enumerate(zip(a.positions, b.positions, strict=True)):
        if not with_velocity:
            coefficients = [p0, (p1 - p0) / h if h else 0.0]
        elif not with_acceleration:
            coefficients = _cubic(h, p0, a.velocities[k], p1, b.velocities[k])
        else:
            ends = (p0, a.velocities[k], a.accelerations[k]), (p1, b.velocities[k], b.accelerations[k])
            coefficients = _quintic(h, *ends)
        rows.append(_evaluate(coefficients, s))
    position, velocity, acceleration = zip(*rows, strict=True)
    return Point(position, velocity, acceleration, b.time)


def _cubic(h: float, p0: float, v0: float, p1: float, v1: float) -> list[float]:
    if not h:
        return [p0, v0]
    slope = (p1 - p0) / h
    return [p0, v0, (3.0 * slope - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * slope) / h**2]


def _quintic(h: float, begin: tuple[float, float, float], end: tuple[float, float, float]) -> list[float]:
    (p0, v0, a0), (p1, v1, a1) = begin, end
    if not h:
        return [p0, v0, 0.5 * a0]
    d = p1 - p0 - v0 * h - 0.5 * a0 * h**2
    dv, da = v1 - v0 - a0 * h, a1 - a0
    return [
        p0,
        v0,
        0.5 * a0,
        (10.0 * d - 4.0 * dv * h + 0.5 * da * h**2) / h**3,
        (-15.0 * d + 7.0 * dv * h - da * h**2) / h**4,
        (6.0 * d - 3.0 * dv * h + 0.5 * da * h**2) / h**5,
    ]


def _evaluate(coefficients: Sequence[float], s: float) -> tuple[float, float, float]:
    """Value of a polynomial with its first and second derivative."""
    position = velocity = acceleration = 0.0
    for coefficient in reversed(coefficients):
        acceleration = acceleration * s + 2.0 * velocity
        velocity = velocity * s + position
        position = position * s + coefficient
    return position, velocity, acceleration


def shortest_distance(begin: float, end: float) -> float:
    """Angle from `begin` to `end` within -pi .. pi [rad]."""
    return math.remainder(end - begin, 2.0 * math.pi)


def wrapped_near(position: float, target: float) -> float:
    """Position moved by whole turns to within pi of a target [rad]; a distance of pi keeps its direction."""
    distance = shortest_distance(position, target)
    if abs(abs(distance) - math.pi) < 1e-9:
        distance = math.copysign(distance, target - position)
    return target - distance
