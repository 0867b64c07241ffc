"""Homing of the axes, what their positions are worth, and the position that a restarted board has had. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Final

from servo_msgs_py.catalogue import AXES, Catalogue, Value, axis_name, numbers
from servo_msgs_py.joints import Joint
from servo_msgs_py.units import SLOW_PERIODS, unwrap_u32

from servo_bridge.arbiter import Arbiter
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.outcome import error_of
from servo_bridge.services import Outcome
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.setpoints import NotReady
from servo_bridge.telemetry import Snapshot

METHODS: Final = ("here", "stop_positive", "stop_negative", "switch_positive", "switch_negative")
"""How the position of a joint becomes known; the directions are those of the joint."""

_TAKEN: Final = 4 * SLOW_PERIODS
"""PWM periods after which a command that has taken effect shows in the telemetry."""

_TIMEOUT: Final = 32_000
"""PWM periods (2 s) after a restart within which a position is restored."""

_RETRY: Final = 3_200
"""PWM periods (0.2 s) between two attempts."""

_LOOK: Final = 4_000
"""PWM periods (0.25 s) between two looks at the states, which would take room in every sample."""

_LOOK_CLOSELY: Final = 800
"""The same (0.05 s) while something is waited for."""

_AT_REST: Final = 2.0
"""Speed from which on a shaft will be elsewhere when its board has restarted [rad/s]."""

_COLUMNS: Final = tuple(f"{axis_name(axis)}.home_state" for axis in range(AXES))

_REASONS: Final = {
    "ABORTED": "another command, a stop or a fault has ended it",
    "MOTION": "the axis has to hold its position, without a trajectory; wait for its rest, or enable it first",
    "SENSORLESS": "without an encoder there is no position",
    "KNOWN": "the position is already known",
    "NOT_FOUND": "neither stop nor switch within home.turns_max of the configuration",
    "TIMEOUT": "neither stop nor switch in time",
    "BLOCKED": "the shaft is blocked before it has reached the switch",
    "STUCK": "the shaft does not move away from the stop or the switch",
    "SPREAD": "the places that were found lie farther apart than home.spread of the configuration",
}


def with_home_states(columns: Sequence[str]) -> list[str]:
    """Columns of a sample that has been completed by `Homing.completed`."""
    return list(dict.fromkeys([*columns, *_COLUMNS]))


@dataclass
class _Job:
    """A homing that is to be answered."""

    axis: int
    since: int  # tick
    answer: Future[Outcome]
    reading: bool = False


@dataclass
class _Memory:
    """What is known of an axis for the time after a restart of its board."""

    position: int | None = None  # [counts]; None as well while the shaft turns
    wanted: bool = False  # the feature is on
    until: int | None = None  # tick up to which it may be restored; None: nothing to restore
    next: int = 0  # tick of the next attempt
    tried: int = 0  # tick from which on a look says whether the last one had an effect


@dataclass
class _Axis:
    state: int = 0
    memory: _Memory = field(default_factory=_Memory)


class Homing:
    """All axes of one board; in the executor's thread.

    Parameters
    ----------
    catalogue : Catalogue
        For names and scales.
    arbiter : Arbiter
        Tells whether an axis obeys.
    dispatcher : Dispatcher
        Carries the writes.
    read : callable
        Reads a variable of the board.
    post : callable
        Runs a function in the executor's thread.
    moved : callable
        Called with the axis whose position may count from elsewhere.
    say, warn : callable
        Get a sentence for the log.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[Joint],
        positions: Sequence[float],
        restores: bool,
        arbiter: Arbiter,
        dispatcher: Dispatcher,
        read: Callable[[str], Future[Value]],
        post: Callable[[Callable[[], None]], None],
        *,
        moved: Callable[[int], None],
        say: Callable[[str], None],
        warn: Callable[[str], None],
    ) -> None:
        self.joints = list(joints)  # in the order of the axes
        self.positions = list(positions)  # of the references, in joint units [rad]
        self.restores = restores  # whether a restarted board gets its previous positions back
        self._catalogue = catalogue
        self._states = catalogue.enums["home_state_t"]
        self._methods = catalogue.enums["home_method_t"]
        self._feature = catalogue.flag("features", "HOMING").mask
        self._lsb = catalogue["cmd.home_position"].lsb
        self._arbiter, self._dispatcher = arbiter, dispatcher
        self._read, self._post, self._say, self._warn = read, post, say, warn
        self._moved = moved
        self._looking = False
        self._next_look = 0
        self._seen = -1  # tick at which the states were asked for
        self._axes = [_Axis() for _ in range(AXES)]
        self._epoch: int | None = None
        self._connected = False
        self._jobs: list[_Job] = []

    # ---- what the board says
    @property
    def known(self) -> list[bool]:
        """Per axis, whether its position is known."""
        return [self._connected and axis.state == self._states["KNOWN"] for axis in self._axes]

    @property
    def restoring(self) -> bool:
        """Whether positions count from elsewhere for the moment."""
        return any(axis.memory.until is not None for axis in self._axes)

    def completed(self, snapshot: Snapshot) -> Snapshot:
        """The sample with the states of all axes, as they were last seen."""
        if self._epoch is not None and snapshot.epoch != self._epoch:
            for axis in self._axes:
                axis.state = self._states["UNKNOWN"]
        states = {name: float(axis.state) for name, axis in zip(_COLUMNS, self._axes, strict=True)}
        return replace(snapshot, values={**snapshot.values, **states})

    def on_snapshot(self, snapshot: Snapshot, features: Sequence[int] | None) -> None:
        """Take the newest completed sample, and the features of the axes, as far as they are known."""
        restarted = self._epoch is not None and snapshot.epoch != self._epoch
        if restarted:
            self._seen, self._next_look = -1, 0
        self._epoch, self._connected = snapshot.epoch, True
        for number, axis in enumerate(self._axes):
            self._remember(number, axis, snapshot, restarted, features)
        self._look(snapshot)
        for job in self._jobs:
            at_work = self._axes[job.axis].state == self._states["HOMING"]
            if not job.reading and not at_work and self._seen >= job.since:
                job.reading = True
                self._ask_result(job)

    def _look(self, snapshot: Snapshot) -> None:
        """Read the states now and then."""
        if self._looking or snapshot.tick < self._next_look:
            return
        self._looking = True
        self._next_look = snapshot.tick + (_LOOK_CLOSELY if self._jobs or self.restoring else _LOOK)
        futures = [self._read(name) for name in _COLUMNS]

        def take() -> None:
            self._looking = False
            if snapshot.epoch != self._epoch or any(error_of(future) is not None for future in futures):
                return
            self._seen = snapshot.tick
            for number, future in enumerate(futures):
                state = round(numbers(future.result())[0])
                if state != self._axes[number].state:
                    self._axes[number].state = state
                    self._moved(number)

        futures[-1].add_done_callback(lambda _: self._post(take))

    def link_lost(self, reason: str) -> None:
        """Answer every call that waits."""
        self._connected = False
        self._looking, self._next_look = False, 0
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            job.answer.set_result((False, f"the link was lost: {reason}"))
        for axis in self._axes:
            axis.memory.until = None

    # ---- services
    def home(self, axis: int, method: str) -> Future[Outcome]:
        """Make the position of an axis known: one of `METHODS`. The answer comes at the end."""
        answer: Future[Outcome] = Future()
        joint = self.joints[axis]
        if not self._connected:
            answer.set_result((False, "not connected; see state and /diagnostics"))
            return answer
        if method != "here":
            try:
                self._arbiter.check_ready(f"home of {joint.name}", [axis])
            except NotReady as error:
                answer.set_result((False, str(error)))
                return answer
        value = round(joint.motor_position(self.positions[axis]) / self._lsb)
        low, high = self._catalogue["cmd.home_position"].raw_range
        if not low <= value <= high:
            position = self.positions[axis]
            answer.set_result((False, f"home_positions of {joint.name} is {position:g} rad: too far for the board"))
            return answer
        self._axes[axis].memory.until = None  # what is asked for now counts, not what was restored
        for job in [job for job in self._jobs if job.axis == axis]:
            self._jobs.remove(job)
            job.answer.set_result((False, f"{joint.name} is not homed: {_REASONS['ABORTED']}"))
        self._write(axis, value, self._methods[self._of_motor(joint, method)], answer)
        return answer

    @staticmethod
    def _of_motor(joint: Joint, method: str) -> str:
        """The method in the direction of the motor."""
        if joint.direction < 0:
            swapped = {"positive": "negative", "negative": "positive"}
            kind, _, way = method.partition("_")
            method = f"{kind}_{swapped[way]}" if way else method
        return method.upper()

    # ---- details
    def _write(self, axis: int, value: int, method: int, answer: Future[Outcome]) -> None:
        def written(result: Future[int]) -> None:
            error = error_of(result)
            if error is not None:
                answer.set_result((False, error))
            else:
                self._jobs.append(_Job(axis, result.result() + _TAKEN, answer))
                self._next_look = 0
                self._moved(axis)

        def placed(result: Future[int]) -> None:
            error = error_of(result)
            if error is not None:
                answer.set_result((False, error))
            else:
                write = CommandWrite("cmd.home", axis, (method,))
                self._dispatcher.urgent(write).add_done_callback(written)

        self._dispatcher.urgent(CommandWrite("cmd.home_position", axis, (value,))).add_done_callback(placed)

    def _ask_result(self, job: _Job) -> None:
        name = axis_name(job.axis)
        futures = [self._read(f"{name}.home_result"), self._read(f"{name}.home_spread")]

        def take() -> None:
            if job not in self._jobs:
                return  # answered when the link was lost
            self._jobs.remove(job)
            errors = [error for future in futures if (error := error_of(future)) is not None]
            if errors:
                job.answer.set_result((False, errors[0]))
                return
            result, spread = (round(numbers(future.result())[0]) for future in futures)
            job.answer.set_result(self._outcome(job.axis, result, spread))

        futures[-1].add_done_callback(lambda _: self._post(take))

    def _outcome(self, axis: int, result: int, spread: int) -> Outcome:
        label = self._catalogue.label("home_result_t", result)
        joint = self.joints[axis]
        if label == "DONE":
            return True, f"{joint.name} is homed; its reference was found within {spread} counts"
        return False, f"{joint.name} is not homed: {_REASONS.get(label, label)}"

    # ---- after a restart
    def _remember(
        self, number: int, axis: _Axis, snapshot: Snapshot, restarted: bool, features: Sequence[int] | None
    ) -> None:
        memory = axis.memory
        if axis.state in (self._states["KNOWN"], self._states["ASSUMED"]):
            if memory.until is not None:
                self._say(f"{self.joints[number].name}: the position from before the restart is assumed")
            memory.until = None
            turns = abs(snapshot.values[f"{axis_name(number)}.speed"]) > _AT_REST
            memory.position = None if turns else snapshot.axes[number].position
            if features is not None:
                memory.wanted = bool(features[number] & self._feature)
            return
        if restarted and memory.position is not None and memory.wanted and self.restores:
            memory.until, memory.next, memory.tried = snapshot.tick + _TIMEOUT, snapshot.tick, self._seen
        if memory.until is None:
            memory.position = None  # lost, or about to be found anew
        elif snapshot.tick > memory.until or snapshot.axes[number].spinning:
            memory.until = memory.position = None
            self._warn(f"{self.joints[number].name}: its position was not restored, as it does not rest; home it")
        elif snapshot.tick >= memory.next and self._seen >= memory.tried:
            memory.next, memory.tried = snapshot.tick + _RETRY, snapshot.tick + _TAKEN
            position = memory.position
            assert position is not None
            value = unwrap_u32((position + snapshot.axes[number].position) & 0xFFFF_FFFF, 0)
            self._write(number, value, self._methods["ASSUME"], Future())
