"""Streamed set-points, converted to a smooth path for the board.

The reference between two messages is a cubic Hermite piece; missing velocities are those of a Catmull-Rom spline.
After the newest message it continues with constant velocity for a limited time, and then stops. A tracker of limited
acceleration follows the reference: late, lost or wrong messages cause a lag, but no step.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import State
from servo_bridge.trajectory.playout import PlayoutClock
from servo_bridge.trajectory.timed_points import PERIOD, SEGMENT_PERIODS_MIN, TimedPoints
from servo_bridge.trajectory.tracker import Tracker

STEP_PERIODS = 160
"""Distance of points, 10 ms [PWM periods]."""

_HISTORY = 64
"""Messages kept per joint, more than needed for the largest delay."""

_STOP_SHARE = 0.5
"""Fraction of the acceleration limit with which a reference without messages stops."""

_REST, _REST_SPEED = 1.0e-4, 1.0e-2
"""Distance to the stopped reference [rad] and velocity [rad/s] of the motor, below which it is brought to rest."""


@dataclass(frozen=True)
class StreamReport:
    """State of a stream."""

    delay: float  # from the arrival of the fastest message to its use in the path [s]
    jitter: float  # spread of the transit times [s]
    period: float  # period of the stamps [s]
    received: int  # messages
    lost: int  # missing messages
    late: int  # messages after their due time
    moving: tuple[str, ...]  # joints with an active stream
    starved: tuple[str, ...]  # joints that stop, because messages are missing for longer than the bridged time


@dataclass
class _Joint:
    """Set-points of one joint, sorted by stamp: (stamp, position, velocity or NaN, effort)."""

    tracker: Tracker
    gear_ratio: float = 1.0  # turns of the motor per turn of the joint
    points: list[tuple[float, float, float, float]] = field(default_factory=list)  # in the order of stamps
    active: bool = False
    begins: bool = False
    starved: bool = False
    effort: float = 0.0  # [N m]
    out: list[tuple[int, float, float, float]] = field(default_factory=list)  # tick, position, velocity, effort

    def take(self, stamp: float, position: float, velocity: float, effort: float) -> None:
        k = bisect_left(self.points, (stamp,))
        same = k < len(self.points) and self.points[k][0] == stamp
        self.points[k : k + same] = [(stamp, position, velocity, effort)]
        del self.points[:-_HISTORY]

    def _velocity(self, k: int) -> float:
        """Velocity of a point; if not given, the slope between its neighbours."""
        if not math.isnan(self.points[k][2]):
            return self.points[k][2]
        before, after = self.points[max(k - 1, 0)], self.points[min(k + 1, len(self.points) - 1)]
        return (after[1] - before[1]) / (after[0] - before[0]) if before is not after else 0.0

    def reference(self, stamp: float, bridge: float) -> tuple[float, float, float, bool]:
        """Position, velocity and effort at a stamp, and whether messages are missing for longer than `bridge` [s]."""
        deceleration = _STOP_SHARE * self.tracker.acceleration_max
        if not self.points:
            speed = self.tracker.velocity
            return self.tracker.position + 0.5 * speed * abs(speed) / deceleration, 0.0, 0.0, True
        k = bisect_left(self.points, (stamp,)) - 1
        if k + 1 < len(self.points) and k >= 0:
            return (*self._between(k, stamp), False)
        k = max(k, 0)
        begin, position, _, effort = self.points[k]
        velocity = self._velocity(k)
        beyond = min(stamp - begin, bridge)
        position += velocity * beyond
        braking = stamp - begin - beyond
        deceleration = math.copysign(deceleration, velocity)
        slowing = min(braking, velocity / deceleration)
        position += slowing * (velocity - 0.5 * slowing * deceleration)
        return position, velocity - slowing * deceleration, 0.0 if braking > 0.0 else effort, braking > 0.0

    def _between(self, k: int, stamp: float) -> tuple[float, float, float]:
        (t0, p0, _, e0), (t1, p1, _, e1) = self.points[k], self.points[k + 1]
        v0, v1 = self._velocity(k), self._velocity(k + 1)
        h, s = t1 - t0, stamp - t0
        slope = (p1 - p0) / h
        c2, c3 = (3.0 * slope - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * slope) / h**2
        position = p0 + s * (v0 + s * (c2 + s * c3))
        return position, v0 + s * (2.0 * c2 + 3.0 * s * c3), e0 + (e1 - e0) * s / h


class Stream:
    """Converts streamed set-points of several joints to timed points.

    Pieces between points have constant acceleration, for which the interpolation of the board is exact. A joint begins
    with its first set-point, at its present position, and ends at rest when messages are missing.

    Parameters
    ----------
    joints : sequence of str
        Names.
    start : State
        State of shape (joints,) at the effect of the first set-point, `lead` after its arrival. Use a new stream if the
        joints have been moved otherwise.
    acceleration_max : sequence of float
        Limit per joint [rad/s^2].
    velocity_max : sequence of float, optional
        Limit per joint [rad/s].
    lead : float
        Time before their due time at which points are fetched: `points` is called for a time this much ahead [s].
    delay_max : float, optional
        Bound of the delay and of the extrapolation [s]; default: one period of the stream.
    step : int
        Distance of the points [PWM periods].
    begin : int, optional
        Earliest point [PWM periods].
    gear_ratios : sequence of float, optional
        Turns of the motor per turn of each joint; 1 by default.

    Raises
    ------
    ValueError
        If a limit is not above 0, or the step is too short for the board.
    """

    def __init__(
        self,
        joints: Sequence[str],
        start: State,
        acceleration_max: Sequence[float],
        velocity_max: Sequence[float] | None = None,
        *,
        lead: float = 0.02,
        delay_max: float | None = None,
        step: int = STEP_PERIODS,
        begin: int | None = None,
        gear_ratios: Sequence[float] | None = None,
    ) -> None:
        ratios = [1.0] * len(joints) if gear_ratios is None else gear_ratios
        speeds = [math.inf] * len(joints) if velocity_max is None else velocity_max
        if not all(x > 0.0 for x in (*acceleration_max, *speeds)) or step < SEGMENT_PERIODS_MIN:
            raise ValueError(f"limits must be above 0 and the step at least {SEGMENT_PERIODS_MIN} periods")
        self._delay_max, self._step = delay_max, step
        self._clock = PlayoutClock(lead, delay_max)
        self._tick = begin
        self._joints: dict[str, _Joint] = {
            joint: _Joint(Tracker(float(p), float(v), a, s), ratio)
            for joint, p, v, a, s, ratio in zip(
                joints, start.position, start.velocity, acceleration_max, speeds, ratios, strict=True
            )
        }

    def take(
        self,
        stamp: float,
        arrival: float,
        positions: Sequence[float],
        velocities: Sequence[float] | None = None,
        efforts: Sequence[float] | None = None,
    ) -> None:
        """Process a message.

        Parameters
        ----------
        stamp : float
            Time of the clock of the sender; the arrival if there is no stamp [s].
        arrival : float
            Time of the local clock, as in `points` [s].
        positions, velocities, efforts : sequence of float
            Per joint [rad], [rad/s], [N m]. Position NaN: no set-point for the joint; velocity NaN: not given.

        Raises
        ------
        TrajectoryError
            If a size is wrong or a number is infinite; then nothing is changed.
        """
        count = len(self._joints)
        nothing = {"positions": math.nan, "velocities": math.nan, "efforts": 0.0}
        given = {"positions": positions, "velocities": velocities, "efforts": efforts}
        rows = {
            name: [nothing[name]] * count if row is None or not len(row) else list(row) for name, row in given.items()
        }
        for name, row in rows.items():
            if len(row) != count:
                raise TrajectoryError(f"{len(row)} {name} for {count} joints; send one per joint")
            for joint, value in zip(self._joints, row, strict=True):
                if math.isinf(value):
                    raise TrajectoryError(f"{name} of {joint} is {value:g}; send a finite number, or NaN for none")
        if not self._clock.belongs(stamp, arrival):
            self._clock.reset()
            for state in self._joints.values():
                state.points.clear()
        self._clock.add_message(stamp, arrival)
        first = math.ceil((arrival + self.lead) / PERIOD)
        if self._tick is None or not any(state.active for state in self._joints.values()):
            self._tick = max(first, self._tick or first)
        for state, p, v, e in zip(self._joints.values(), *rows.values(), strict=True):
            if math.isnan(p):
                continue
            state.take(stamp, p, v, 0.0 if math.isnan(e) else e)
            if not state.active:
                state.active = state.begins = True

    def points(self, until: float) -> dict[str, TimedPoints]:
        """Fetch the new points up to a time [s], by joint; joints without new points are omitted."""
        while self._tick is not None and (self._tick + self._step) * PERIOD <= until:
            if not any(state.active for state in self._joints.values()):
                break
            self._advance(self._tick)
        result = {}
        for joint, state in self._joints.items():
            if state.out:
                periods, *columns = zip(*state.out, strict=True)
                result[joint] = TimedPoints(np.array(periods), *(np.array(column) for column in columns))
                state.out.clear()
        return result

    @property
    def lead(self) -> float:
        """Time before their due time at which points are fetched [s]; the delay follows changes slowly."""
        return self._clock.lead

    @lead.setter
    def lead(self, value: float) -> None:
        self._clock.lead = value

    @property
    def report(self) -> StreamReport:
        """State of the stream."""
        clock = self._clock
        moving = tuple(joint for joint, state in self._joints.items() if state.active)
        starved = tuple(joint for joint in moving if self._joints[joint].starved)
        return StreamReport(
            clock.delay, clock.jitter, clock.period, clock.received, clock.lost, clock.late, moving, starved
        )

    def _advance(self, tick: int) -> None:
        h = self._step * PERIOD
        stamp, rate = self._clock.due(tick * PERIOD, h)
        bridge = self._clock.period if self._delay_max is None else self._delay_max
        bridge += self.lead
        self._tick = tick + self._step
        for state in self._joints.values():
            if not state.active:
                continue
            if state.begins:
                state.out.append((tick, state.tracker.position, state.tracker.velocity, 0.0))
                state.begins = False
            position, velocity, _, _ = state.reference(stamp, bridge)
            _, ahead, effort, state.starved = state.reference(stamp + rate * h, bridge)
            tracker = state.tracker
            rest, may_rest = tracker.stopped(h)
            tracker.advance(position, rate * velocity, rate * (ahead - velocity) / h, h)
            speed = max(map(abs, (tracker.velocity, velocity, ahead)))
            distance = abs(rest - position)
            near = max(distance / _REST, speed / _REST_SPEED) * state.gear_ratio < 1.0
            if state.starved and may_rest and near:
                state.active, tracker.position, tracker.velocity = False, rest, 0.0
            state.out.append((self._tick, tracker.position, tracker.velocity, effort))
