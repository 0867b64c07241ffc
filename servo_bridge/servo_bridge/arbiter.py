"""Who commands: the one place where a set-point is let through or refused.

A request passes four gates: the link is up, set-points are released (only the service ``enable`` does that), every
commanded axis is in RUN/SPIN, and every value is inside the limits of the board and of the configuration. It passes
as a whole or not at all. What passed goes into the `SetPointQueue` as raw firmware integers. Requests are in joint
units, raw integers in those of the motors. Pure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from servo_msgs_py.catalogue import AXES, Catalogue, Variable
from servo_msgs_py.joints import Joint, JointLimits, joint_names
from servo_msgs_py.units import unwrap_u32

from servo_bridge.set_point_queue import TARGETS, SetPointQueue, Target
from servo_bridge.setpoints import Mode, NotReady, Rejected, SetPointRequest
from servo_bridge.sources import Source, Sources

_QUANTITY = {Mode.POSITION: ("position", "rad"), Mode.SPEED: ("velocity", "rad/s"), Mode.TORQUE: ("effort", "N m")}
_REMEDY = "send a value inside, or change the limits in the parameters of the bridge"
_BOARD = "the board takes no other; send a value inside"
_FARTHER = "one set-point may be no farther from the shaft: send it there in steps"
_NOT_ENABLED = "outputs have not been enabled over this bridge"


@dataclass(frozen=True)
class AxisStatus:
    """What the newest telemetry says about one axis."""

    label: str  # state in one word, for messages
    spinning: bool  # accepts set-points: RUN/SPIN; without an encoder a set-point starts the axis in RUN/READY
    faulted: bool = False  # state FAULT
    position: int = 0  # of the shaft [counts], extended past the 32 bits of the board
    position_ref: int | None = None  # its set-point, likewise [counts]; None without ``position_ref`` in the telemetry


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
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[Joint],
        sources: Sources | None = None,
    ) -> None:
        self.queue = SetPointQueue()  # of what has passed
        self.sources = sources or Sources()
        self._variables: Mapping[Mode, Variable] = {mode: catalogue[name] for mode, name in TARGETS.items()}
        self._joints = joint_names(joints)
        self.joints = list(joints)
        self._reach = catalogue.bits["position"]["REACH"]
        self._torque_constants: list[float] | None = None
        self._axes: list[AxisStatus] | None = None
        self._link = "the board has not been seen yet"
        self._blocked = _NOT_ENABLED
        self.inactive = ""  # why no set-point passes, enabled or not, and what to do; empty while the node is active

    # ---- what the board says
    def board_seen(self, axes: Sequence[AxisStatus]) -> None:
        """Take the state of all axes from a sample; an axis that left RUN/SPIN loses what was waiting for it."""
        self._axes = list(axes)
        for axis, status in enumerate(axes):
            if not status.spinning:
                self.queue.drop(axis, f"{self._joints[axis]} is in {status.label}")

    def set_torque_constants(self, values: Sequence[float]) -> None:
        """Torque per ampere of i_q of every axis, nominal value of the board [N m/A]."""
        self._torque_constants = list(values)

    def link_lost(self, reason: str) -> None:
        """Throw away what is waiting; set-points stay refused until ``enable`` is called again."""
        self._link = reason
        if self._axes is not None:
            self.block("the link to the board was lost")
        self.queue.link_lost()
        self._axes = None
        self._torque_constants = None

    # ---- the gate that only ``enable`` opens
    def release(self) -> None:
        """Let set-points through from now on; modes are written anew, whatever the board did meanwhile."""
        self._blocked = ""
        self.queue.forget_modes()

    def block(self, reason: str) -> None:
        """Refuse set-points from now on and throw away what is waiting."""
        self._blocked = reason
        for axis in range(AXES):
            self.queue.drop(axis, reason)

    @property
    def armed(self) -> bool:
        """True when a set-point for every joint would be obeyed."""
        blocked = self._blocked or self.inactive
        return self._axes is not None and not blocked and all(axis.spinning for axis in self._axes)

    # ---- commands
    def submit(self, *requests: SetPointRequest) -> None:
        """Check requests and make them the waiting set-points of their axes, also when they have the same already.

        Parameters
        ----------
        *requests : SetPointRequest
            Well-formed commands, of different axes.

        Raises
        ------
        Rejected
            If any of it must not pass; then nothing has changed.
        """
        targets: dict[int, tuple[str, Target]] = {}
        for request in requests:
            self.check_ready(request.source, request.values)
            for axis in request.values:
                targets[axis] = request.source, Target(request.mode, self._raw(request, axis))
        for request in requests:
            self._claim(Source(request.source, _QUANTITY[request.mode][0]), request.values)
        for axis, (source, target) in targets.items():
            self.queue.put(axis, target, f"a set-point on {source} took over")

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
        self.queue.make_way(axes)

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

    # ---- details
    def _claim(self, source: Source, axes: Iterable[int]) -> None:
        self.sources.claim(source, axes, self._joints, self.queue.following)

    def _raw(self, request: SetPointRequest, axis: int) -> int:
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
                f"{source}: the board has not reported the torque constant of {self._joints[axis]}; try again in 1 s"
            )
        return 1.0 / self._torque_constants[axis]


def _wanted(limits: JointLimits, mode: Mode) -> tuple[float, float]:
    """Lowest and highest set-point of a mode that the configuration lets pass."""
    if mode is Mode.POSITION:
        return limits.position_min, limits.position_max
    magnitude = limits.velocity_max if mode is Mode.SPEED else limits.effort_max
    return -magnitude, magnitude
