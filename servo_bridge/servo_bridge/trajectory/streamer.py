"""Streamed set-points of the joints of a board: each gets a stream when its axis is ready for one. Pure.

Times are board time [s].
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from servo_msgs_py.joints import Joint, joint_names

from servo_bridge.setpoints import JointSetPoint
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.errors import POINTS_REFUSED, TrajectoryError
from servo_bridge.trajectory.follower import Follower, Plan
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.shapes import stop
from servo_bridge.trajectory.stream import Stream, StreamReport
from servo_bridge.trajectory.timed_points import PERIOD

_WAITING_MAX: Final = 64
"""Messages that are kept for a stream that has not begun yet."""

_AT_REST: Final = 1.0e-9
"""Velocity [rad/s] and acceleration [rad/s^2] of a joint that rests."""


_MARGIN: Final = 0.008
"""What a write of points has to be early at the board [s]; one that is not makes the lead longer."""

_REFUSED: Final = 0.01
"""By how much the lead grows when the board has refused points of a joint [s]."""

_LEAD_MAX: Final = 0.2
"""Longest lead [s]."""

_RELAX: Final = 0.0001
"""How much shorter the lead becomes per second, down to where it began [s/s]."""


def stream_lead(baud: int) -> float:
    """How long before it is due a point of a stream is sent at first [s].

    The segment that ends there takes a step, 10 ms; the board needs a point 1.5 ms ahead and checks eight of them in
    5 ms; the rest of 27 ms is for the computer. On the line the tick is as old as its sample, 83 bytes. Where a write
    of eight points, 142 bytes, has just begun, it goes before with the sample that shows its effect, then comes the
    write itself: 450 bytes.

    Parameters
    ----------
    baud : int
        [bit/s]
    """
    return 0.027 + 450 * 10 / baud


@dataclass
class _Joint:
    """Stream of one joint; before it has begun, what has come for it."""

    limits: Limits
    stream: Stream | None = None
    plan: Plan | None = None  # of the path that has begun
    waiting: deque[tuple[float, float, JointSetPoint]] = field(default_factory=lambda: deque(maxlen=_WAITING_MAX))
    """Stamp [s], arrival [s] and set-point of each message."""


class Streamer:
    """Turns streamed set-points into paths of a follower.

    The lead is as long as the line and the computer need it: it grows where points come late to the board, and slowly
    shrinks again.

    Parameters
    ----------
    joints : sequence of Joint
        In the order of the axes.
    follower : Follower
        Brings them to the board.
    lead : float
        Least lead, see `stream_lead` [s].
    delay_max : float, optional
        Bound of the delay that bridges jitter and loss [s]; by default one period of the stream.
    """

    def __init__(
        self, joints: Sequence[Joint], follower: Follower, lead: float, delay_max: float | None = None
    ) -> None:
        self._joints = joint_names(joints)
        self._gear_ratios = [joint.gear_ratio for joint in joints]
        self._follower = follower
        self._lead = self._lead_min = lead
        self._delay_max = delay_max
        self._advanced = -math.inf
        self._streams: dict[int, _Joint] = {}
        self._asked: Plan | None = None
        self._last: StreamReport | None = None

    def take(self, points: Mapping[int, JointSetPoint], stamp: float, arrival: float, limits: Sequence[Limits]) -> None:
        """Take a message whose values have been checked (`require_within`).

        Parameters
        ----------
        points : mapping of int to JointSetPoint
            By axis; each has a position.
        stamp : float
            On the clock of the sender; the arrival where there is none [s].
        arrival : float
            [s]
        limits : sequence of Limits
            Of every axis; a stream keeps those with which it has begun.
        """
        self._forget_those_taken_over()
        new = [axis for axis in points if axis not in self._streams]
        for axis in new:
            self._streams[axis] = _Joint(limits[axis])
        for axis, point in points.items():
            mine = self._streams[axis]
            if mine.stream is None:
                mine.waiting.append((stamp, arrival, point))
            else:
                _feed(mine.stream, stamp, arrival, point)
        if new:
            self._ask()

    def advance(self, now: float) -> None:
        """Hand the points on that are due to be sent at a time [s]."""
        self._lead = max(self._lead_min, self._lead - _RELAX * min(max(now - self._advanced, 0.0), 1.0))
        self._advanced = now
        for axis, mine in self._streams.items():
            joint = self._joints[axis]
            if mine.stream is None or mine.plan is None or not self._follower.follows(joint, mine.plan):
                continue
            mine.stream.lead = self._lead
            for points in mine.stream.points(now + self._lead).values():
                self._follower.extend(joint, points)
        self._forget_those_taken_over()

    def arrived(self, margin: float) -> None:
        """Note how long before its first point is due a write took effect [s]."""
        self._lead = max(self._lead, min(self._lead + _MARGIN - margin, _LEAD_MAX))

    @property
    def report(self) -> StreamReport | None:
        """What is known of the streams together; None before the first one."""
        reports = [mine.stream.report for mine in self._streams.values() if mine.stream is not None]
        if reports:
            figures = ("delay", "jitter", "period", "received", "lost", "late")
            self._last = StreamReport(
                **{name: max(getattr(report, name) for report in reports) for name in figures},
                moving=tuple(joint for report in reports for joint in report.moving),
                starved=tuple(joint for report in reports for joint in report.starved),
            )
        elif self._last is not None:
            self._last = replace(self._last, moving=(), starved=())
        return self._last

    # ---- begin and end
    def _ask(self) -> None:
        """Ask for the axes of every stream that waits: a later request replaces an earlier one."""
        axes = [axis for axis, mine in self._streams.items() if mine.stream is None]
        joints = [self._joints[axis] for axis in axes]
        arrival = max(self._streams[axis].waiting[0][1] for axis in axes)

        def plan(running: Path, now: float) -> Path:
            begin = max(round(now / PERIOD), math.ceil((arrival + self._lead) / PERIOD))
            start = running.select(joints).state(begin * PERIOD)
            for k, axis in enumerate(axes):
                self._begin(axis, _state_of(start, k), begin)
            # What the joints do unless the streams go on.
            limits = [self._streams[axis].limits.acceleration_max for axis in axes]
            moving = abs(start.velocity).max() > _AT_REST or abs(start.acceleration).max() > _AT_REST
            if moving:
                return stop(joints, start, limits, begin * PERIOD)
            return Path.hold(joints, start.position, begin * PERIOD)

        def begun(_end: float) -> None:
            for axis in axes:
                mine = self._streams[axis]
                mine.plan = plan
                mine.waiting.clear()

        def refused(_error: TrajectoryError) -> None:
            if self._asked is not plan:
                return  # asked for again, together with another axis
            for axis in axes:
                self._streams.pop(axis, None)

        def abandoned(reason: str) -> None:
            if reason == POINTS_REFUSED:
                self._lead = min(self._lead + _REFUSED, _LEAD_MAX)

        self._asked = plan
        self._follower.request(joints, plan, begun, refused, abandoned=abandoned)

    def _begin(self, axis: int, start: State, begin: int) -> None:
        """Make the stream of a joint; anew if the path is worked out again for a later begin."""
        mine = self._streams[axis]
        mine.stream = Stream(
            [self._joints[axis]],
            start,
            [mine.limits.acceleration_max],
            [mine.limits.velocity_max],
            lead=self._lead,
            delay_max=self._delay_max,
            begin=begin,
            gear_ratios=[self._gear_ratios[axis]],
        )
        for message in mine.waiting:
            _feed(mine.stream, *message)

    def _forget_those_taken_over(self) -> None:
        for axis, mine in list(self._streams.items()):
            followed = mine.plan is not None and self._follower.follows(self._joints[axis], mine.plan)
            if mine.stream is not None and not followed:
                del self._streams[axis]


def _state_of(state: State, column: int) -> State:
    """State of one joint."""
    parts = (state.position, state.velocity, state.acceleration, state.effort)
    return State(*(part[column : column + 1] for part in parts))


def _feed(stream: Stream, stamp: float, arrival: float, point: JointSetPoint) -> None:
    """Hand a message to the stream of its joint."""
    assert point.position is not None
    velocity = math.nan if point.velocity is None else point.velocity
    stream.take(stamp, arrival, [point.position], [velocity], [point.effort or 0.0])


def require_within(source: str, joint: str, point: JointSetPoint, limits: Limits) -> None:
    """Check a streamed set-point.

    Raises
    ------
    TrajectoryError
        If one of its values is beyond its limit.
    """
    rows = (
        ("position", "rad", point.position, limits.position_min, limits.position_max),
        ("velocity", "rad/s", point.velocity, -limits.velocity_max, limits.velocity_max),
        ("effort", "N m", point.effort, -limits.torque_max, limits.torque_max),
    )
    for name, unit, value, low, high in rows:
        if value is not None and not low <= value <= high:
            raise TrajectoryError(
                f"{source}: {name} of {joint} is {value:g} {unit}, outside {low:g} .. {high:g} {unit}; send a value "
                "inside, or change the limits in the parameters of bridge and board"
            )
