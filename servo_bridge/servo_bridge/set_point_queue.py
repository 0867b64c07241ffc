"""Queue of set-points between the arbiter and the dispatcher, which writes them to the board.

Order: mode changes, then one write for all axes that move together, then timed points of axes that follow a path. A new
set-point replaces a pending one. Velocity and effort set-points expire on the board if they are not renewed. All
numbers are raw firmware integers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from servo_msgs_py.catalogue import AXES
from servo_msgs_py.timed_points import axes_of_points

from servo_bridge.set_points import Mode
from servo_bridge.trajectory.errors import POINTS_REFUSED
from servo_bridge.trajectory.follower import AxisReport

TARGETS: Final = {Mode.POSITION: "cmd.position", Mode.SPEED: "cmd.speed", Mode.TORQUE: "cmd.i_q"}
"""Variable of the set-point of a mode."""

_POINTS = "cmd.points"
_TAKE = "config.take"


@dataclass(frozen=True)
class CommandWrite:
    """Write of neighbouring elements of a command variable or a parameter, of timed points, or of ``config.take``."""

    variable: str  # name of the array variable
    first: int  # axis of the first element; 0 for points and blocks
    raw: tuple[int, ...]  # firmware integers of the written elements; for points: their words
    members: tuple[int, ...] = ()  # of the blocks that ``config.take`` applies, by axis

    @property
    def mask(self) -> int:
        """Bit per written axis; bit 0 is axis 1."""
        if self.variable == _POINTS:
            return axes_of_points(self.raw)
        if self.variable == _TAKE:
            return self.raw[0]
        return ((1 << len(self.raw)) - 1) << self.first

    def numbers(self) -> tuple[int, ...]:
        """Raw numbers of all axes (0: not written); for points their words, for ``config.take`` the members."""
        if self.variable == _POINTS:
            return self.raw
        if self.variable == _TAKE:
            return self.members
        numbers = [0] * AXES
        numbers[self.first : self.first + len(self.raw)] = self.raw
        return tuple(numbers)


@dataclass(frozen=True)
class Target:
    """Set-point of one axis."""

    mode: Mode  # meaning of the number
    raw: int  # value of the variable `TARGETS` of this mode


class PathSource(Protocol):
    """Source of timed points."""

    @property
    def axes(self) -> Collection[int]: ...
    @property
    def claimed(self) -> Collection[int]:
        """Axes with a path, or with a request that may still be refused."""
        ...

    def on_sample(self, tick: int, reports: Sequence[AxisReport]) -> None: ...
    def next_points(self) -> tuple[int, ...] | None: ...
    def points_accepted(self, axes: Iterable[int]) -> None:
        """The board has accepted points of these axes."""

    def postpone(self, axes: Collection[int]) -> bool:
        """The board has refused points of these axes; True: their path begins later."""
        ...

    def end(self, axis: int, reason: str) -> None:
        """End the path of an axis; a request for this axis stays."""
        ...

    def cancel(self, axis: int, reason: str) -> None:
        """End the path of an axis, and refuse a request for it."""
        ...


class SetPointQueue:
    """Pending set-points and modes of all axes."""

    def __init__(self) -> None:
        self._modes: list[Mode | None] = [None] * AXES  # accepted by the board; None: not known
        self._targets: list[Target | None] = [None] * AXES
        self._halted: dict[int, Mode] = {}  # axes to be stopped, by a change to these modes
        self._paths: PathSource | None = None
        self._order = [*TARGETS.values(), _POINTS]  # variables, the one that was written last at the end

    # ---- input
    def follow(self, paths: PathSource) -> None:
        """Use this source of timed points, for axes without a set-point."""
        self._paths = paths

    def follows(self, axis: int) -> bool:
        """Whether an axis follows a path."""
        return self._paths is not None and axis in self._paths.axes

    def put(self, axis: int, target: Target | None, reason: str) -> None:
        """Set the pending set-point of an axis, None: none; `reason` is reported for a path that it ends."""
        self._targets[axis] = target
        if self._paths is not None and axis in self._paths.claimed:
            self._paths.cancel(axis, reason)

    def discard(self, axes: Iterable[int]) -> None:
        """Discard the pending set-points of axes, which then follow a path."""
        for axis in axes:
            self._targets[axis] = None

    def halt(self, axes: Iterable[int], reason: str) -> None:
        """Stop axes with the acceleration limit of the board and hold, whatever they follow or will follow.

        A change of the mode has this effect on the board; it needs no planning and cannot be refused.
        """
        axes = list(axes)
        self._stop(axes)
        for axis in axes:
            self.put(axis, None, reason)

    def halt_paths(self, axes: Iterable[int], reason: str) -> None:
        """Stop axes as `halt`, but only their paths end: a requested one begins when they hold."""
        assert self._paths is not None
        axes = list(axes)
        self._stop(axes)
        for axis in axes:
            self._paths.end(axis, reason)

    def forget_modes(self) -> None:
        """Forget the modes, so that they are written again."""
        self._modes = [None] * AXES

    def lost(self) -> None:
        """Reset the known modes."""
        self.forget_modes()
        self._halted.clear()

    def on_sample(self, tick: int, references: Iterable[float]) -> None:
        """Pass a sample on to the source of timed points; `references`: position set-points of the motors [rad]."""
        if self._paths is not None:
            pairs = zip(references, self._modes, strict=True)
            self._paths.on_sample(tick, [AxisReport(place, mode is Mode.TRAJECTORY) for place, mode in pairs])

    # ---- output
    def next_write(self) -> CommandWrite | None:
        """Remove the next write: modes before set-points; both axes in one write if the variable is the same.

        Set-points of different kinds take turns, if the line is too slow for all of them: none may be late for long.
        """
        if self._halted:
            halted, self._halted = self._halted, {}
            return _joined("cmd.mode", {axis: mode.value for axis, mode in halted.items()})
        waiting, changes = dict[int, Target](), dict[int, int]()
        for axis, (mode, target) in enumerate(zip(self._modes, self._targets, strict=True)):
            if target is not None:
                waiting[axis] = target
            wanted = target.mode if target is not None else Mode.TRAJECTORY if self.follows(axis) else mode
            if wanted is not None and wanted is not mode:
                changes[axis] = wanted.value
        if changes:
            return _joined("cmd.mode", changes)
        for variable in self._order:
            write = self._next_of(variable, waiting)
            if write is not None:
                self._order.remove(variable)
                self._order.append(variable)
                return write
        return None

    def _next_of(self, variable: str, waiting: Mapping[int, Target]) -> CommandWrite | None:
        """Remove the next write of a variable of set-points; None: there is none."""
        if variable == _POINTS:
            words = self._paths.next_points() if self._paths is not None else None
            return None if words is None else CommandWrite(_POINTS, 0, words)
        together = {axis: target.raw for axis, target in waiting.items() if TARGETS[target.mode] == variable}
        self.discard(together)
        return _joined(variable, together) if together else None

    def accepted(self, write: CommandWrite) -> None:
        """Record that the board accepted a write."""
        if write.variable == "cmd.mode":
            for k, raw in enumerate(write.raw):
                self._modes[write.first + k] = Mode(raw)
        elif write.variable == _POINTS and self._paths is not None:
            self._paths.points_accepted(_axes_of(write))

    def failed(self, write: CommandWrite) -> bool:
        """Record that the board refused a write: discard the pending set-points of its axes and forget their modes.

        The board may still follow queued points of a path, or points of the refused write if its answer to a first
        transmission was lost; a change of the mode stops it.

        Returns
        -------
        bool
            False: nothing is discarded, the path begins later.
        """
        axes = _axes_of(write)
        if write.variable == _POINTS and self._paths is not None and self._paths.postpone(axes):
            self._stop(axes)
            return False
        if write.variable == _POINTS:
            self.halt(axes, POINTS_REFUSED)
        else:
            for axis in axes:
                self._modes[axis] = None
                self.put(axis, None, f"the board refused {write.variable}")
        return True

    def _stop(self, axes: Iterable[int]) -> None:
        """Stop axes by a change of the mode, of a position move by one to the mode of trajectories."""
        for axis in axes:
            other = Mode.TRAJECTORY if self._modes[axis] is Mode.POSITION else Mode.POSITION
            self._halted.setdefault(axis, other)
            self._modes[axis] = None


def _axes_of(write: CommandWrite) -> list[int]:
    return [axis for axis in range(AXES) if write.mask >> axis & 1]


def _joined(variable: str, elements: Mapping[int, int]) -> CommandWrite:
    """Write of neighbouring elements; with two axes every set of elements is contiguous."""
    axes = sorted(elements)
    return CommandWrite(variable, axes[0], tuple(map(elements.__getitem__, axes)))
