"""Sends the timed points of paths to the board ahead of time, limited by the queues of the board.

Times are board time: PWM periods since reset, extended beyond 32 bits, or seconds. Every axis has its own path. A new
path replaces it after `LEAD`, starting with the state of the old path at that time. Paths are in joint units, reports
and points of the board in motor units.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from time import monotonic
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.timed_points import POINTS_PER_WRITE, TimedPoint, encode_points
from servo_msgs_py.units import PERIOD

from servo_bridge.trajectory.blend import extended, spliced
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.line_capacity import QUEUE, PointLine, busiest_second, demand
from servo_bridge.trajectory.merge import merged
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.point_queue import PointQueue
from servo_bridge.trajectory.spline import START_TOLERANCE
from servo_bridge.trajectory.thinning import thinned
from servo_bridge.trajectory.timed_points import SEGMENT_PERIODS_MIN, TimedPoints, concatenated, timed_points

LEAD: Final = 0.1
"""Time from the newest telemetry to the first point [s]: a sample in transit, two writes, 1.5 ms of the board, and
delays of a busy computer."""

_FIRST_WRITE: Final = 0.035
"""Part of `LEAD` for the first write, at 115200 baud [s]."""

_LEADS: Final = (LEAD, 3.0 * LEAD, 9.0 * LEAD)
"""Lead of a path from standstill at each attempt [s]: on a busy computer the first points may come too late."""

_LEAD_REMAINDER_MIN: Final = 0.7
"""Smallest fraction of the lead that must remain after the planning of a path."""

_LATE: Final = 0.02
"""Estimated time before the start of a path at which its points come too late for the board [s]."""

_BEGIN: Final = 0.5 * START_TOLERANCE
"""Largest motion of a joint along a path that may begin again from where it is then [rad]."""

_LEAD_MAX: Final = 5.0
"""Largest lead [s]."""

_PLAN_AHEAD: Final = 0.4
"""Time before its start at which a path is planned and sent [s]; until then the present path continues."""

_HISTORY = round(0.2 / PERIOD)
"""Past of an extended path that is kept, because the next path starts from it [PWM periods]."""

_EXTENSIONS_PER_REBUILD: Final = 32
"""Extensions of a path that are merged at once; one by one they would take a third of the processor time."""

QUICK: Final = 100
"""Number of points up to which a path is planned at once, in up to 10 ms of processor time."""

_PLANNING_TIME: Final = 1.0e-4
"""Estimated planning time per point on a busy computer, for a path with a start time [s]."""

_ATTEMPTS: Final = 4
"""Plannings of one path, if its joints move differently meanwhile."""

_UNCHANGED: Final = 1.0e-6
"""Largest change of a position [rad] or velocity [rad/s] at the start of a path while it was planned."""

T = TypeVar("T")

Plan = Callable[[Path, float], Path]
"""Returns a path that begins at a time [s] or later, from the path that all joints follow until then; raises
`TrajectoryError`."""


@dataclass(frozen=True)
class AxisReport:
    """State of an axis in the newest sample."""

    position_ref: float  # set-point of the motor [rad]
    follows: bool  # the axis was in mode TRAJECTORY at this sample


class Work(Protocol):
    """Runs `work` in another thread, and then `done` with the result in the thread of the follower."""

    def __call__(self, work: Callable[[], T], done: Callable[[Future[T]], None]) -> None: ...


@dataclass(frozen=True)
class Planned:
    """A path with its points."""

    path: Path  # the path
    points: Mapping[str, TimedPoints]  # by joint
    lead: float  # time that the line needs from the first write to the first point [s]


@dataclass(frozen=True)
class PathEvents:
    """What the follower calls in the course of a request."""

    begun: Callable[[float], None]
    """With the end of the path [s] when its first points are about to be sent."""
    refused: Callable[[TrajectoryError], None]
    """Instead of `begun`, with the reason."""
    abandoned: Callable[[str], None] = lambda _: None
    """With the reason if the path has begun but is not followed to its end; once per joint."""
    postponed: Callable[[], bool] = lambda: False
    """If the first points of a path from standstill have reached the board too late. True: the path is planned again
    and begins later; False: it is abandoned. A path with a start time is always abandoned."""
    checked: Callable[[], None] = lambda: None
    """The path is accepted. It begins when its axes are ready: those without a path are stopped now."""


@dataclass
class _Request:
    """Request of a path, and its progress."""

    axes: tuple[int, ...]
    plan: Plan
    start: float  # not before this time [s]
    on: PathEvents
    takes_over: str
    size: int  # number of waypoints
    movable: bool  # the whole path may be moved in time
    period: int  # of the points that extend the path [PWM periods]; 0: it is complete
    checked: bool = False  # it has been planned once
    pending: bool = True  # it has neither begun nor ended; read by the thread of the planner
    planning: bool = False  # it is being planned
    plannings: int = 0  # number of plannings in this attempt
    attempt: int = 0  # index in `_LEADS`
    lead: float = LEAD  # of the next planning [s]
    repeatable: bool = False  # its joints had no path, and move by less than `_BEGIN` with its points on the board


@dataclass
class _Axis:
    """Path of one axis and its points that are not sent yet."""

    waiting: PointQueue
    rate: int = 0  # largest number of the planned points in a second
    path: Path | None = None
    request: _Request | None = None  # of the path
    tail: list[TimedPoints] = field(default_factory=list)  # extensions of the path since `whole`
    position_ref: float = 0.0  # of the joint
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
    work : Work, optional
        Runs the planning of long paths; default: at once. `check` is called there.
    line : callable, optional
        The line to the board; None: without limit.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[Joint],
        check: Callable[[Path], None],
        clock: Callable[[], float] = monotonic,
        work: Work | None = None,
        line: Callable[[], PointLine | None] = lambda: None,
    ) -> None:
        self._clock = clock
        self._work: Work = work or at_once
        self._line = line
        self._catalogue = catalogue
        self.count = catalogue["axis1.position"].lsb  # of the motors [rad]
        self._joints = joint_names(joints)
        self._gears = list(joints)
        self._check = check
        self._axes = [_Axis(PointQueue(axis)) for axis in range(AXES)]
        self._requests: list[_Request] = []  # of different axes
        self._now = 0
        self._sampled = 0.0  # time of the host at the newest sample [s]
        self.torque_constants: Sequence[float] | None = None

    # ---- requests
    def request(
        self,
        joints: Sequence[str],
        plan: Plan,
        on: PathEvents,
        *,
        start: float = 0.0,
        takes_over: str = "another trajectory took over",
        size: int = 0,
        movable: bool = False,
        period: int = 0,
    ) -> None:
        """Follow a path as soon as its axes are ready; pending requests of these axes are replaced when it is checked.

        Parameters
        ----------
        joints : sequence of str
            Joints of the path.
        plan : Plan
            Plans the path when the state at its begin is known.
        on : PathEvents
            Receives the progress.
        start : float
            Earliest begin [s].
        takes_over : str
            Reported for the replaced paths and requests.
        size : int
            Number of waypoints. A path with waypoints is checked before it changes anything: up to `QUICK` at once,
            longer ones in another thread. Without waypoints the path is planned only when it begins.
        movable : bool
            The path of resting joints may be moved in time by whole PWM periods instead of being planned again.
        period : int
            Period of the points by which the path will be extended [PWM periods]; 0: it will not.

        Raises
        ------
        TrajectoryError
            If the path of up to `QUICK` waypoints is refused; then nothing is changed.
        """
        axes = tuple(self._joints.index(joint) for joint in joints)
        request = _Request(axes, plan, start, on, takes_over, size, movable, period)
        check = partial(self._checked, request, self.running(), self.now + LEAD)
        if 0 < size <= QUICK:
            check()
        self._requests.append(request)
        if size > QUICK:
            self._work(check, partial(self._take_check, request))
        else:
            self._accept(request)

    def _checked(self, request: _Request, running: Path, time: float) -> Path:
        """Path of a request that begins at a time [s] or later, within the limits."""
        _require_pending(request)
        path = request.plan(running, time)
        _require_pending(request)
        self._check(path)
        return path

    def _accept(self, request: _Request) -> None:
        """Replace the earlier requests of the axes of a checked one."""
        for other in self._requests[: self._requests.index(request)]:
            if set(other.axes) & set(request.axes):
                self._refuse(other, TrajectoryError(request.takes_over))
        request.checked = True
        request.on.checked()

    def _take_check(self, request: _Request, done: Future[Path]) -> None:
        """Go on with a long path whose first planning is complete, or refuse it; until then it changes nothing."""
        if request not in self._requests:
            return
        error = done.exception()
        if error is None:
            self._accept(request)
        else:
            self._refuse(request, _reported(error))

    def withdraw(self, plan: Plan) -> None:
        """Discard a request that has not begun, without a result."""
        for request in self._requests.copy():
            if request.plan is plan:
                self._remove(request)

    def end(self, axis: int, reason: str) -> None:
        """Discard the path of an axis; a request for this axis stays, and begins when the axis holds."""
        ended = self._discard(axis)
        if ended is not None:
            ended.on.abandoned(reason)

    def cancel(self, axis: int, reason: str) -> None:
        """Discard the path of an axis, and a request for this axis."""
        self.end(axis, reason)
        for request in self._requests.copy():
            if axis in request.axes:
                self._refuse(request, TrajectoryError(reason))

    def _discard(self, axis: int) -> _Request | None:
        """Discard the path of an axis and return its request."""
        before = self._axes[axis]
        self._axes[axis] = _Axis(PointQueue(axis), position_ref=before.position_ref)
        return before.request

    def points_accepted(self, axes: Iterable[int]) -> None:
        """The board has accepted the points of these axes that were sent."""
        for axis in axes:
            one = self._axes[axis]
            if one.request is None or one.path is None or not one.request.repeatable:
                continue
            times = np.array([one.path.start_time, *(tick * PERIOD for tick in one.sent or [self._now])])
            moved = np.ptp(one.path.continued(times).position, axis=0).max()
            waiting = any(self._axes[other].waiting for other in one.request.axes)
            one.request.repeatable = waiting and not one.request.period and bool(moved < _BEGIN)

    def postpone(self, axes: Collection[int]) -> bool:
        """Plan a path again with a longer lead, if the board has refused points of its begin that came too late.

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
        if request is None or not request.repeatable:
            return False
        if any(set(other.axes) & set(request.axes) for other in self._requests):
            return False
        if any(self._axes[axis].request is not request for axis in (*axes, *request.axes)):
            return False
        late = self._time() > self._start(request) - _LATE
        if not late or request.start or request.attempt + 1 == len(_LEADS):
            return False
        if not request.on.postponed():
            return False
        for axis in request.axes:
            self._discard(axis)
        request.attempt += 1
        request.plannings, request.lead = 0, _LEADS[request.attempt]
        request.pending = True
        self._requests.append(request)
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
        return self.moving.union(*(request.axes for request in self._requests if request.checked))

    @property
    def moving(self) -> frozenset[int]:
        """Axes with a path."""
        return frozenset(axis for axis, one in enumerate(self._axes) if one.path is not None)

    @property
    def claimed(self) -> frozenset[int]:
        """Axes with a path or a request."""
        return self.moving.union(*(request.axes for request in self._requests))

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
        """Process a sample; begin the requests whose axes are ready.

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
        for request in self._requests.copy():
            if request.checked and not request.planning and self._ready(request, reports):
                self._start_planning(request)
        for one, report, joint in zip(self._axes, reports, self._gears, strict=True):
            one.held = report.position_ref if report.follows and one.path is None else None
            one.position_ref = joint.position(report.position_ref)

    def _ready(self, request: _Request, reports: Sequence[AxisReport]) -> bool:
        """True if every axis follows a path, or holds an unchanged position since the last sample."""
        if self._now * PERIOD + _PLAN_AHEAD + request.size * _PLANNING_TIME < request.start:
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

    # ---- planning
    def _start_planning(self, request: _Request) -> None:
        request.planning = True
        request.plannings += 1
        time = (self._now + round((self._time() - self.now + request.lead) / PERIOD)) * PERIOD
        running = self.running()
        others = [one.waiting.ticks for axis, one in enumerate(self._axes) if axis not in request.axes and one.waiting]
        periods = self._stream_periods(request.axes)
        work = self._work if request.size > QUICK else at_once
        work(
            partial(self._plan, request, running, time, others, periods, self._line()),
            partial(self._take_plan, request, running, self._clock(), len(periods)),
        )

    def _stream_periods(self, besides: Collection[int]) -> list[int]:
        """Periods of the points of all streams of other axes, also of those that have not begun [PWM periods]."""
        requests = {axis: one.request for axis, one in enumerate(self._axes) if one.request is not None}
        requests |= {axis: request for request in self._requests for axis in request.axes}
        return [each.period for axis, each in requests.items() if each.period and axis not in besides]

    def path_rate(self, besides: Collection[int]) -> int:
        """Largest number of points in a second of the complete paths that other axes follow."""
        return sum(one.rate for axis, one in enumerate(self._axes) if axis not in besides and one.waiting)

    def _plan(
        self,
        request: _Request,
        running: Path,
        time: float,
        others: Sequence[NDArray[np.int64]],
        periods: Sequence[int],
        line: PointLine | None,
    ) -> Planned:
        """Path of a request that begins at a time [s] or later, and its points; beside the points of other axes."""
        path = self._checked(request, running, time)
        ratios = {joint: self._gears[self._joints.index(joint)].gear_ratio for joint in path.joints}
        _require_pending(request)
        points = timed_points(path, gear_ratios=list(ratios.values()))
        _require_pending(request)
        points = thinned(path, points, ratios)
        if line is None:
            return Planned(path, points, 0.0)
        own = [each.periods for each in points.values()]
        begin, end = (round(each / PERIOD) for each in (path.start_time, path.end_time))
        streams = [np.arange(begin, end, period) for period in periods]
        need = demand([*own, *others, *streams], line)
        if need.lead > _LEAD_MAX:
            subject = "the path and the stream of the other joint need" if streams else "the path needs"
            raise TrajectoryError(
                f"{subject} {need.rate} points/s of the board at {need.time:.3g} s after its start, and the line "
                f"carries {line.rate:.0f} at {line.text} beside the telemetry; use a higher line speed, less "
                "telemetry, or a smoother path with fewer waypoints per second"
            )
        return Planned(path, points, need.lead)

    def _take_plan(self, request: _Request, running: Path, begin: float, streams: int, done: Future[Planned]) -> None:
        """Follow a planned path, or plan it again after the next sample if it is late or the motion has changed."""
        if request not in self._requests:
            return  # replaced or cancelled in the meantime
        request.planning = False
        error = done.exception()
        if error is not None:
            self._refuse(request, _reported(error))
            return
        planned = done.result()
        path = planned.path
        # The same margin for delays of the computer remains if the board needs more writes before the start.
        lead_min = _LEADS[request.attempt] + max(planned.lead - _FIRST_WRITE, 0.0)
        late = path.start_time - self._time() < max(_LEAD_REMAINDER_MIN * lead_min, planned.lead)
        changed = not self._unchanged(request, running, path.start_time)
        changed |= len(self._stream_periods(request.axes)) > streams
        taken = self._clock() - begin
        if not changed and late and self._can_move(request):
            self._begin(request, _moved(planned, self._time() + lead_min))
        elif not (changed or late):
            self._begin(request, planned)
        elif changed and request.plannings >= _ATTEMPTS:
            self._refuse(request, TrajectoryError("its joints moved while it was planned; stop them first"))
        elif request.lead > _LEAD_MAX:
            reason = f"its planning takes {taken:.1f} s, in which its start has passed; send fewer waypoints"
            self._refuse(request, TrajectoryError(reason))
        else:
            request.lead = max(lead_min, request.lead + LEAD + 2.0 * taken)

    def _refuse(self, request: _Request, error: TrajectoryError) -> None:
        self._remove(request)
        request.on.refused(error)

    def _remove(self, request: _Request) -> None:
        self._requests.remove(request)
        request.pending = False

    def _can_move(self, request: _Request) -> bool:
        return request.movable and not request.start and all(self._axes[axis].path is None for axis in request.axes)

    def _unchanged(self, request: _Request, running: Path, time: float) -> bool:
        """True if the joints will be at a time [s] where they were expected to be when the planning began."""
        joints = [self._joints[axis] for axis in request.axes]
        then, now = (motion.select(joints).state(time) for motion in (running, self.running()))
        differences = np.abs((now.position - then.position, now.velocity - then.velocity))
        return bool(differences.max() <= _UNCHANGED)

    def _begin(self, request: _Request, planned: Planned) -> None:
        self._remove(request)
        path = planned.path
        request.repeatable = all(self._axes[axis].path is None for axis in request.axes)
        for axis in map(self._joints.index, path.joints):
            joint = self._joints[axis]
            one = self._axes[axis]
            if one.path is not None:
                one.whole(self._now - _HISTORY)
            mine = _after(one, planned.points[joint])
            self._drop_from(one, int(mine.periods[0]))
            self._put(axis, mine, replaces=True)
            one.rate = 0 if request.period else busiest_second(mine.periods * PERIOD)[0]
            own = path.select([joint])
            one.path = own if one.path is None else spliced(one.path, own, self._now * PERIOD)
            replaced, one.request = one.request, request
            if replaced is not None:
                replaced.on.abandoned(request.takes_over)
        request.on.begun(path.end_time)

    def _put(self, axis: int, points: TimedPoints, *, replaces: bool) -> None:
        joint = self._gears[axis]
        self._axes[axis].waiting.put(
            points.periods,
            joint.motor_position(points.positions),
            joint.motor_velocity(points.velocities),
            joint.motor_effort(points.efforts) / self._torque_constant(axis),
            replaces=replaces,
        )

    def _torque_constant(self, axis: int) -> float:
        constants = self.torque_constants
        return constants[axis] if constants is not None and constants[axis] > 0.0 else 1.0

    @staticmethod
    def _drop_from(one: _Axis, tick: int) -> None:
        """Remove the points that the board discards: those from the first new point on."""
        one.waiting.drop_from(tick)
        while one.sent and one.sent[-1] >= tick:
            one.sent.pop()

    # ---- transmission
    def next_points(self) -> tuple[int, ...] | None:
        """Words of the next points, the earliest first, limited by one write and the queues of the board."""
        chosen: list[TimedPoint] = []
        while len(chosen) < POINTS_PER_WRITE:
            ready = [one for one in self._axes if one.waiting and len(one.sent) < QUEUE]
            if not ready:
                break
            one = min(ready, key=lambda candidate: candidate.waiting.tick)
            if one.waiting.replaces and any(point.axis == self._axes.index(one) for point in chosen):
                break  # a replacing point must be the first of its axis in a write
            tick, point = one.waiting.pop()
            chosen.append(point)
            one.sent.append(tick)
        return tuple(encode_points(self._catalogue, chosen)) if chosen else None


def at_once(work: Callable[[], T], done: Callable[[Future[T]], None]) -> None:
    """`Work` in the present thread."""
    future: Future[T] = Future()
    try:
        future.set_result(work())
    except Exception as error:  # an exception would end the executor
        future.set_exception(error)
    done(future)


def _require_pending(request: _Request) -> None:
    """End the planning of a request that has been replaced or cancelled; between the steps of the planning."""
    if not request.pending:
        raise TrajectoryError("it has ended")


def _reported(error: BaseException) -> TrajectoryError:
    """Error of a planning in another thread as the reason of a refusal."""
    if isinstance(error, TrajectoryError):
        return error
    return TrajectoryError(f"internal error during the planning: {error!r}")


def _moved(planned: Planned, start: float) -> Planned:
    """A plan moved to a start [s] by whole PWM periods."""
    by = math.ceil((start - planned.path.start_time) / PERIOD)
    points = {joint: replace(each, periods=each.periods + by) for joint, each in planned.points.items()}
    return replace(planned, path=planned.path.shifted(by * PERIOD), points=points)


def _after(one: _Axis, points: TimedPoints) -> TimedPoints:
    """Points that replace those of an axis from the first one on, adapted for the board.

    The board refuses segments shorter than 1 ms. If a point of the old path is too close to the first new point, it is
    replaced by a point of the old path with sufficient distance.
    """
    first = int(points.periods[0])
    kept = np.concatenate((np.array(one.sent, dtype=np.int64), one.waiting.ticks))
    kept = kept[kept < first]
    if one.path is None or not len(kept) or first - kept[-1] >= SEGMENT_PERIODS_MIN:
        return points
    last = first - SEGMENT_PERIODS_MIN
    before = max(kept[kept <= last].tolist(), default=None)
    if before is not None and last - before < SEGMENT_PERIODS_MIN:
        last = before
    state = one.path.state(last * PERIOD)
    return TimedPoints(
        np.concatenate(([last], points.periods)),
        np.concatenate((state.position, points.positions)),
        np.concatenate((state.velocity, points.velocities)),
        np.concatenate((state.effort, points.efforts)),
    )
