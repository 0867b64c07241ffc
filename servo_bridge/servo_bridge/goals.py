"""Trajectories: checks, start and stop, and the results of those whose result is reported."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.units import PERIOD

from servo_bridge.command_context import CommandContext
from servo_bridge.part import Part
from servo_bridge.set_points import NotReady, Rejected
from servo_bridge.telemetry import Snapshot
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.follower import Follower, PathEvents, Plan
from servo_bridge.trajectory.from_message import from_message
from servo_bridge.trajectory.goal import CANCELED, Goal, Step
from servo_bridge.trajectory.merge import merged
from servo_bridge.trajectory.message import TrajectoryMessage, check_size
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.tolerances import Phase

_STOP_DELAY = 0.1
"""Time until a stop takes effect on the board and the shaft has stopped [s]."""


class Owner(Protocol):
    """Sender of a goal."""

    def cancelling(self) -> bool:
        """Return whether the goal is to be cancelled; asked at every sample."""
        ...

    def begun(self) -> None:
        """The path has begun."""

    def postponed(self) -> None:
        """The path, which had begun, will begin later."""

    def moving(self, tick: int, stamp_ns: int, desired: State, actual: State) -> None:
        """Receive a sample while the path is followed."""

    def ended(self, goal: Goal) -> None:
        """Receive the result, `Goal.outcome`."""


@dataclass
class _Active:
    """A goal whose result has not been sent."""

    owner: Owner
    source: str
    goal: Goal
    plan: Plan | None = None  # for `Follower.withdraw` before the path has begun
    paths: Mapping[str, Path] = field(default_factory=dict)  # by joint, from the follower
    path: Path | None = None  # merged path of all joints


class Goals(Part):
    """Starts and stops the trajectories of one board.

    Parameters
    ----------
    context : CommandContext
        Checks and counts trajectories.
    follower : Follower
        Sends them to the board.
    origin_ns : callable
        ROS time at tick 0 of the board [ns]; None before the first sample.
    info : callable
        Receives messages for the log.
    """

    def __init__(
        self,
        context: CommandContext,
        follower: Follower,
        *,
        origin_ns: Callable[[], int | None],
        info: Callable[[str], None],
    ) -> None:
        self._context = context
        self._joints = list(context.joints)
        self._follower = follower
        self._origin_ns = origin_ns
        self._info = info
        self._active: list[_Active] = []

    def joints_of(self, names: Sequence[str]) -> list[str]:
        """Joints of a trajectory in the order of the axes; all if it names none."""
        return [joint for joint in self._joints if joint in names or not len(names)]

    # ---- start and stop
    def stop(self, source: str, names: Sequence[str], reason: str = "") -> float:
        """Stop joints with the acceleration limit and hold; pending trajectories are refused.

        Parameters
        ----------
        source : str
            Topic or action of the request.
        names : sequence of str
            Joints; empty: all.
        reason : str
            Reported for the ended paths; default: an empty trajectory.

        Returns
        -------
        float
            Latest time at which they have stopped [s of board time].

        Raises
        ------
        Rejected
            If a joint does not exist, or the axes do not accept set-points.
        """
        for name in names:
            if name not in self._joints:
                known = ", ".join(self._joints)
                raise TrajectoryError(
                    f"{source}: joint {name!r} does not exist; the joints are {known}", ErrorCode.INVALID_JOINTS
                )
        return self._halt(
            source, self.joints_of(names), reason or f"an empty trajectory on {source} stopped it", pending=True
        )

    def _halt(self, source: str, joints: Sequence[str], reason: str, *, pending: bool = False) -> float:
        """Stop joints as `stop`; `pending`: also refuse their pending trajectories."""
        axes, queue = self._axes(joints), self._context.arbiter.queue
        self._context.arbiter.check_ready(source, axes)
        limits = self._context.limits()
        if limits is None:
            raise NotReady(f"{source}: the board has not reported its limits yet; call quick_stop to stop now")
        paths = self._follower.running().select(joints).state(self._follower.now).velocity
        speeds = [
            max(abs(path), abs(self._context.arbiter.velocity(axis))) for path, axis in zip(paths, axes, strict=True)
        ]
        times = [speed / limits[axis].acceleration_max for speed, axis in zip(speeds, axes, strict=True)]
        (queue.halt if pending else queue.halt_paths)(axes, reason)
        self._context.accept()
        self._info(f"stopping {', '.join(joints)} for {source}")
        return float(self._follower.now + max(times) + _STOP_DELAY)

    def follow(self, source: str, message: TrajectoryMessage, on: PathEvents, takes_over: str = "") -> Plan:
        """Check a trajectory and start to follow it.

        Parameters
        ----------
        source : str
            Topic or action of the trajectory.
        message : TrajectoryMessage
            The trajectory.
        on : PathEvents
            Receives the progress.
        takes_over : str
            Reported for the paths that it replaces; empty: a trajectory on this source.

        Returns
        -------
        Plan
            For `Follower.withdraw`.

        Raises
        ------
        Rejected
            If it is refused at once; then nothing is changed.
        """
        joints, arbiter = self.joints_of(message.joint_names), self._context.arbiter
        axes = self._axes(joints)
        arbiter.check_source(source, axes)
        limits, origin_ns = self._context.limits(), self._origin_ns()
        if limits is None or origin_ns is None:
            raise TrajectoryError(f"{source}: the board has not reported its limits yet; try again in 1 s")

        def plan(running: Path, now: float) -> Path:
            wrapping = [joint.name for joint in arbiter.joints if joint.wraps]
            return from_message(message, running, now, origin_ns, source=source, wrapping=wrapping)

        def checked() -> None:
            # What an axis follows as a path, such as a stream, it follows until this one begins.
            arbiter.admit_path(source, [axis for axis in axes if axis not in self._follower.moving])
            on.checked()

        def begun(end: float) -> None:
            arbiter.admit_path(source, axes)
            self._info(f"following a trajectory of {', '.join(joints)} until board time {end:.3f} s")
            on.begun(end)

        def postponed() -> bool:
            if not on.postponed():
                return False
            self._info(f"the first points of {', '.join(joints)} reached the board too late; they begin later")
            return True

        check_size(message, source)
        self._follower.request(
            joints,
            plan,
            replace(on, checked=checked, begun=begun, postponed=postponed),
            start=(message.stamp_ns - origin_ns) * 1.0e-9 if message.stamp_ns else 0.0,
            takes_over=takes_over or f"a trajectory on {source} took over",
            size=message.size,
            movable=True,
        )
        self._context.accept()
        return plan

    # ---- goals
    def begin(self, source: str, message: TrajectoryMessage, goal: Goal, owner: Owner, takes_over: str = "") -> None:
        """Start to follow a trajectory whose result is reported, or to stop its joints if it is empty.

        Parameters
        ----------
        source, message, takes_over
            As in `follow`.
        goal : Goal
            Its joints and tolerances.
        owner : Owner
            Receives its progress.

        Raises
        ------
        Rejected
            If it is refused at once; then nothing is changed.
        """
        active = _Active(owner, source, goal)
        if not message.size:
            goal.stopping(self.stop(source, message.joint_names, takes_over))
            self._active.append(active)
            return

        def begun(end: float) -> None:
            goal.begun(end)
            paths = self._follower.paths()
            active.paths = {joint: paths[joint] for joint in goal.joints}
            active.path = merged(list(active.paths.values()))
            owner.begun()

        def postponed() -> bool:
            if goal.ended:
                return False
            goal.postponed()
            active.paths, active.path = {}, None
            owner.postponed()
            return True

        events = PathEvents(begun, goal.refused, goal.abandoned, postponed)
        active.plan = self.follow(source, message, events, takes_over)
        self._active.append(active)

    def on_sample(self, snapshot: Snapshot) -> None:
        """Check the goals with a sample of the board."""
        time = snapshot.tick * PERIOD
        for active in list(self._active):
            goal = active.goal
            actual = self._measured(goal.joints, snapshot)
            desired = None if active.path is None else active.path.state(time)
            if active.owner.cancelling():
                goal.cancel()
            moving = goal.moving
            step = goal.sample(time, desired, actual)
            if step is Step.STOP:
                self._stop(active)
            elif step is Step.WITHDRAW and active.plan is not None:
                self._follower.withdraw(active.plan)
            if goal.ended:
                self._active.remove(active)
                active.owner.ended(goal)
                if goal.outcome.phase is Phase.ABORTED:
                    self._stop_remaining(active)
            elif moving and desired is not None:
                active.owner.moving(snapshot.tick, snapshot.stamp_ns, desired, actual)

    def lost(self, reason: str) -> None:
        """End all goals, because there are no more samples."""
        ended, self._active = self._active, []
        for each in ended:
            each.goal.failed(f"the link to the board was lost: {reason}")
            each.owner.ended(each.goal)

    def _stop(self, active: _Active) -> None:
        """Stop the joints of a cancelled goal."""
        try:
            end = self._halt(active.source, active.goal.joints, CANCELED)
        except Rejected as error:
            active.goal.failed(str(error))
        else:
            active.goal.stopping(end)

    def _stop_remaining(self, active: _Active) -> None:
        """Stop the joints that still follow the path of an aborted goal."""
        paths = self._follower.paths()
        joints = [joint for joint, path in active.paths.items() if paths.get(joint) is path]
        if joints:
            with contextlib.suppress(Rejected):  # the board has stopped them already
                self._halt(active.source, joints, active.goal.outcome.text)

    def _axes(self, joints: Sequence[str]) -> list[int]:
        return [self._joints.index(joint) for joint in joints]

    def _measured(self, joints: Sequence[str], snapshot: Snapshot) -> State:
        values = snapshot.values
        rows = [(self._context.arbiter.joints[axis], axis_name(axis)) for axis in self._axes(joints)]
        position = [joint.position(values[f"{axis}.position"]) for joint, axis in rows]
        velocity = [joint.velocity(values[f"{axis}.speed"]) for joint, axis in rows]
        unknown = np.full(len(rows), np.nan)
        return State(np.array(position), np.array(velocity), unknown, unknown)
