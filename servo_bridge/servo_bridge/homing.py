"""Homing of the axes, validity of the positions, and restoring them after a restart of the board."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Final

from servo_msgs_py.catalogue import AXES, Value, axis_name, numbers
from servo_msgs_py.joints import Joint
from servo_msgs_py.units import SLOW_PERIODS, unwrap_u32

from servo_bridge.arbiter import Arbiter
from servo_bridge.board_context import BoardContext
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.outcome import Outcome, answered, error_of
from servo_bridge.part import Part
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.set_points import NotReady
from servo_bridge.telemetry import Snapshot

_EFFECT: Final = 4 * SLOW_PERIODS
"""PWM periods after which the effect of a command is in the telemetry."""

_TIMEOUT: Final = 32_000
"""PWM periods (2 s) after a restart in which a position can be restored."""

_RETRY: Final = 3_200
"""PWM periods (0.2 s) between two attempts to restore a position."""

_POLL: Final = 4_000
"""PWM periods (0.25 s) between readings of the home states; they are omitted from the samples, to keep these short."""

_POLL_FAST: Final = 800
"""PWM periods (0.05 s) between readings during a homing or restoring."""

_REST_SPEED_MAX: Final = 2.0
"""Above this speed the position is not stored for a restart [rad/s]."""

_COLUMNS: Final = tuple(f"{axis_name(axis)}.home_state" for axis in range(AXES))

_REASONS: Final = {
    "ABORTED": "ended by another command, a stop or a fault",
    "MOTION": "the axis must hold its position without a trajectory; wait for standstill, or enable it first",
    "SENSORLESS": "an axis without an encoder has no position",
    "KNOWN": "the position is already known",
    "NOT_FOUND": "no stop or switch found within home.turns_max of the configuration",
    "TIMEOUT": "timeout: no stop or switch found",
    "BLOCKED": "the shaft was blocked before it reached the switch",
    "STUCK": "the shaft does not move away from the stop or the switch",
    "SPREAD": "the spread of the positions found exceeds home.spread of the configuration",
}


_MIRRORED: Final = {
    "stop_positive": "stop_negative",
    "stop_negative": "stop_positive",
    "switch_positive": "switch_negative",
    "switch_negative": "switch_positive",
}
"""Methods of a joint that rotates against its motor."""


def with_home_states(columns: Sequence[str]) -> list[str]:
    """Columns of a sample after `Homing.completed`."""
    return list(dict.fromkeys([*columns, *_COLUMNS]))


@dataclass
class _Job:
    """A homing in progress."""

    axis: int
    since: int  # tick
    answer: Future[Outcome]
    reading: bool = False


@dataclass
class _Memory:
    """Stored position of an axis, for a restart of its board."""

    position: int | None = None  # [counts]; None while the shaft rotates
    enabled: bool = False  # the feature is on
    until: int | None = None  # last tick to restore it; None: nothing to restore
    next: int = 0  # tick of the next attempt
    tried: int = 0  # tick after which a reading shows the effect of the last attempt


@dataclass
class _Axis:
    state: int = 0
    memory: _Memory = field(default_factory=_Memory)


class Homing(Part):
    """Homing of all axes of one board; called in the thread of the executor.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    arbiter : Arbiter
        Checks whether an axis accepts set-points.
    dispatcher : Dispatcher
        Sends the writes.
    features : callable
        Features of the axes (``param.features``); None if not known.
    moved : callable
        Called with an axis whose position may have changed its reference.
    """

    def __init__(
        self,
        context: BoardContext,
        joints: Sequence[Joint],
        positions: Sequence[float],
        restores: bool,
        arbiter: Arbiter,
        dispatcher: Dispatcher,
        features: Callable[[], Sequence[int] | None],
        moved: Callable[[int], None],
    ) -> None:
        self.joints = list(joints)  # in the order of the axes
        self.positions = list(positions)  # of the references, in joint units [rad]
        self.restores = restores  # whether positions are restored after a restart of the board
        self._context = context
        self._catalogue = catalogue = context.catalogue
        self._states = catalogue.enums["home_state_t"]
        self._methods = catalogue.enums["home_method_t"]
        self._feature = catalogue.flag("features", "HOMING").mask
        self._lsb = catalogue["cmd.home_position"].lsb
        self._arbiter, self._dispatcher = arbiter, dispatcher
        self._features = features
        self._moved = moved
        self._reading = False
        self._next_poll = 0
        self._polled = -1  # tick of the request of the last reading of the states
        self._axes = [_Axis() for _ in range(AXES)]
        self._epoch: int | None = None
        self._connected = False
        self._jobs: list[_Job] = []

    # ---- telemetry
    @property
    def known(self) -> list[bool]:
        """Per axis, whether the position is known."""
        return [self._connected and axis.state == self._states["KNOWN"] for axis in self._axes]

    @property
    def restoring(self) -> bool:
        """Whether a position is being restored, so that positions have another reference for the moment."""
        return any(axis.memory.until is not None for axis in self._axes)

    def completed(self, snapshot: Snapshot) -> Snapshot:
        """Return the sample with the last known home states of all axes."""
        if self._epoch is not None and snapshot.epoch != self._epoch:
            for axis in self._axes:
                axis.state = self._states["UNKNOWN"]
        states = {name: float(axis.state) for name, axis in zip(_COLUMNS, self._axes, strict=True)}
        return replace(snapshot, values={**snapshot.values, **states})

    def on_sample(self, snapshot: Snapshot) -> None:
        """Process the newest sample, see `completed`."""
        restarted = self._epoch is not None and snapshot.epoch != self._epoch
        if restarted:
            self._polled, self._next_poll = -1, 0
        self._epoch, self._connected = snapshot.epoch, True
        features = self._features()
        for number, axis in enumerate(self._axes):
            self._store_or_restore(number, axis, snapshot, restarted, features)
        self._poll(snapshot)
        for job in self._jobs:
            homing = self._axes[job.axis].state == self._states["HOMING"]
            if not job.reading and not homing and self._polled >= job.since:
                job.reading = True
                self._read_result(job)

    def _poll(self, snapshot: Snapshot) -> None:
        """Read the home states periodically."""
        if self._reading or snapshot.tick < self._next_poll:
            return
        self._reading = True
        self._next_poll = snapshot.tick + (_POLL_FAST if self._jobs or self.restoring else _POLL)

        def take(values: list[Value], error: str | None) -> None:
            self._reading = False
            if snapshot.epoch != self._epoch or error is not None:
                return
            self._polled = snapshot.tick
            for number, value in enumerate(values):
                state = round(numbers(value)[0])
                if state != self._axes[number].state:
                    self._axes[number].state = state
                    self._moved(number)

        self._context.read_all(_COLUMNS, take)

    def lost(self, reason: str) -> None:
        """End all homings."""
        self._connected = False
        self._reading, self._next_poll = False, 0
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            job.answer.set_result((False, f"the link was lost: {reason}"))
        for axis in self._axes:
            axis.memory.until = None

    # ---- services
    def home(self, axis: int, method: str) -> Future[Outcome]:
        """Home an axis or set its position by one of `topics.HOME_METHODS`; the future is done at the end."""
        joint = self.joints[axis]
        if not self._connected:
            return answered(False, "not connected; see state and /diagnostics")
        if method != "here":
            try:
                self._arbiter.check_ready(f"home of {joint.name}", [axis])
            except NotReady as error:
                return answered(False, str(error))
        value = round(joint.motor_position(self.positions[axis]) / self._lsb)
        self._axes[axis].memory.until = None  # the new homing replaces the restoring
        for job in [job for job in self._jobs if job.axis == axis]:
            self._jobs.remove(job)
            job.answer.set_result((False, f"{joint.name} is not homed: {_REASONS['ABORTED']}"))
        answer: Future[Outcome] = Future()
        self._write(axis, value, self._methods[self._of_motor(joint, method)], answer)
        return answer

    @staticmethod
    def _of_motor(joint: Joint, method: str) -> str:
        """Method in the direction of the motor."""
        if joint.direction < 0:
            method = _MIRRORED.get(method, method)
        return method.upper()

    # ---- details
    def _write(self, axis: int, value: int, method: int, answer: Future[Outcome]) -> None:
        def written(result: Future[int]) -> None:
            error = error_of(result)
            if error is not None:
                answer.set_result((False, error))
            else:
                self._jobs.append(_Job(axis, result.result() + _EFFECT, answer))
                self._next_poll = 0
                self._moved(axis)

        def placed(result: Future[int]) -> None:
            error = error_of(result)
            if error is not None:
                answer.set_result((False, error))
            else:
                write = CommandWrite("cmd.home", axis, (method,))
                self._dispatcher.urgent(write).add_done_callback(written)

        self._dispatcher.urgent(CommandWrite("cmd.home_position", axis, (value,))).add_done_callback(placed)

    def _read_result(self, job: _Job) -> None:
        def take(values: list[Value], error: str | None) -> None:
            if job not in self._jobs:
                return  # ended by the loss of the link
            self._jobs.remove(job)
            if error is not None:
                job.answer.set_result((False, error))
                return
            result, spread = (round(numbers(value)[0]) for value in values)
            job.answer.set_result(self._outcome(job.axis, result, spread))

        name = axis_name(job.axis)
        self._context.read_all([f"{name}.home_result", f"{name}.home_spread"], take)

    def _outcome(self, axis: int, result: int, spread: int) -> Outcome:
        label = self._catalogue.label("home_result_t", result)
        joint = self.joints[axis]
        if label == "DONE":
            return True, f"{joint.name} is homed; spread of the reference {spread} counts"
        return False, f"{joint.name} is not homed: {_REASONS.get(label, label)}"

    # ---- after a restart
    def _store_or_restore(
        self, number: int, axis: _Axis, snapshot: Snapshot, restarted: bool, features: Sequence[int] | None
    ) -> None:
        memory = axis.memory
        if axis.state in (self._states["KNOWN"], self._states["ASSUMED"]):
            if memory.until is not None:
                self._context.info(
                    f"{self.joints[number].name}: the position before the restart was restored (home_state ASSUMED)"
                )
            memory.until = None
            rotates = abs(snapshot.values[f"{axis_name(number)}.speed"]) > _REST_SPEED_MAX
            memory.position = None if rotates else snapshot.axes[number].position
            if features is not None:
                memory.enabled = bool(features[number] & self._feature)
            return
        if restarted and memory.position is not None and memory.enabled and self.restores:
            memory.until, memory.next, memory.tried = snapshot.tick + _TIMEOUT, snapshot.tick, self._polled
        if memory.until is None:
            memory.position = None  # lost, or being homed
        elif snapshot.tick > memory.until or snapshot.axes[number].accepts_set_points:
            memory.until = memory.position = None
            self._context.warn(
                f"{self.joints[number].name}: position not restored: the axis was enabled, or not at rest within 2 s; "
                "home it"
            )
        elif snapshot.tick >= memory.next and self._polled >= memory.tried:
            memory.next, memory.tried = snapshot.tick + _RETRY, snapshot.tick + _EFFECT
            position = memory.position
            assert position is not None
            value = unwrap_u32((position + snapshot.axes[number].position) & 0xFFFF_FFFF, 0)
            self._write(number, value, self._methods["ASSUME"], Future())
