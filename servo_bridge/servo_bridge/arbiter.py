"""Checks every set-point before it is sent to the board.

A request is accepted if the link is up, set-points are released (by the service ``enable`` only), every commanded axis
is in RUN/SPIN, and every value is inside the limits of the board and of the configuration. It is accepted or refused as
a whole. Accepted set-points go to the `SetPointQueue` as raw firmware integers. Requests are in joint units, raw
integers in motor units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from servo_msgs_py.catalogue import AXES, Catalogue, Variable
from servo_msgs_py.joints import Joint, JointLimits, joint_names
from servo_msgs_py.units import PERIOD, unwrap_u32

from servo_bridge.admission import JOIN_SPEED, SETTLING, Place
from servo_bridge.part import Part
from servo_bridge.set_point_queue import TARGETS, SetPointQueue, Target
from servo_bridge.set_point_sources import Source, Sources
from servo_bridge.set_points import Mode, NotReady, Rejected, SetPointRequest
from servo_bridge.telemetry import AxisStatus, Snapshot
from servo_bridge.trajectory.check import Limits

_QUANTITY = {Mode.POSITION: ("position", "rad"), Mode.SPEED: ("velocity", "rad/s"), Mode.TORQUE: ("effort", "N m")}
_REMEDY = "send a value within this range, or change the limits in the parameters of the bridge"
_BOARD = "this is the range of the board; send a value within it"
_REACH = "one set-point may not be farther from the shaft; move in steps"
_NOT_ENABLED = "the outputs have not been enabled by this bridge"
_INTERVAL_MAX = 0.1
"""Longest interval of the samples that a stop at a limit expects again [s]; a longer one is an interruption."""


def stop_delay(baud: int) -> float:
    """Longest time from a sample to the effect of the stop that it causes [s].

    Terms: 20 ms for the computer; line, 300 bytes: the sample (83 bytes), a preceding write of eight points (142 bytes)
    with its response, and the write of the stop.

    Parameters
    ----------
    baud : int
        Line speed [bit/s].
    """
    return 0.02 + 300 * 10 / baud


class Arbiter(Part):
    """Checks the set-points of all axes of one board.

    Parameters
    ----------
    catalogue : Catalogue
        Scales and limits of the command variables.
    joints : sequence of Joint
        In the order of the axes.
    sources : Sources, optional
        Detects sources that contradict each other.
    limits : callable
        Present limits of every joint, for the distance of a stop; None if the board has not reported them yet.
    delay : float
        Longest time from a sample to the effect of a stop, see `stop_delay` [s].
    warn : callable
        Receives messages for the log.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[Joint],
        sources: Sources | None = None,
        limits: Callable[[], Sequence[Limits] | None] = lambda: None,
        delay: float = 0.0,
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._warn = warn
        self.queue = SetPointQueue()  # of the accepted set-points
        self.sources = sources or Sources()
        self._variables: Mapping[Mode, Variable] = {mode: catalogue[name] for mode, name in TARGETS.items()}
        self._joints = joint_names(joints)
        self.joints = list(joints)
        self._limits = limits
        self._delay = delay
        self._tick: int | None = None  # of the newest sample
        self._speeds_before = [0.0] * AXES  # of the motors in the sample before it [rad/s]
        self._heading = [0.0] * AXES  # sign of the velocity or effort that an axis follows; 0: none
        self._blocked_heading = [0.0] * AXES  # sign of the one that was stopped at the end of the range; 0: none
        self._reach = catalogue.bits["position"]["REACH"]
        self._torque_constants: list[float] | None = None
        self._axes: list[AxisStatus] | None = None
        self._link = "no board since the start"
        self._blocked = _NOT_ENABLED
        self.inactive = ""  # reason and remedy while the node is not active; else empty

    # ---- state of the board
    def on_sample(self, snapshot: Snapshot) -> None:
        """Process the newest sample, and pass it on to the source of paths."""
        self.update_axes(snapshot.axes)
        interval = _INTERVAL_MAX if self._tick is None else (snapshot.tick - self._tick) * PERIOD
        self._tick = snapshot.tick
        for reason in self.stop_at_limits(interval):
            self._warn(reason)
        lsb = self._variables[Mode.POSITION].lsb
        held = [axis.position if axis.position_ref is None else axis.position_ref for axis in snapshot.axes]
        self.queue.on_sample(snapshot.tick, [counts * lsb for counts in held])

    def update_axes(self, axes: Sequence[AxisStatus]) -> None:
        """Update the state of all axes; pending set-points of an axis that accepts none are discarded."""
        self._speeds_before = [axis.speed for axis in self._axes or axes]
        self._axes = list(axes)
        for axis, status in enumerate(axes):
            if not status.accepts_set_points:
                self.release_axis(axis, f"{self._joints[axis]} is in {status.label}")

    def stop_at_limits(self, interval: float) -> list[str]:
        """Stop the joints that a velocity or an effort would turn out of their range before a stop at the next sample.

        Set-points that go on in the same direction are refused then. The range is that of the bridge; the board knows
        only that of its feature POSITION_LIMITS.

        Parameters
        ----------
        interval : float
            Time between the newest two samples, above 0 [s].

        Returns
        -------
        list of str
            Reasons.
        """
        free = [axis for axis in range(AXES) if self._heading[axis] and self.joints[axis].limits.bounded]
        limits = self._limits() if free and self._axes is not None else None
        if limits is None:
            return []
        reasons = []
        delay = self._delay + min(interval, _INTERVAL_MAX)
        for axis in free:
            position, velocity, heading = self._position(axis), self.velocity(axis), self._heading[axis]
            fastest = velocity + self._growth(axis, delay / interval)
            way = 0.5 * (velocity + fastest) * delay + 0.5 * fastest * abs(fastest) / limits[axis].acceleration_max
            if velocity * heading > 0.0 and self._is_beyond(axis, position + way, heading):
                self._blocked_heading[axis], self._heading[axis] = heading, 0.0
                reasons.append(
                    f"{self._joints[axis]} is stopped at {position:.4g} rad and {velocity:.3g} rad/s: it would leave "
                    "its range"
                )
                self.queue.halt([axis], reasons[-1])
        return reasons

    def _growth(self, axis: int, intervals: float) -> float:
        """Growth of the velocity of a joint that an effort accelerates, in some intervals of the samples [rad/s]."""
        holder = self.sources.holder(axis)
        if holder is None or holder.quantity != _QUANTITY[Mode.TORQUE][0]:
            return 0.0
        change = self.velocity(axis) - self.joints[axis].velocity(self._speeds_before[axis])
        return change * intervals if change * self._heading[axis] > 0.0 else 0.0

    def _position(self, axis: int) -> float:
        """Position of a joint [rad]."""
        assert self._axes is not None
        return self.joints[axis].position(self._axes[axis].position * self._variables[Mode.POSITION].lsb)

    def _is_beyond(self, axis: int, position: float, heading: float) -> bool:
        """Whether a position is beyond the end of the range in a direction (sign)."""
        limits = self.joints[axis].limits
        return position > limits.position_max if heading > 0.0 else position < limits.position_min

    def set_torque_constants(self, values: Sequence[float]) -> None:
        """Set the nominal torque per ampere of i_q of every axis [N m/A]."""
        self._torque_constants = list(values)

    def lost(self, reason: str) -> None:
        """Discard the pending set-points; further ones are refused until ``enable`` is called again."""
        self._link = reason
        if self._axes is not None:
            self.block("the link to the board was lost")
        self.queue.lost()
        self._axes = self._tick = None
        self._torque_constants = None

    # ---- release by ``enable``
    def release(self) -> None:
        """Accept set-points from now on; the control modes are written again."""
        self._blocked = ""
        self.queue.forget_modes()

    def block(self, reason: str) -> None:
        """Refuse set-points from now on and discard the pending ones."""
        self._blocked = reason
        for axis in range(AXES):
            self.release_axis(axis, reason)

    def release_axis(self, axis: int, reason: str) -> None:
        """Discard the pending set-points and the path of an axis; a source must join it again (see `admission`)."""
        self.sources.release(axis)
        self._head(axis, 0.0)
        self.queue.put(axis, None, reason)

    @property
    def used(self) -> list[int]:
        """The axes with a motor."""
        return [axis for axis, joint in enumerate(self.joints) if joint.used]

    @property
    def armed(self) -> bool:
        """True if a set-point for every joint in use would be accepted."""
        blocked = self._blocked or self.inactive
        axes = self._axes
        return axes is not None and not blocked and all(axes[axis].accepts_set_points for axis in self.used)

    # ---- commands
    def submit(self, *requests: SetPointRequest) -> None:
        """Check requests and queue their set-points, also if they equal the previous ones.

        Parameters
        ----------
        *requests : SetPointRequest
            Well-formed commands, of different axes.

        Raises
        ------
        Rejected
            If any part of a request is refused; then nothing is changed.
        """
        targets = self.check(*requests)
        for request in requests:
            source = Source(request.source, _QUANTITY[request.mode][0])
            self.sources.claim(source, request.values, self._joints, self.queue.follows)
            for axis, value in request.values.items():
                self._head(axis, 0.0 if request.mode is Mode.POSITION else math.copysign(bool(value), value))
        for axis, (topic, target) in targets.items():
            self.queue.put(axis, target, f"a set-point on {topic} took over")

    def check(self, *requests: SetPointRequest) -> dict[int, tuple[str, Target]]:
        """Check requests as `submit`, without an effect.

        Returns
        -------
        dict of int to (str, Target)
            By axis: source and set-point.

        Raises
        ------
        Rejected
            If any part of a request is refused.
        """
        targets: dict[int, tuple[str, Target]] = {}
        for request in requests:
            self.check_source(request.source, request.values)
            for axis in request.values:
                if request.mode is not Mode.POSITION:
                    self._check_heading(request, axis)
                targets[axis] = request.source, Target(request.mode, self._raw(request, axis))
        return targets

    def velocity(self, axis: int) -> float:
        """Measured velocity of a joint [rad/s]; after `check_ready`."""
        assert self._axes is not None
        return self.joints[axis].velocity(self._axes[axis].speed)

    def place(self, topic: str, axis: int, *, streaming: bool) -> Place:
        """State of an axis that a set-point of a topic wants to join; after `check_ready`."""
        joint, holder = self.joints[axis], self.sources.holder(axis)
        position, velocity = self._position(axis), self.velocity(axis)
        moves = self.queue.follows(axis) or self.sources.age(axis) < SETTLING or abs(velocity) > JOIN_SPEED
        other = holder.topic if holder is not None and holder.topic != topic and moves else ""
        return Place(joint.name, position, velocity, holder, other, streaming, joint.wraps)

    def admit_path(self, source: str, axes: Collection[int]) -> None:
        """Register that some axes follow a path from now on; after `check_source`."""
        self.sources.claim(Source(source, "trajectory"), axes, self._joints, self.queue.follows)
        for axis in axes:
            self._head(axis, 0.0)
        self.queue.discard(axes)

    def check_source(self, source: str, axes: Collection[int]) -> None:
        """Check that some axes accept set-points of a source.

        Raises
        ------
        Rejected
            If they do not.
        """
        self.check_ready(source, axes)
        self.sources.require(source, axes, self._joints, self.queue.follows)

    def check_ready(self, source: str, axes: Iterable[int]) -> None:
        """Check that some axes accept set-points.

        Raises
        ------
        NotReady
            If an axis does not.
        """
        if self._axes is None:
            raise NotReady(f"{source}: not connected ({self._link}); see state and /diagnostics")
        if self.inactive:
            raise NotReady(f"{source}: {self.inactive}; then call the service enable with data: true")
        for axis in axes:
            status, joint = self._axes[axis], self._joints[axis]
            if not self.joints[axis].used:
                raise NotReady(f"{source}: parameter used says that {joint} has no motor; leave it out, or change used")
            if status.faulted:
                raise NotReady(
                    f"{source}: {joint} is in FAULT; see /diagnostics for cause and remedy, call clear_faults, "
                    "then enable"
                )
            if self._blocked:
                raise NotReady(f"{source}: {self._blocked}; call the service enable with data: true first")
            if not status.accepts_set_points:
                raise NotReady(
                    f"{source}: {joint} is in {status.label}, not in RUN/SPIN; call the service enable with "
                    "data: true and wait until armed is true",
                    kind="not in RUN/SPIN",
                )

    # ---- details
    def _head(self, axis: int, heading: float) -> None:
        self._heading[axis] = heading
        if heading != self._blocked_heading[axis]:
            self._blocked_heading[axis] = 0.0

    def _check_heading(self, request: SetPointRequest, axis: int) -> None:
        """Refuse a velocity or an effort that leads out of the range of a joint at its end."""
        value = request.values[axis]
        if not value or not self.joints[axis].limits.bounded:
            return
        heading, position = math.copysign(1.0, value), self._position(axis)
        if heading == self._blocked_heading[axis] or self._is_beyond(axis, position, heading):
            quantity, unit = _QUANTITY[request.mode]
            joint = self.joints[axis]
            raise NotReady(
                f"{request.source}: {quantity} of {joint.name} is {value:g} {unit}, but the joint is at the end of its "
                f"range, at {position:.4g} rad of {joint.limits.position_min:g} .. {joint.limits.position_max:g} rad; "
                "command the other direction, or a position",
                kind=f"{joint.name} at the end of its range",
            )

    def _raw(self, request: SetPointRequest, axis: int) -> int:
        value, mode, joint = request.values[axis], request.mode, self.joints[axis]
        variable = self._variables[mode]
        limit_low, limit_high = _configured_range(joint.limits, mode)
        factor = 1.0
        if mode is Mode.POSITION:
            assert self._axes is not None
            position = self._axes[axis].position
            ends = [joint.position((position + distance) * variable.lsb) for distance in (-self._reach, self._reach)]
            value = joint.nearest(value, joint.position(position * variable.lsb))
            motor = joint.motor_position(value)
        elif mode is Mode.SPEED:
            ends = [joint.velocity(end) for end in (variable.minimum, variable.maximum)]
            motor = joint.motor_velocity(value)
        else:
            factor = self._amperes_per_newton_metre(request.source, axis)
            ends = [joint.effort(end / factor) for end in (variable.minimum, variable.maximum)]
            motor = joint.motor_effort(value)
        low, high = sorted(ends)
        boards = (value > high and high <= limit_high) or (value < low and low >= limit_low)
        remedy = (_REACH if mode is Mode.POSITION else _BOARD) if boards else _REMEDY
        low, high = max(low, limit_low), min(high, limit_high)
        if not low <= value <= high:
            quantity, unit = _QUANTITY[mode]
            raise Rejected(
                f"{request.source}: {quantity} of {joint.name} is {value:g} {unit}, outside {low:g} .. {high:g} "
                f"{unit}; {remedy}"
            )
        if mode is Mode.POSITION:
            # Positions of the board wrap at 32 bits; the board takes the shorter distance.
            return unwrap_u32(round(motor / variable.lsb) & 0xFFFF_FFFF, 0)
        # Rounding of the product must not exceed the limit.
        return variable.to_raw(min(max(motor * factor, variable.minimum), variable.maximum))

    def _amperes_per_newton_metre(self, source: str, axis: int) -> float:
        if self._torque_constants is None or self._torque_constants[axis] <= 0.0:
            raise Rejected(
                f"{source}: the board has not reported the torque constant of {self._joints[axis]}; try again in 1 s"
            )
        return 1.0 / self._torque_constants[axis]


def _configured_range(limits: JointLimits, mode: Mode) -> tuple[float, float]:
    """Smallest and largest set-point of a mode in the configuration."""
    if mode is Mode.POSITION:
        return limits.position_min, limits.position_max
    magnitude = limits.velocity_max if mode is Mode.SPEED else limits.effort_max
    return -magnitude, magnitude
