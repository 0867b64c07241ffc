"""Sends the timed points of paths to the board ahead of time, limited by the queues of the board.

Times are board time: PWM periods since reset, extended beyond 32 bits, or seconds. Every axis has its own path. A new
path replaces it after `LEAD`, starting with the state of the old path at that time. Paths are in joint units, reports
and points of the board in motor units.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.timed_points import POINTS_PER_WRITE, TimedPoint, encode_points

from servo_bridge.trajectory.blend import extended, spliced
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.merge import merged
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.timed_points import PERIOD, SEGMENT_PERIODS_MIN, TimedPoints, concatenated, timed_points

LEAD: Final = 0.1
"""Time from the newest telemetry to the first point [s]: a sample in transit, two writes, 1.5 ms of the board, and
delays of a busy computer."""

_LEADS: Final = (LEAD, 3.0 * LEAD, 9.0 * LEAD)
"""Lead of a path from standstill at each attempt [s]: on a busy computer the first points may come too late."""

_LEAD_REMAINDER_MIN: Final = 0.7
"""Smallest fraction of the lead that must remain after the planning of a path."""

_LATE: Final = 0.02
"""Estimated time before the start of a path at which its points come too late for the board [s]."""

_LEAD_MAX: Final = 5.0
"""Largest lead [s]."""

_PLAN_AHEAD: Final = 0.4
"""Time before its start at which a path is planned and sent [s]; until then the present path continues."""

_HISTORY = round(0.2 / PERIOD)
"""Past of an extended path that is kept, because the next path starts from it [PWM periods]."""

_EXTENSIONS_PER_REBUILD: Final = 32
"""Extensions of a path that are merged at once; one by one they would take a third of the processor time."""

_QUEUE: Final = 14
"""Queued points of an axis on the board; the queue has 16."""

Plan = Callable[[Path, float], Path]
"""Returns a path that begins at a time [s] or later, from the path that all joints follow until then; raises
`TrajectoryError`."""


@dataclass(frozen=True)
class AxisReport:
    """State of an axis in the newest sample."""

    position_ref: float  # set-point of the motor [rad]
    follows: bool  # the axis was in mode TRAJECTORY at this sample


@dataclass
class _Request:
    """Request of a path, and its progress."""

    axes: tuple[int, ...]
    plan: Plan
    start: float  # not before this time [s]
    begun: Callable[[float], None]
    refused: Callable[[TrajectoryError], None]
    abandoned: Callable[[str], None] | None
    postponed: Callable[[], bool] | None
    takes_over: str
    attempt: int = 0  # index in `_LEADS`
    repeatable: bool = False  # its joints had no path, and the board has not accepted a point


@dataclass
class _Axis:
    """Path of one axis and its points that are not sent yet."""

    path: Path | None = None
    request: _Request | None = None  # of the path
    tail: list[TimedPoints] = field(default_factory=list)  # extensions of the path since `whole`
    position_ref: float = 0.0  # of the joint
    waiting: deque[TimedPoint] = field(default_factory=deque)
    ticks: deque[int] = field(default_factory=deque)  # of `waiting`, extended
    sent: deque[int] = field(default_factory=deque)  # ticks of points in the queue of the board
    held: float | None = None  # position reference of the last report, without a path

    def end(self) -> int:
        """End of the path with its extensions [PWM periods]."""
        assert self.path is not None
        return int(self.tail[-1].periods[-1]) if self.tail else round(self.path.end_time / PERIOD)

    def whole(self, since: int) -> Path:
        """Merge the extensions into the path and return it, from a tick on."""
        assert self.path is not None
        if self.tail:
            self.path = extended(self.path, concatenated(self.tail), since * PERIOD)
            self.tail.clear()
        return self.path


class Follower:
    """Sends the paths of all axes of one board.

    Parameters
    ----------
    catalogue : Catalogue
        Scales of the points.
    joints : sequence of Joint
        In the order of the axes.
    check : callable
        Raises `TrajectoryError` for a path that exceeds the limits.
    clock : callable, optional
        Time [s] with any origin, to measure the duration of the planning.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[Joint],
        check: Callable[[Path], None],
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._clock = clock
        self._catalogue = catalogue
        self._joints = joint_names(joints)
        self._gears = list(joints)
        self._check = check
        self._axes = [_Axis() for _ in range(AXES)]
        self._request: _Request | None = None
        self._now = 0
        self._sampled = 0.0  # time of the host at the newest sample [s]
        self.torque_constants: Sequence[float] | None = None

    # ---- requests
    def request(
        self,
        joints: Sequence[str],
        plan: Plan,
        begun: Callable[[float], None],
        refused: Callable[[TrajectoryError], None],
        start: float = 0.0,
        abandoned: Callable[[str], None] | None = None,
        postponed: Callable[[], bool] | None = None,
        takes_over: str = "another trajectory took over",
    ) -> None:
        """Follow a path as soon as the axes are ready; a pending request is replaced.

        Parameters
        ----------
        joints : sequence of str
            Joints of the path.
        plan : Plan
            Plans the path when the state at its begin is known.
        begun : callable
            Called with the end of the path [s] when its first points are about to be sent.
        refused : callable
            Called instead if the path is refused.
        start : float
            Earliest begin [s].
        abandoned : callable, optional
            Called with the reason if the path has begun but is not followed to its end; once per joint.
        postponed : callable, optional
            Called if the first points of a path from standstill have reached the board too late. True: the path is
            planned again and begins later. False, or without this function: it is abandoned. A path with `start` is
            always abandoned.
        takes_over : str
            Reported for the replaced paths and request.
        """
        if self._request is not None:
            self._request.refused(TrajectoryError(takes_over))
        axes = tuple(self._joints.index(joint) for joint in joints)
        self._request = _Request(axes, plan, start, begun, refused, abandoned, postponed, takes_over)

    def withdraw(self, plan: Plan) -> None:
        """Discard a request that has not begun, without a result."""
        if self._request is not None and self._request.plan is plan:
            self._request = None

    def cancel(self, axis: int, reason: str) -> None:
        """Discard the path of an axis, and a request for this axis."""
        ended = self._discard(axis)
        if ended is not None and ended.abandoned is not None:
            ended.abandoned(reason)
        request = self._request
        if request is not None and axis in request.axes:
            self._request = None
            request.refused(TrajectoryError(reason))

    def _discard(self, axis: int) -> _Request | None:
        """Discard the path of an axis and return its request."""
        before = self._axes[axis]
        self._axes[axis] = _Axis(position_ref=before.position_ref)
        return before.request

    def points_accepted(self, axes: Iterable[int]) -> None:
        """The board has accepted points of these axes."""
        for axis in axes:
            request = self._axes[axis].request
            if request is not None:
                request.repeatable = False

    def postpone(self, axes: Collection[int]) -> bool:
        """Plan a path again with a longer lead, if the board has refused its first points because they came too late.

        Parameters
        ----------
        axes : collection of int
            Axes of the refused points.

        Returns
        -------
        bool
            False: nothing is changed; the caller ends the paths of these axes.
        """
        request = self._axes[min(axes)].request
        if request is None or not request.repeatable or self._request is not None:
            return False
        if any(self._axes[axis].request is not request for axis in (*axes, *request.axes)):
            return False
        late = self._time() > self._start(request) - _LATE
        if not late or request.start or request.attempt + 1 == len(_LEADS):
            return False
        if request.postponed is None or not request.postponed():
            return False
        for axis in request.axes:
            self._discard(axis)
        request.attempt += 1
        self._request = request
        return True

    def _time(self) -> float:
        """Board time, estimated with the clock of the host [s]."""
        return self.now + self._clock() - self._sampled

    def _start(self, request: _Request) -> float:
        """Start of the path of a request [s]."""
        return min(path.start_time for path in (self._axes[axis].path for axis in request.axes) if path is not None)

    @property
    def now(self) -> float:
        """Board time of the newest sample [s]."""
        return self._now * PERIOD

    @property
    def axes(self) -> frozenset[int]:
        """Axes that must be in mode TRAJECTORY."""
        requested = set(self._request.axes) if self._request is not None else set()
        return frozenset(requested | {axis for axis, one in enumerate(self._axes) if one.path is not None})

    def paths(self) -> Mapping[str, Path]:
        """Paths by joint."""
        return {
            self._joints[axis]: one.whole(self._now - _HISTORY)
            for axis, one in enumerate(self._axes)
            if one.path is not None
        }

    def follows(self, joint: str, plan: Plan) -> bool:
        """True if a joint follows the path of a plan, or an extension of it."""
        request = self._axes[self._joints.index(joint)].request
        return request is not None and request.plan is plan

    def extend(self, joint: str, points: TimedPoints) -> None:
        """Extend the path of a joint along timed points.

        Parameters
        ----------
        joint : str
            Joint with a path.
        points : TimedPoints
            The first one continues the path, within it or at its end; the later part of the path is replaced.
        """
        axis = self._joints.index(joint)
        one = self._axes[axis]
        first = int(points.periods[0])
        within = first < one.end()
        if within or len(one.tail) >= _EXTENSIONS_PER_REBUILD:
            one.whole(self._now - _HISTORY)
        self._drop_from(one, first)
        self._put(axis, points, replaces=within)
        one.tail.append(points)
        if within:
            one.whole(self._now - _HISTORY)

    # ---- telemetry
    def on_sample(self, tick: int, reports: Sequence[AxisReport]) -> None:
        """Process a sample; begin a pending request if the axes are ready.

        Parameters
        ----------
        tick : int
            Extended tick of the sample.
        reports : sequence of AxisReport
            Per axis.
        """
        self._now, self._sampled = tick, self._clock()
        for one in self._axes:
            while one.sent and one.sent[0] <= tick:
                one.sent.popleft()
            ended = one.path is not None and not one.waiting and tick > one.end() + round(LEAD / PERIOD)
            if ended and not (one.request is not None and one.request.repeatable):
                one.path = one.request = None
                one.tail.clear()
        if self._request is not None and self._ready(self._request, reports):
            self._begin(self._request)
        for one, report, joint in zip(self._axes, reports, self._gears, strict=True):
            one.held = report.position_ref if report.follows and one.path is None else None
            one.position_ref = joint.position(report.position_ref)

    def _ready(self, request: _Request, reports: Sequence[AxisReport]) -> bool:
        """True if every axis follows a path, or holds an unchanged position since the last sample."""
        if self._now * PERIOD + _PLAN_AHEAD < request.start:
            return False
        return all(
            reports[axis].follows
            and (self._axes[axis].path is not None or self._axes[axis].held == reports[axis].position_ref)
            for axis in request.axes
        )

    def running(self) -> Path:
        """Present paths of all joints; joints without a path hold their set-point."""
        time = self._now * PERIOD
        return merged(
            [
                Path.hold([joint], [one.position_ref], time) if one.path is None else one.whole(self._now - _HISTORY)
                for joint, one in zip(self._joints, self._axes, strict=True)
            ]
        )

    def _begin(self, request: _Request) -> None:
        self._request = None
        begin = self._clock()
        lead_min = lead = _LEADS[request.attempt]
        try:
            while True:
                time = (self._now + round((self._clock() - begin + lead) / PERIOD)) * PERIOD
                path, points = self._plan(request, time)
                # The planning time grows with the number of points; the board needs the first point in time.
                spent = self._now * PERIOD + self._clock() - begin
                if path.start_time - spent > _LEAD_REMAINDER_MIN * lead_min or lead > _LEAD_MAX:
                    break
                lead += LEAD + 2.0 * (self._clock() - begin)
        except TrajectoryError as error:
            request.refused(error)
            return
        request.repeatable = all(self._axes[axis].path is None for axis in request.axes)
        for axis in map(self._joints.index, path.joints):
            joint = self._joints[axis]
            one = self._axes[axis]
            if one.path is not None:
                one.whole(self._now - _HISTORY)
            mine = _after(one, points[joint])
            self._drop_from(one, int(mine.periods[0]))
            self._put(axis, mine, replaces=True)
            own = path.select([joint])
            one.path = own if one.path is None else spliced(one.path, own, time)
            replaced, one.request = one.request, request
            if replaced is not None and replaced.abandoned is not None:
                replaced.abandoned(request.takes_over)
        request.begun(path.end_time)

    def _plan(self, request: _Request, time: float) -> tuple[Path, dict[str, TimedPoints]]:
        """Path of a request that begins at a time [s] or later, and its points by joint."""
        path = request.plan(self.running(), time)
        self._check(path)
        ratios = [self._gears[self._joints.index(joint)].gear_ratio for joint in path.joints]
        return path, timed_points(path, gear_ratios=ratios)

    def _put(self, axis: int, points: TimedPoints, *, replaces: bool) -> None:
        one, joint, constant = self._axes[axis], self._gears[axis], self._torque_constant(axis)
        positions = joint.motor_position(points.positions)
        velocities, efforts = joint.motor_velocity(points.velocities), joint.motor_effort(points.efforts)
        for k, period in enumerate(points.periods.tolist()):
            point = TimedPoint(
                axis,
                period % (1 << 32),
                float(positions[k]),
                float(velocities[k]),
                float(efforts[k]) / constant if efforts[k] else 0.0,
                replaces=replaces and k == 0,
            )
            one.waiting.append(point)
            one.ticks.append(period)

    def _torque_constant(self, axis: int) -> float:
        constants = self.torque_constants
        return constants[axis] if constants is not None and constants[axis] > 0.0 else 1.0

    @staticmethod
    def _drop_from(one: _Axis, tick: int) -> None:
        """Remove the points that the board discards: those from the first new point on."""
        while one.ticks and one.ticks[-1] >= tick:
            one.ticks.pop()
            one.waiting.pop()
        while one.sent and one.sent[-1] >= tick:
            one.sent.pop()

    # ---- transmission
    def next_points(self) -> tuple[int, ...] | None:
        """Words of the next points, the earliest first, limited by one write and the queues of the board."""
        chosen: list[TimedPoint] = []
        while len(chosen) < POINTS_PER_WRITE:
            ready = [one for one in self._axes if one.waiting and len(one.sent) < _QUEUE]
            if not ready:
                break
            one = min(ready, key=lambda candidate: candidate.ticks[0])
            if one.waiting[0].replaces and any(point.axis == one.waiting[0].axis for point in chosen):
                break  # a replacing point must be the first of its axis in a write
            chosen.append(one.waiting.popleft())
            one.sent.append(one.ticks.popleft())
        return tuple(encode_points(self._catalogue, chosen)) if chosen else None


def _after(one: _Axis, points: TimedPoints) -> TimedPoints:
    """Points that replace those of an axis from the first one on, adapted for the board.

    The board refuses segments shorter than 1 ms. If a point of the old path is too close to the first new point, it is
    replaced by a point of the old path with sufficient distance.
    """
    first = int(points.periods[0])
    kept = [tick for tick in (*one.sent, *one.ticks) if tick < first]
    if one.path is None or not kept or first - kept[-1] >= SEGMENT_PERIODS_MIN:
        return points
    last = first - SEGMENT_PERIODS_MIN
    before = max((tick for tick in kept if tick <= last), default=None)
    if before is not None and last - before < SEGMENT_PERIODS_MIN:
        last = before
    state = one.path.state(last * PERIOD)
    return TimedPoints(
        np.concatenate(([last], points.periods)),
        np.concatenate((state.position, points.positions)),
        np.concatenate((state.velocity, points.velocities)),
        np.concatenate((state.effort, points.efforts)),
    )
