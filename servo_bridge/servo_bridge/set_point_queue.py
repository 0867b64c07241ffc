"""Set-points between the arbiter, which puts them in, and the dispatcher, which writes them to the board.

Modes go first where they change, then one write for all axes that move together, then timed points of axes that follow
a path. A newer set-point replaces one that is still waiting; the board itself ends a velocity or effort that is not
written again. All numbers are raw firmware integers. Pure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from servo_msgs_py.catalogue import AXES
from servo_msgs_py.timed_points import axes_of_points

from servo_bridge.setpoints import Mode
from servo_bridge.trajectory.errors import POINTS_REFUSED

TARGETS: Final = {Mode.POSITION: "cmd.position", Mode.SPEED: "cmd.speed", Mode.TORQUE: "cmd.i_q"}
"""Variable that takes the set-point of a mode."""

_POINTS = "cmd.points"
_TAKE = "config.take"


@dataclass(frozen=True)
class CommandWrite:
    """A write of neighbouring elements of one command variable, of timed points, or of blocks that are to be taken."""

    variable: str  # name of the array variable
    first: int  # axis of the first element; 0 for points and blocks
    raw: tuple[int, ...]  # firmware integers; only the written elements count as fresh; of points their words
    members: tuple[int, ...] = ()  # of the blocks that ``config.take`` brings into force, one axis after the other

    @property
    def mask(self) -> int:
        """Bit per written axis; bit 0 is axis 1."""
        if self.variable == _POINTS:
            return axes_of_points(self.raw)
        if self.variable == _TAKE:
            return self.raw[0]
        return ((1 << len(self.raw)) - 1) << self.first

    def numbers(self) -> tuple[int, ...]:
        """Raw number of every axis, 0 where nothing is written; the words of points; the members of blocks."""
        if self.variable == _POINTS:
            return self.raw
        if self.variable == _TAKE:
            return self.members
        numbers = [0] * AXES
        numbers[self.first : self.first + len(self.raw)] = self.raw
        return tuple(numbers)


@dataclass(frozen=True)
class Target:
    """A set-point of one axis."""

    mode: Mode  # meaning of the number
    raw: int  # value of the variable `TARGETS` of this mode


class PathSource(Protocol):
    """Where timed points come from."""

    @property
    def axes(self) -> Collection[int]: ...
    def next_points(self) -> tuple[int, ...] | None: ...
    def cancel(self, axis: int, reason: str) -> None: ...


class SetPointQueue:
    """What is to be written next, per axis."""

    def __init__(self) -> None:
        self._modes: list[Mode | None] = [None] * AXES  # that the board has taken; None: not known
        self._targets: list[Target | None] = [None] * AXES
        self._halted: set[int] = set()  # axes that have to be stopped
        self._paths: PathSource | None = None

    # ---- what goes in
    def follow(self, paths: PathSource) -> None:
        """Take timed points from here, for axes that no set-point moves."""
        self._paths = paths

    @property
    def following(self) -> Collection[int]:
        """Axes that follow a path."""
        return () if self._paths is None else self._paths.axes

    def put(self, axis: int, target: Target, reason: str) -> None:
        """Make this the waiting set-point of an axis; `reason` ends a path that the axis follows."""
        self._targets[axis] = target
        self._leave_path(axis, reason)

    def make_way(self, axes: Iterable[int]) -> None:
        """Throw away waiting set-points of axes that are to follow a path."""
        for axis in axes:
            self._targets[axis] = None

    def drop(self, axis: int, reason: str) -> None:
        """Throw away what waits for an axis, and end its path."""
        self._targets[axis] = None
        self._leave_path(axis, reason)

    def halt(self, axes: Iterable[int], reason: str) -> None:
        """Have axes stop at the acceleration limit of the board and hold, whatever path or set-point they follow.

        A change of mode does that on the board: nothing has to be planned, and nothing can be refused.
        """
        for axis in axes:
            self._modes[axis] = None
            self.drop(axis, reason)
            self._halted.add(axis)

    def forget_modes(self) -> None:
        """Write modes anew, whatever the board did meanwhile."""
        self._modes = [None] * AXES

    def link_lost(self) -> None:
        """Forget what the board was told."""
        self.forget_modes()
        self._halted.clear()

    # ---- what goes out
    def obeys_points(self, axis: int) -> bool:
        """Whether an axis has been told to follow timed points."""
        return self._modes[axis] is Mode.TRAJECTORY

    def next_write(self) -> CommandWrite | None:
        """Fetch the next write: modes before set-points, both axes in one write where they share the variable."""
        if self._halted:
            halted, self._halted = self._halted, set()
            return _joined("cmd.mode", dict.fromkeys(halted, Mode.POSITION.value))
        waiting = {axis: target for axis, target in enumerate(self._targets) if target is not None}
        modes = dict.fromkeys(self.following, Mode.TRAJECTORY)
        modes.update({axis: target.mode for axis, target in waiting.items()})
        changes = {axis: mode.value for axis, mode in modes.items() if self._modes[axis] is not mode}
        if changes:
            return _joined("cmd.mode", changes)
        if not waiting:
            words = self._paths.next_points() if self._paths is not None else None
            return None if words is None else CommandWrite(_POINTS, 0, words)
        mode = next(iter(waiting.values())).mode
        together = {axis: target.raw for axis, target in waiting.items() if target.mode is mode}
        self.make_way(together)
        return _joined(TARGETS[mode], together)

    def accepted(self, write: CommandWrite) -> None:
        """Note that the board took a write."""
        if write.variable == "cmd.mode":
            for k, raw in enumerate(write.raw):
                self._modes[write.first + k] = Mode(raw)

    def failed(self, write: CommandWrite) -> None:
        """Note that the board did not take a write: what waited for these axes is void, their mode unknown.

        Of a path the board may have points that it still follows: another mode makes it stop and hold.
        """
        for axis in range(AXES):
            if write.mask >> axis & 1:
                if write.variable == _POINTS:
                    self.halt([axis], POINTS_REFUSED)
                else:
                    self._modes[axis] = None
                    self.drop(axis, f"the board refused {write.variable}")

    def _leave_path(self, axis: int, reason: str) -> None:
        if self._paths is not None and axis in self._paths.axes:
            self._paths.cancel(axis, reason)


def _joined(variable: str, elements: Mapping[int, int]) -> CommandWrite:
    """One write of neighbouring elements; with two axes any set of elements is neighbouring."""
    axes = sorted(elements)
    return CommandWrite(variable, axes[0], tuple(elements[axis] for axis in axes))
