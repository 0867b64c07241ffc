"""Trajectories: checks, start and stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from servo_bridge.command_context import CommandContext
from servo_bridge.set_points import NotReady
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.follower import QUICK, Follower, Plan
from servo_bridge.trajectory.from_message import from_message
from servo_bridge.trajectory.message import TrajectoryMessage, check_size
from servo_bridge.trajectory.path import Path

_STOP_DELAY = 0.1
"""Time until a stop takes effect on the board and the shaft has stopped [s]."""


class TrajectoryTopics:
    """Starts and stops trajectories.

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
        self._follower = follower
        self._origin_ns = origin_ns
        self._info = info

    def stop(self, source: str, names: Sequence[str], reason: str = "") -> float:
        """Stop joints with the acceleration limit and hold.

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
            if name not in self._context.joints:
                known = ", ".join(self._context.joints)
                raise TrajectoryError(
                    f"{source}: joint {name!r} does not exist; the joints are {known}", ErrorCode.INVALID_JOINTS
                )
        joints = [joint for joint in self._context.joints if joint in names or not len(names)]
        axes = [self._context.joints.index(joint) for joint in joints]
        self._context.arbiter.check_ready(source, axes)
        limits = self._context.limits()
        if limits is None:
            raise NotReady(f"{source}: the board has not reported its limits yet; call quick_stop to stop now")
        paths = self._follower.running().select(joints).state(self._follower.now).velocity
        speeds = [
            max(abs(path), abs(self._context.arbiter.velocity(axis))) for path, axis in zip(paths, axes, strict=True)
        ]
        times = [speed / limits[axis].acceleration_max for speed, axis in zip(speeds, axes, strict=True)]
        self._context.arbiter.queue.halt(axes, reason or f"an empty trajectory on {source} stopped it")
        self._context.accept()
        self._info(f"stopping {', '.join(joints)} for {source}")
        return float(self._follower.now + max(times) + _STOP_DELAY)

    def follow(
        self,
        source: str,
        message: TrajectoryMessage,
        *,
        refused: Callable[[TrajectoryError], None],
        begun: Callable[[float], None] | None = None,
        abandoned: Callable[[str], None] | None = None,
        postponed: Callable[[], bool] = lambda: True,
        takes_over: str | None = None,
    ) -> Plan:
        """Check a trajectory and start to follow it.

        Parameters
        ----------
        source : str
            Topic or action of the trajectory.
        message : TrajectoryMessage
            The trajectory.
        refused : callable
            Called with the reason if it cannot begin.
        begun : callable, optional
            Called at the begin, with the end of the path [s of board time].
        abandoned : callable, optional
            Called with the reason if it has begun but is not followed to its end.
        postponed : callable, optional
            Called if its first points have reached the board too late. True: `begun` is called again when it begins.
        takes_over : str, optional
            Reported for the paths that it replaces; default: a trajectory on this source.

        Returns
        -------
        Plan
            For `Follower.withdraw`.

        Raises
        ------
        Rejected
            If it is refused at once; then nothing is changed.
        """
        joints = [joint for joint in self._context.joints if joint in message.joint_names or not message.joint_names]
        axes = [self._context.joints.index(joint) for joint in joints]
        self._context.arbiter.check_ready(source, axes)
        limits, origin_ns = self._context.limits(), self._origin_ns()
        if limits is None or origin_ns is None:
            raise TrajectoryError(f"{source}: the board has not reported its limits yet; try again in 1 s")
        stamp_ns = message.stamp_ns

        def plan(running: Path, now: float) -> Path:
            wrapping = [joint.name for joint in self._context.arbiter.joints if joint.wraps]
            return from_message(message, running, now, origin_ns, source=source, wrapping=wrapping)

        def started(end: float) -> None:
            self._info(f"following a trajectory of {', '.join(joints)} until board time {end:.3f} s")
            if begun is not None:
                begun(end)

        def begins_later() -> bool:
            if not postponed():
                return False
            self._info(f"the first points of {', '.join(joints)} reached the board too late; they begin later")
            return True

        # Errors of the trajectory itself are reported at once, not when the axes are ready; those of a long one later.
        check_size(message, source)
        if message.size <= QUICK:
            running = self._follower.running()
            plan(running, running.start_time)
        self._context.arbiter.admit(source, axes)
        self._follower.request(
            joints,
            plan,
            begun=started,
            refused=refused,
            start=(stamp_ns - origin_ns) * 1.0e-9 if stamp_ns else 0.0,
            abandoned=abandoned,
            postponed=begins_later,
            takes_over=takes_over or f"a trajectory on {source} took over",
            size=message.size,
            movable=True,
        )
        self._context.accept()
        return plan
