"""Streamed set-points, converted to a smooth path for the board.

The reference between two messages is a cubic Hermite piece; missing velocities are those of a Catmull-Rom spline.
After the newest message it continues with constant velocity for a limited time, and then stops. A tracker of limited
acceleration follows the reference: late, lost or wrong messages cause a lag, but no step. The lag is made up for within
`CATCH_UP` times the velocity and the acceleration of the messages themselves, and the position limits are kept.
"""

from __future__ import annotations

import math
from bisect import bisect_left

import numpy as np
from servo_msgs_py.units import PERIOD

from servo_bridge.trajectory.playout import PlayoutClock
from servo_bridge.trajectory.timed_points import TimedPoints
from servo_bridge.trajectory.tracker import Tracker

STEP_PERIODS = 160
"""Distance of points, 10 ms [PWM periods]."""

_HISTORY = 64
"""Messages kept, more than needed for the largest delay."""

_STOP_SHARE = 0.5
"""Fraction of the acceleration limit with which a reference without messages stops."""

CATCH_UP = 1.5
"""Velocity and acceleration of the joint relative to those of the messages in the last second, when it makes up for a
lag."""

_CATCH_UP_SPEED = 0.5
"""Additional velocity for this [rad/s]."""

_CATCH_UP_TIME = 0.1
"""Time in which this velocity is reached, if the acceleration of the messages is smaller [s]."""

_MEMORY = 1.0
"""Time constant with which earlier velocities and accelerations of the messages are forgotten [s]."""

_REST, _REST_SPEED = 1.0e-4, 1.0e-2
"""Distance to the resting reference [rad] and velocity [rad/s] of the motor, below which it is brought to rest."""


