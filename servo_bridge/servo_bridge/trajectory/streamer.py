"""Streamed set-points of the joints of a board: begin, feeding and end of one stream per joint.

Times are board time [s].
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Final

from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.units import PERIOD

from servo_bridge.admission import JOIN_DISTANCE
from servo_bridge.set_points import JointSetPoint
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.errors import POINTS_REFUSED, TrajectoryError
from servo_bridge.trajectory.follower import Follower, PathEvents, Plan
from servo_bridge.trajectory.line_capacity import PointLine
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.playout import PlayoutFigures
from servo_bridge.trajectory.shapes import stop
from servo_bridge.trajectory.stream import STEP_PERIODS, Stream
from servo_bridge.trajectory.tracker import Tracker

_WAITING_MAX: Final = 64
"""Messages kept for a stream that has not begun."""

_AT_REST: Final = 1.0e-9
"""Velocity [rad/s] and acceleration [rad/s^2] below which a joint is at rest."""


_MARGIN: Final = 0.02
"""Margin that remains when the lead decreases, from the effect of a write to its first point: the segment that ends at
the point, 10 ms, and delays of the computer [s]."""

_MARGIN_RELEASE: Final = 0.002
"""Rate at which an observed small margin is forgotten, and largest decrease of the lead per time [s/s]."""

_MARGIN_MIN: Final = 0.008
"""Margin below which the lead is increased; less than a segment, because the first write of a stream has less [s]."""

_REFUSED: Final = 0.01
"""Increase of the lead after the board has refused points of a joint [s]."""

_LEAD_MAX: Final = 0.2
"""Largest lead [s]."""

_FLOOR_DECAY: Final = 0.0001
"""Rate at which it is forgotten that a smaller lead was too small [s/s]."""


def stream_lead(baud: int) -> float:
    """Time before its due time at which a point of a beginning stream is sent [s].

    Terms: the segment that ends at the point, 10 ms; the lead of the board, 1.5 ms; the check of eight points, 5 ms;
    the remainder of 27 ms is for the computer. Line, 450 bytes: a sample (83 bytes), a preceding write of eight points
    (142 bytes) with the sample that confirms it, and the write itself.

    Parameters
    ----------
    baud : int
        Line speed [bit/s].
    """
    return 0.027 + 450 * 10 / baud


@dataclass(frozen=True)
class StreamReport(PlayoutFigures):
    """State of all streams together: the largest figures, and the joints."""

    moving: tuple[str, ...]  # joints with an active stream
    starved: tuple[str, ...]  # joints that stop, because messages are missing for longer than the bridged time


@dataclass
class _Joint:
    """Stream of one joint; pending messages before it has begun."""

    limits: Limits
    stream: Stream | None = None
    plan: Plan | None = None  # of the path
    waiting: deque[tuple[float, float, JointSetPoint]] = field(default_factory=lambda: deque(maxlen=_WAITING_MAX))
    """Stamp [s], arrival [s] and set-point of each message."""


class Streamer:
    """Converts streamed set-points to paths of a follower.

    The lead adapts to line and computer: it increases at once if points arrive late at the board, and decreases slowly
    as long as all of them arrive early, but not to a value that was too small.

    Parameters
    ----------
    joints : sequence of Joint
        In the order of the axes.
    follower : Follower
        Sends the points to the board.
    lead : float
        Lead at the begin of a stream, see `stream_lead` [s].
    delay_max : float, optional
        Bound of the delay that bridges jitter and loss [s]; default: see `PlayoutClock`.
    line : callable, optional
        The line to the board; None: without limit.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        follower: Follower,
        lead: float,
        delay_max: float | None = None,
        line: Callable[[], PointLine | None] = lambda: None,
    ) -> None:
        self._joints = joint_names(joints)
        self._gear_ratios = [joint.gear_ratio for joint in joints]
        self._margins = [follower.count / joint.gear_ratio for joint in joints]
        """Distance of a stream from the position limits, for the rounding of points [rad]."""
        self._follower = follower
        self._lead = self._lead_begin = lead
        self._floor = 0.0  # below this the lead was too small [s]
        self._margin = _MARGIN  # smallest margin in memory [s]
        self._arrived = math.inf  # time of the last margin [s]
        self._delay_max = delay_max
        self._line = line
        self._advanced = -math.inf
        self._streams: dict[int, _Joint] = {}
        self._last: StreamReport | None = None

    def take(self, points: Mapping[int, JointSetPoint], stamp: float, arrival: float, limits: Sequence[Limits]) -> None:
        """Process a message whose values have been checked (`require_within`).

        Parameters
        ----------
        points : mapping of int to JointSetPoint
            By axis; each has a position.
        stamp : float
            Time of the clock of the sender; the arrival if there is no stamp [s].
        arrival : float
            Board time [s].
        limits : sequence of Limits
            Of every axis; a stream keeps its initial limits.
        """
        self._remove_replaced()
        new = [axis for axis in points if axis not in self._streams]
        for axis in new:
            self._streams[axis] = _Joint(limits[axis])
        for axis, point in points.items():
            mine = self._streams[axis]
            if mine.stream is None or mine.plan is None:
                mine.waiting.append((stamp, arrival, point))
            else:
                _feed(mine.stream, stamp, arrival, point)
        if new:
            self._lead = max(self._lead, self._lead_begin)
            self._request_axes(new)

    def require_carried(self, source: str, axes: Collection[int]) -> None:
        """Check that the line carries the points of new streams of some axes beside the present ones and other paths.

        Raises
        ------
        TrajectoryError
            If it does not.
        """
        self._remove_replaced()
        line, streams = self._line(), self._streams.keys() | set(axes)
        rate, path_rate = len(streams) / (STEP_PERIODS * PERIOD), self._follower.path_rate(streams)
        if line is not None and len(streams) > len(self._streams) and rate + path_rate > line.rate:
            joints = ", ".join(self._joints[axis] for axis in sorted(streams))
            beside = f" beside {path_rate} of the path of the other joint" if path_rate else ""
            raise TrajectoryError(
                f"{source}: the stream of {joints} needs {rate:.0f} points/s of the board{beside}, and the line "
                f"carries {line.rate:.0f} at {line.text} beside the telemetry; use a higher line speed, less "
                "telemetry, or send positions without velocities and efforts",
                kind="the line",
            )

    def streams(self, axis: int) -> bool:
        """Whether an axis follows a stream, or will begin to."""
        self._remove_replaced()
        return axis in self._streams

    def advance(self, now: float) -> None:
        """Pass the points on that are due at a time [s]."""
        self._advanced = now
        for axis, mine in self._streams.items():
            joint = self._joints[axis]
            if mine.stream is None or mine.plan is None or not self._follower.follows(joint, mine.plan):
                continue
            mine.stream.clock.lead = self._lead
            points = mine.stream.points(now + self._lead)
            if points is not None:
                self._follower.extend(joint, points)
        self._remove_replaced()

    def arrived(self, margin: float) -> None:
        """Adapt the lead to the time between the effect of a write and its first point [s]."""
        if margin < _MARGIN_MIN:
            self._increase_lead(_MARGIN_MIN - margin)
        if not self._streams:
            return  # the margin of a trajectory
        elapsed = min(max(self._advanced - self._arrived, 0.0), 1.0)
        self._arrived = self._advanced
        self._floor = max(self._floor - _FLOOR_DECAY * elapsed, 0.0)
        self._margin = min(self._margin + _MARGIN_RELEASE * elapsed, margin)
        spare = min(self._margin - _MARGIN, self._lead - self._floor)
        if spare > 0.0:
            self._lead -= spare
            self._margin -= spare

    def _increase_lead(self, by: float) -> None:
        self._lead = self._floor = min(self._lead + by, max(self._lead, _LEAD_MAX))

    @property
    def report(self) -> StreamReport | None:
        """State of all streams together; None before the first one."""
        streams = {self._joints[axis]: mine.stream for axis, mine in self._streams.items() if mine.stream is not None}
        if streams:
            figures = [stream.clock.figures for stream in streams.values()]
            self._last = StreamReport(
                **{each.name: max(getattr(one, each.name) for one in figures) for each in fields(PlayoutFigures)},
                moving=tuple(joint for joint, stream in streams.items() if stream.moving),
                starved=tuple(joint for joint, stream in streams.items() if stream.starved),
            )
        elif self._last is not None:
            self._last = replace(self._last, moving=(), starved=())
        return self._last

    # ---- begin and end
    def _request_axes(self, axes: Sequence[int]) -> None:
        """Request the begin of new streams."""
        joints = [self._joints[axis] for axis in axes]
        arrival = max(self._streams[axis].waiting[0][1] for axis in axes)

        def plan(running: Path, now: float) -> Path:
            begin = max(round(now / PERIOD), math.ceil((arrival + self._lead) / PERIOD))
            start = running.select(joints).state(begin * PERIOD)
            for k, axis in enumerate(axes):
                self._begin(axis, float(start.position[k]), float(start.velocity[k]), begin)
            # Path for the case that the streams do not continue.
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
            for axis in axes:
                self._streams.pop(axis, None)

        def abandoned(reason: str) -> None:
            if reason == POINTS_REFUSED:
                self._increase_lead(_REFUSED)

        self._follower.request(joints, plan, PathEvents(begun, refused, abandoned), period=STEP_PERIODS)

    def _begin(self, axis: int, position: float, velocity: float, begin: int) -> None:
        """Create the stream of a joint; repeated if the path is planned again for a later begin."""
        mine = self._streams[axis]
        limits, margin = mine.limits, self._margins[axis]
        mine.stream = Stream(
            Tracker(
                position,
                velocity,
                limits.acceleration_max,
                limits.velocity_max,
                limits.position_min + margin,
                limits.position_max - margin,
            ),
            self._lead,
            begin,
            delay_max=self._delay_max,
            gear_ratio=self._gear_ratios[axis],
        )
        for message in mine.waiting:
            _feed(mine.stream, *message)

    def _remove_replaced(self) -> None:
        for axis, mine in list(self._streams.items()):
            if mine.plan is not None and not self._follower.follows(self._joints[axis], mine.plan):
                del self._streams[axis]


