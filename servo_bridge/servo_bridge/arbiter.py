"""Who commands: the one place where a set-point is let through, refused or thrown away.

A request passes four gates: the link is up, set-points are released (only the service ``enable`` does that), every
commanded axis is in RUN/SPIN, and every value is inside the limits of the board and of the configuration. It passes
as a whole or not at all. What passed waits here as raw firmware integers until the dispatcher fetches it: mode
first where it changes, then one write for all axes that move together. A newer set-point replaces one that is still
waiting; the board itself ends a velocity or effort that is not written again. Requests are in joint units, writes in
those of the motors. Pure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from servo_msgs_py.catalogue import AXES, Catalogue, Variable
from servo_msgs_py.joints import Joint, JointLimits, joint_names
from servo_msgs_py.timed_points import axes_of_points
from servo_msgs_py.units import unwrap_u32

from servo_bridge.setpoints import Mode, NotReady, Rejected, Request
from servo_bridge.sources import Source, Sources
from servo_bridge.trajectory.errors import POINTS_REFUSED

__all__ = ["Arbiter", "AxisStatus", "CommandWrite", "PathSource"]

_POINTS = "cmd.points"
_TAKE = "config.take"
_TARGET = {Mode.POSITION: "cmd.position", Mode.SPEED: "cmd.speed", Mode.TORQUE: "cmd.i_q"}
_QUANTITY = {Mode.POSITION: ("position", "rad"), Mode.SPEED: ("velocity", "rad/s"), Mode.TORQUE: ("effort", "N m")}
_REMEDY = "send a value inside, or change the limits in the parameters of the bridge"
_BOARD = "the board takes no other; send a value inside"
_FARTHER = "one set-point may be no farther from the shaft: send it there in steps"
_NOT_ENABLED = "outputs have not been enabled over this bridge"


@dataclass(frozen=True)
class CommandWrite:
    """A write of neighbouring elements of one command variable, of timed points, or of blocks that are to be taken.

    Attributes
    ----------
    variable : str
        Name of the array variable.
    first : int
        Axis of the first element; 0 for points and blocks.
    raw : tuple of int
        Firmware integers; the firmware takes only the written elements as fresh. Of points their words.
    members : tuple of int
        Of the blocks that ``config.take`` brings into force, one axis after the other.
    """

    variable: str
    first: int
    raw: tuple[int, ...]
    members: tuple[int, ...] = ()

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
class AxisStatus:
    """What the newest telemetry says about one axis.

    Attributes
    ----------
    label : str
        State in one word, for messages.
    spinning : bool
        The axis obeys set-points: RUN/SPIN; without an encoder it starts on one in RUN/READY.
    faulted : bool
        FAULT.
    position : int
        Where the shaft is [counts], extended past the 32 bits of the board.
    position_ref : int or None
        Where it is meant to be, the same; None without ``position_ref`` in the telemetry.
    """

    label: str
    spinning: bool
    faulted: bool = False
    position: int = 0
    position_ref: int | None = None


@dataclass(frozen=True)
class _Target:
    mode: Mode
    raw: int


class PathSource(Protocol):
    """Where timed points come from."""

    @property
    def axes(self) -> Collection[int]: ...
    def next_points(self) -> tuple[int, ...] | None: ...
    def cancel(self, axis: int, reason: str) -> None: ...


class Arbiter:
    """Set-points of all axes of one board.

    Parameters
    ----------
    catalogue : Catalogue
        Scales and limits of the command variables.
    joints : sequence of Joint
        In the order of the axes.
    sources : Sources, optional
        Finds sources that contradict each other.

    Attributes
    ----------
    inactive : str
        Why no set-point passes, enabled or not, and what to do; empty while the node is active.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[Joint],
        sources: Sources | None = None,
    ) -> None:
        self.sources = sources or Sources()
        self._variables: Mapping[Mode, Variable] = {mode: catalogue[name] for mode, name in _TARGET.items()}
        self._joints = joint_names(joints)
        self.joints = list(joints)
        self._reach = catalogue.bits["position"]["REACH"]
        self._torque_constants: list[float] | None = None
        self._axes: list[AxisStatus] | None = None
        self._link = "the board has not been seen yet"
        self._blocked = _NOT_ENABLED
        self.inactive = ""
        self._modes: list[Mode | None] = [None] * AXES
        self._targets: list[_Target | None] = [None] * AXES
        self._halted: set[int] = set()  # axes that have to be stopped
        self._paths: PathSource | None = None

    def follow(self, paths: PathSource) -> None:
        """Take timed points from here, for axes that no set-point moves."""
        self._paths = paths

    # ---- what the board says
    def board_seen(self, axes: Sequence[AxisStatus]) -> None:
        """Take the state of all axes from a sample; an axis that left RUN/SPIN loses what was waiting for it."""
        self._axes = list(axes)
        for axis, status in enumerate(axes):
            if not status.spinning:
                self._targets[axis] = None
                self._leave_path(axis, f"{self._joints[axis]} is in {status.label}")

    def set_torque_constants(self, values: Sequence[float]) -> None:
        """Torque per ampere of i_q of every axis, nominal value of the board [N m/A]."""
        self._torque_constants = list(values)

    def link_lost(self, reason: str) -> None:
        """Throw away what is waiting; set-points stay refused until ``enable`` is called again."""
        self._link = reason
        if self._axes is not None:
            self.block("the link to the board was lost")
        self._modes = [None] * AXES
        self._halted.clear()
        self._axes = None
        self._torque_constants = None

    # ---- the gate that only ``enable`` opens
    def release(self) -> None:
        """Let set-points through from now on; modes are written anew, whatever the board did meanwhile."""
        self._blocked = ""
        self._modes = [None] * AXES

    def block(self, reason: str) -> None:
        """Refuse set-points from now on and throw away what is waiting."""
        self._blocked = reason
        self._targets = [None] * AXES
        for axis in range(AXES):
            self._leave_path(axis, reason)

    @property
    def armed(self) -> bool:
        """True when a set-point for every joint would be obeyed."""
        blocked = self._blocked or self.inactive
        return self._axes is not None and not blocked and all(axis.spinning for axis in self._axes)

    # ---- commands
    def submit(self, *requests: Request) -> None:
        """Check requests and make them the waiting set-points of their axes, also when they have the same already.

        Parameters
        ----------
        *requests : Request
            Well-formed commands, of different axes.

        Raises
        ------
        Rejected
            If any of it must not pass; then nothing has changed.
        """
        targets: dict[int, tuple[str, _Target]] = {}
        for request in requests:
            self.check_ready(request.source, request.values)
            for axis in request.values:
                targets[axis] = request.source, _Target(request.mode, self._raw(request, axis))
        for request in requests:
            self._claim(Source(request.source, _QUANTITY[request.mode][0]), request.values)
        for axis, (source, target) in targets.items():
            self._targets[axis] = target
            self._leave_path(axis, f"a set-point on {source} took over")

    def admit(self, source: str, axes: Iterable[int]) -> None:
        """Check that paths of some axes may be followed: as `submit`, but for the values.

        Raises
        ------
        Rejected
            If not.
        """
        axes = list(axes)
        self.check_ready(source, axes)
        self._claim(Source(source, "trajectory"), axes)
        for axis in axes:
            self._targets[axis] = None

    def check_ready(self, source: str, axes: Iterable[int]) -> None:
        """Check that some axes obey set-points.

        Raises
        ------
        NotReady
            If not.
        """
        if self._axes is None:
            raise NotReady(f"{source}: not connected ({self._link}); see state and /diagnostics")
        if self.inactive:
            raise NotReady(f"{source}: {self.inactive}; then call the service enable with data: true")
        for axis in axes:
            status, joint = self._axes[axis], self._joints[axis]
            if status.faulted:
                raise NotReady(
                    f"{source}: {joint} is in FAULT; see /diagnostics for cause and remedy, call clear_faults, "
                    "then enable"
                )
            if self._blocked:
                raise NotReady(f"{source}: {self._blocked}; call the service enable with data: true first")
            if not status.spinning:
                raise NotReady(
                    f"{source}: {joint} is in {status.label}, not in RUN/SPIN; call the service enable with "
                    "data: true and wait until armed is true"
                )

    def halt(self, axes: Iterable[int], reason: str) -> None:
        """Have axes stop at the acceleration limit of the board and hold, whatever path or set-point they follow.

        A change of mode does that on the board: nothing has to be planned, and nothing can be refused.
        """
        for axis in axes:
            self._targets[axis] = self._modes[axis] = None
            self._leave_path(axis, reason)
            self._halted.add(axis)

    def obeys_points(self, axis: int) -> bool:
        """Whether an axis has been told to follow timed points."""
        return self._modes[axis] is Mode.TRAJECTORY

    def next_write(self) -> CommandWrite | None:
        """Fetch the next write: modes before set-points, both axes in one write where they share the variable."""
        if self._halted:
            halted, self._halted = self._halted, set()
            return _joined("cmd.mode", dict.fromkeys(halted, Mode.POSITION.value))
        waiting = {axis: target for axis, target in enumerate(self._targets) if target is not None}
        modes = dict.fromkeys(self._paths.axes if self._paths is not None else (), Mode.TRAJECTORY)
        modes.update({axis: target.mode for axis, target in waiting.items()})
        changes = {axis: mode.value for axis, mode in modes.items() if self._modes[axis] is not mode}
        if changes:
            return _joined("cmd.mode", changes)
        if not waiting:
            words = self._paths.next_points() if self._paths is not None else None
            return None if words is None else CommandWrite(_POINTS, 0, words)
        mode = next(iter(waiting.values())).mode
        together = {axis: target.raw for axis, target in waiting.items() if target.mode is mode}
        for axis in together:
            self._targets[axis] = None
        return _joined(_TARGET[mode], together)

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
                self._targets[axis] = self._modes[axis] = None
                if write.variable == _POINTS:
                    self.halt([axis], POINTS_REFUSED)
                else:
                    self._leave_path(axis, f"the board refused {write.variable}")

    # ---- details
    def _leave_path(self, axis: int, reason: str) -> None:
        if self._paths is not None and axis in self._paths.axes:
            self._paths.cancel(axis, reason)

    def _claim(self, source: Source, axes: Iterable[int]) -> None:
        self.sources.claim(source, axes, self._joints, () if self._paths is None else self._paths.axes)

    def _raw(self, request: Request, axis: int) -> int:
        value, mode, joint = request.values[axis], request.mode, self.joints[axis]
        variable = self._variables[mode]
        wanted_low, wanted_high = _wanted(joint.limits, mode)
        factor = 1.0
        if mode is Mode.POSITION:
            assert self._axes is not None
            position = self._axes[axis].position
            ends = [joint.position((position + way) * variable.lsb) for way in (-self._reach, self._reach)]
            motor = joint.motor_position(value)
        elif mode is Mode.SPEED:
            ends = [joint.velocity(end) for end in (variable.minimum, variable.maximum)]
            motor = joint.motor_velocity(value)
        else:
            factor = self._amperes_per_newton_metre(request.source, axis)
            ends = [joint.effort(end / factor) for end in (variable.minimum, variable.maximum)]
            motor = joint.motor_effort(value)
        low, high = sorted(ends)
        boards = (value > high and high <= wanted_high) or (value < low and low >= wanted_low)
        remedy = (_FARTHER if mode is Mode.POSITION else _BOARD) if boards else _REMEDY
        low, high = max(low, wanted_low), min(high, wanted_high)
        if not low <= value <= high:
            quantity, unit = _QUANTITY[mode]
            raise Rejected(
                f"{request.source}: {quantity} of {joint.name} is {value:g} {unit}, outside {low:g} .. {high:g} "
                f"{unit}; {remedy}"
            )
        if mode is Mode.POSITION:
            # Positions of the board wrap at 32 bits, and it takes the shorter way.
            return unwrap_u32(round(motor / variable.lsb) & 0xFFFF_FFFF, 0)
        # A value at the limit itself must not fall outside by the last bit of the product.
        return variable.to_raw(min(max(motor * factor, variable.minimum), variable.maximum))

    def _amperes_per_newton_metre(self, source: str, axis: int) -> float:
        if self._torque_constants is None or self._torque_constants[axis] <= 0.0:
            raise Rejected(
                f"{source}: the board has not told its torque constant of {self._joints[axis]}; try again in a second"
            )
        return 1.0 / self._torque_constants[axis]


def _wanted(limits: JointLimits, mode: Mode) -> tuple[float, float]:
    """Lowest and highest set-point of a mode that the configuration lets pass."""
    if mode is Mode.POSITION:
        return limits.position_min, limits.position_max
    magnitude = limits.velocity_max if mode is Mode.SPEED else limits.effort_max
    return -magnitude, magnitude


def _joined(variable: str, elements: Mapping[int, int]) -> CommandWrite:
    """One write of neighbouring elements; with two axes any set of elements is neighbouring."""
    axes = sorted(elements)
    return CommandWrite(variable, axes[0], tuple(elements[axis] for axis in axes))