class Stream:
    """Converts streamed set-points of one joint to timed points.

    Pieces between points have constant acceleration, for which the interpolation of the board is exact. The motion
    begins with the first set-point, at the present position, and ends at rest when messages are missing.

    Parameters
    ----------
    tracker : Tracker
        State at the effect of the first set-point, `lead` after its arrival, and limits. Use a new stream if the joint
        has been moved otherwise.
    lead : float
        Time before their due time at which points are fetched: `points` is called for a time this much ahead [s].
    begin : int
        Earliest point [PWM periods].
    delay_max : float, optional
        Bound of the delay and of the extrapolation [s]; default: see `PlayoutClock`.
    gear_ratio : float
        Turns of the motor per turn of the joint.

    Raises
    ------
    ValueError
        If a limit is not above 0.
    """

    def __init__(
        self, tracker: Tracker, lead: float, begin: int, *, delay_max: float | None = None, gear_ratio: float = 1.0
    ) -> None:
        if not (tracker.acceleration_max > 0.0 and tracker.velocity_max > 0.0):
            raise ValueError("limits must be above 0")
        self.clock = PlayoutClock(lead, delay_max)  # delay of the messages, with figures for the report
        self.moving = False  # whether the stream is active
        self._tracker = tracker
        self._gear_ratio = gear_ratio
        self._tick = begin
        self._begins = self._ends = False
        self._bridged = 0.0  # time for which the reference continues after the newest message [s]
        self._fastest = self._strongest = 0.0  # of the messages in the last second [rad/s], [rad/s^2]
        self._messages: list[tuple[float, float, float | None, float]] = []
        """Stamp, position, velocity and effort; in the order of stamps."""
        self._out: list[tuple[int, float, float, float]] = []  # tick, position, velocity, effort

    def take(
        self, stamp: float, arrival: float, position: float, velocity: float | None = None, effort: float = 0.0
    ) -> None:
        """Process a message.

        Parameters
        ----------
        stamp : float
            Time of the clock of the sender; the arrival if there is no stamp [s].
        arrival : float
            Time of the local clock, as in `points` [s].
        position, velocity, effort : float
            Finite numbers [rad], [rad/s], [N m]; velocity None: not given.
        """
        if not self.clock.belongs(stamp, arrival):
            self.clock.reset()
            self._messages.clear()
        self.clock.add_message(stamp, arrival)
        self._bridged = self.clock.bound + self.clock.lead
        if not self.moving:
            self._tick = max(math.ceil((arrival + self.clock.lead) / PERIOD), self._tick)
            self.moving = self._begins = True
        k = bisect_left(self._messages, (stamp,))
        same = k < len(self._messages) and self._messages[k][0] == stamp
        self._messages[k : k + same] = [(stamp, position, velocity, effort)]
        del self._messages[:-_HISTORY]
        self._remember(min(k, len(self._messages) - 1))

    def _remember(self, k: int) -> None:
        """Update the largest velocity and acceleration with a message."""
        velocity, before = self._velocity(k), max(k - 1, 0)
        elapsed = self._messages[k][0] - self._messages[before][0]
        kept = math.exp(-elapsed / _MEMORY)
        self._fastest = max(abs(velocity), kept * self._fastest)
        if elapsed > PERIOD:
            # Velocities that are not given are slopes: the newest and the mean of the last two, half a period apart.
            share = 0.5 if self._messages[k][2] is None else 1.0
            change = abs(velocity - self._velocity(before)) / (share * elapsed)
            self._strongest = max(change, kept * self._strongest)

    def points(self, until: float) -> TimedPoints | None:
        """Fetch the new points up to a time [s]; None if there are none."""
        while self.moving and (self._tick + STEP_PERIODS) * PERIOD <= until:
            self._advance()
        if not self._out:
            return None
        periods, *columns = zip(*self._out, strict=True)
        self._out.clear()
        return TimedPoints(np.array(periods), *(np.array(column) for column in columns))

    @property
    def starved(self) -> bool:
        """Whether it stops, because messages are missing for longer than the bridged time."""
        return self.moving and self._ends

    def _advance(self) -> None:
        h = STEP_PERIODS * PERIOD
        tracker = self._tracker
        stamp, rate = self.clock.due(self._tick * PERIOD, h)
        if self._begins:
            self._out.append((self._tick, tracker.position, tracker.velocity, 0.0))
            self._begins = False
        self._tick += STEP_PERIODS
        position, velocity, _, _ = self._reference(stamp)
        _, ahead, effort, self._ends = self._reference(stamp + rate * h)
        rest, may_rest = tracker.stopped(h)
        arrival = tracker.permitted(position)
        fastest = CATCH_UP * self._fastest + _CATCH_UP_SPEED if self._fastest else math.inf
        strongest = max(CATCH_UP * self._strongest, fastest / _CATCH_UP_TIME)
        tracker.advance(
            position, rate * velocity, rate * (ahead - velocity) / h, h, fastest=fastest, strongest=strongest
        )
        speed = max(map(abs, (tracker.velocity, velocity, ahead)))
        distance = abs(rest - arrival)
        near = max(distance / _REST, speed / _REST_SPEED) * self._gear_ratio < 1.0
        if may_rest and near and self._ends:
            self.moving, tracker.position, tracker.velocity = False, rest, 0.0
        elif may_rest and near and not (velocity or ahead):
            # Between points closer than the rounding of the board a segment with a velocity would swing to both sides.
            tracker.position, tracker.velocity = arrival, 0.0
        self._out.append((self._tick, tracker.position, tracker.velocity, effort))

    def _reference(self, stamp: float) -> tuple[float, float, float, bool]:
        """Position, velocity and effort at a stamp, and whether it is beyond the bridged time."""
        deceleration = _STOP_SHARE * self._tracker.acceleration_max
        k = bisect_left(self._messages, (stamp,)) - 1
        if k + 1 < len(self._messages) and k >= 0:
            return (*self._between(k, stamp), False)
        k = max(k, 0)
        begin, position, _, effort = self._messages[k]
        velocity = self._velocity(k)
        beyond = min(stamp - begin, self._bridged)
        position += velocity * beyond
        braking = stamp - begin - beyond
        deceleration = math.copysign(deceleration, velocity)
        slowing = min(braking, velocity / deceleration)
        position += slowing * (velocity - 0.5 * slowing * deceleration)
        return position, velocity - slowing * deceleration, 0.0 if braking > 0.0 else effort, braking > 0.0

    def _between(self, k: int, stamp: float) -> tuple[float, float, float]:
        (t0, p0, _, e0), (t1, p1, _, e1) = self._messages[k], self._messages[k + 1]
        v0, v1 = self._velocity(k), self._velocity(k + 1)
        h, s = t1 - t0, stamp - t0
        slope = (p1 - p0) / h
        c2, c3 = (3.0 * slope - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * slope) / h**2
        position = p0 + s * (v0 + s * (c2 + s * c3))
        return position, v0 + s * (2.0 * c2 + 3.0 * s * c3), e0 + (e1 - e0) * s / h

    def _velocity(self, k: int) -> float:
        """Velocity of a message; if not given, the slope between its neighbours."""
        velocity = self._messages[k][2]
        if velocity is not None:
            return velocity
        before, after = self._messages[max(k - 1, 0)], self._messages[min(k + 1, len(self._messages) - 1)]
        return (after[1] - before[1]) / (after[0] - before[0]) if before is not after else 0.0