def _feed(stream: Stream, stamp: float, arrival: float, point: JointSetPoint) -> None:
    """Pass a message to the stream of its joint."""
    assert point.position is not None
    stream.take(stamp, arrival, point.position, point.velocity, point.effort or 0.0)


def require_within(source: str, joint: str, point: JointSetPoint, limits: Limits, position: float) -> None:
    """Check a streamed set-point; a joint outside of its position limits may return.

    Parameters
    ----------
    source, joint : str
        Names for messages.
    point : JointSetPoint
        To be checked.
    limits : Limits
        Of the joint.
    position : float
        Of the joint [rad].

    Raises
    ------
    TrajectoryError
        If a value exceeds its limit.
    """
    lowest, highest = limits.position_min, limits.position_max
    outside = not lowest <= position <= highest
    lowest = min(lowest, position - JOIN_DISTANCE) if position < lowest else lowest
    highest = max(highest, position + JOIN_DISTANCE) if position > highest else highest
    returns = f"; the joint is at {position:g} rad, outside of its limits, and can only return" if outside else ""
    rows = (
        ("position", "rad", point.position, lowest, highest),
        ("velocity", "rad/s", point.velocity, -limits.velocity_max, limits.velocity_max),
        ("effort", "N m", point.effort, -limits.torque_max, limits.torque_max),
    )
    for name, unit, value, low, high in rows:
        if value is not None and not low <= value <= high:
            raise TrajectoryError(
                f"{source}: {name} of {joint} is {value:g} {unit}, outside {low:g} .. {high:g} {unit}; send a value "
                f"within this range, or change the limits in the parameters of bridge and board{returns}",
                kind=f"{name} of {joint}",
            )
