"""Trajectories whose result is reported: goals of the action, and trajectories with a ticket."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from servo_bridge.set_points import Rejected
from servo_bridge.trajectory.follower import Follower, Plan
from servo_bridge.trajectory.goal import CANCELED, Goal, Step
from servo_bridge.trajectory.merge import merged
from servo_bridge.trajectory.message import TrajectoryMessage
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.timed_points import PERIOD
from servo_bridge.trajectory.tolerances import Phase
from servo_bridge.trajectory_topics import TrajectoryTopics


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


class Goals:
    """The active goals of one board.

    Parameters
    ----------
    joints : sequence of str
        Joint names in the order of the axes.
    trajectories : TrajectoryTopics
        Checks trajectories and starts them.
    follower : Follower
        Has the paths of the joints.
    """

    def __init__(self, joints: Sequence[str], trajectories: TrajectoryTopics, follower: Follower) -> None:
        self._joints = list(joints)
        self._trajectories = trajectories
        self._follower = follower
        self._active: list[_Active] = []

    def joints_of(self, names: Sequence[str]) -> list[str]:
        """Joints of a trajectory in the order of the axes; all if it names none."""
        return [joint for joint in self._joints if joint in names or not len(names)]

    def begin(self, source: str, message: TrajectoryMessage, goal: Goal, owner: Owner, takes_over: str = "") -> None:
        """Start to follow a trajectory, or to stop its joints if it is empty.

        Parameters
        ----------
        source : str
            Topic or action of the trajectory.
        message : TrajectoryMessage
            The trajectory.
        goal : Goal
            Its joints and tolerances.
        owner : Owner
            Receives its progress.
        takes_over : str
            Reported for the paths that it replaces; empty: names the source.

        Raises
        ------
        Rejected
            If it is refused at once; then nothing is changed.
        """
        active = _Active(owner, source, goal)
        if not message.size:
            reason = takes_over or f"an empty trajectory on {source} stopped it"
            goal.stopping(self._trajectories.stop(source, message.joint_names, reason))
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

        active.plan = self._trajectories.follow(
            source,
            message,
            begun=begun,
            refused=goal.refused,
            abandoned=goal.abandoned,
            postponed=postponed,
            takes_over=takes_over or None,
        )
        self._active.append(active)

    def on_sample(self, tick: int, stamp_ns: int, position: Sequence[float], velocity: Sequence[float]) -> None:
        """Check the goals with a sample of the board.

        Parameters
        ----------
        tick : int
            Extended tick.
        stamp_ns : int
            ROS time of the tick [ns].
        position, velocity : sequence of float
            Of all joints [rad], [rad/s].
        """
        for active in list(self._active):
            goal = active.goal
            axes = [self._joints.index(joint) for joint in goal.joints]
            actual = _measured([position[axis] for axis in axes], [velocity[axis] for axis in axes])
            desired = None if active.path is None else active.path.state(tick * PERIOD)
            if active.owner.cancelling():
                goal.cancel()
            moving = goal.moving
            step = goal.sample(tick * PERIOD, desired, actual)
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
                active.owner.moving(tick, stamp_ns, desired, actual)

    def link_lost(self, reason: str) -> None:
        """End all goals, because there are no more samples."""
        ended, self._active = self._active, []
        for each in ended:
            each.goal.failed(reason)
            each.owner.ended(each.goal)

    def _stop(self, active: _Active) -> None:
        """Stop the joints of a cancelled goal."""
        try:
            end = self._trajectories.stop(active.source, active.goal.joints, CANCELED)
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
                self._trajectories.stop(active.source, joints, active.goal.outcome.text)


def _measured(position: Sequence[float], velocity: Sequence[float]) -> State:
    unknown = np.full(len(position), np.nan)
    return State(np.array(position), np.array(velocity), unknown, unknown)
