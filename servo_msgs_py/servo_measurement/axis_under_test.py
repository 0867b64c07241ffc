"""Axis during a measurement: preconditions, supervised commands, session of the board, restored state.

The board itself restores configuration and parameters at the end of a session, however it ends (app/measurement.h).

Active set-points are rewritten within `param.command_timeout`: if the host stops communicating, the board stops the
shaft.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from servo_msgs_py.board_port import choose, place, reached
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.value_text import value_text

from servo_measurement.access import (
    OSCILLATION,
    BoardAccess,
    Capture,
    MeasurementError,
    faults_refused,
    refuse_faults,
)

POLL_TIME: Final = 0.02  # polling period of conditions [s]
REST_SPEED: Final = 0.5  # largest speed at rest without current [rad/s]
HELD_SPEED: Final = 1.0  # largest speed at rest under position control, which can move the shaft by a count [rad/s]

_REST_MAX: Final = 6.0  # timeout for coming to rest without current [s]
_SLOWING: Final = 0.9  # largest ratio of the speeds at the end and the beginning of this time while coasting
_SWING: Final = 4.0  # smallest swing of an oscillation, relative to the speed at rest
_HOLD_MAX: Final = 5.0  # timeout for coming to rest under control [s]
_REFRESH_PART: Final = 0.25  # interval of rewriting a set-point, relative to its timeout
_REFRESH_MAX: Final = 0.25  # the same interval if set-points do not expire [s]
_INSTANT: Final = 1e-6  # shorter than any write [s]
_ATTEMPTS: Final = 3
_SESSION_MAX: Final = 8.0
"""Timeout for the end of a session [s]: the longest stop of the board, the rotor at rest, and the configuration."""
_SESSION: Final = "measurement.axis"
_ENDED: Final = {
    "NONE": "it was reset; check its supply and measure again",
    "CLOSED": "another program has ended it; stop that program and measure again",
    "SILENT": "no keep-alive arrived in time; measure again with less load on the computer",
    "STOPPED": "a quick stop was requested; measure again",
    "REPLACED": "another program has begun a session; stop that program and measure again",
}
"""Reasons by `measurement_end_t`."""
_OTHER_MOTION: Final = ("EXPIRED", "STARVED", "POSITION", "NOT_HOMED", "INPUT")

Step = tuple[str, Callable[[], None]]
"""Name and function of a restoration step."""


class AxisUnderTest:
    """One axis of a board during a measurement.

    Parameters
    ----------
    access : BoardAccess
        The board.
    axis : int
        Index of the axis.
    report : callable, optional
        Called with a line of text about each step, and about failed restorations.
    """

    def __init__(self, access: BoardAccess, axis: int, report: Callable[[str], None] = lambda text: None) -> None:
        self.access, self.axis, self.name, self.report = access, axis, axis_name(axis), report
        self.unrestored: list[str] = []  # failed restorations with their causes; complete after `restored`
        self._set_point: tuple[str, float] | None = None
        self._due = 0.0  # next time of rewriting it, on the clock of the access [s]
        self._find_interval()

    # ---- variables ---------------------------------------------------------------------------------------------------

    def value(self, variable: str) -> float:
        """Value [SI] of a variable of the axis, or number of an enumeration value."""
        return self.access.read(f"{self.name}.{variable}")[0]

    def label(self, variable: str) -> str:
        """Name of an enumeration value."""
        return self._named(f"{self.name}.{variable}")

    def _named(self, variable: str) -> str:
        enum = self.access.catalogue[variable].enum
        assert enum is not None
        return self.access.catalogue.label(enum, self.access.read_words(variable)[0])

    def masks(self, kind: str) -> dict[str, int]:
        """Bit masks of flags by name."""
        return {flag.name: flag.mask for flag in self.access.catalogue.flags[kind]}

    def write(self, variable: str, value: float) -> None:
        """Write an element [SI] of an array variable."""
        self._check_session(variable)
        self.access.write(variable, [value], self.axis)

    def write_word(self, variable: str, raw: int) -> None:
        self._check_session(variable)
        if not self.access.write_words(variable, [raw], self.axis):
            value = self.access.catalogue[variable].scale(raw)
            text = value_text(self.access.catalogue[variable], value, self.access.catalogue)
            raise MeasurementError(f"{variable}: the board refuses {text}")

    @property
    def substate(self) -> str:
        """Substate of RUN, or the state."""
        return place(self.access, self.axis)

    # ---- set-points --------------------------------------------------------------------------------------------------

    def mode(self, mode: str) -> None:
        """Change the mode; the previous set-point is no longer rewritten."""
        self.release()
        choose(self.access, "cmd.mode", self.axis, mode)

    def command(self, variable: str, value: float) -> None:
        """Write a set-point [SI] and rewrite it from now on; an error if the previous one has expired."""
        if self._set_point is not None:
            self.refuse_limits("EXPIRED")
        self.write(variable, value)
        self._set_point, self._due = (variable, value), self.access.clock() + self._interval

    def release(self) -> None:
        """Stop rewriting the set-point, so that it may expire before the next one."""
        self._set_point = None

    def command_timeout(self, seconds: float) -> None:
        """Change the timeout of set-points on the board [s]."""
        self._check_session("param.command_timeout")
        self.access.write("param.command_timeout", [seconds])
        self._find_interval()

    def _find_interval(self) -> None:
        timeout = self.access.read("param.command_timeout")[0]
        self._interval = _REFRESH_PART * timeout if timeout else _REFRESH_MAX

    def renew(self) -> None:
        """Write the set-point again."""
        if self._set_point is not None:
            self.command(*self._set_point)

    # ---- supervision -------------------------------------------------------------------------------------------------

    def clock(self) -> float:
        """Time of the access [s]."""
        return self.access.clock()

    def wait(self, seconds: float) -> None:
        """Wait [s] while rewriting the set-point; it is also rewritten if communication has taken the whole time."""
        while True:
            self._refresh()
            if seconds < _INSTANT:
                return
            part = seconds if self._set_point is None else min(seconds, max(self._due - self.access.clock(), _INSTANT))
            self.access.wait(part)
            seconds -= part

    def attend(self) -> None:
        """Rewrite the set-point and send a keep-alive where they are due; to be called during a computation."""
        self.wait(_INSTANT)

    def _refresh(self) -> None:
        if self._set_point is not None and self.access.clock() > self._due - _INSTANT:
            self.renew()

    def reached(self, condition: Callable[[], bool], seconds: float, *, refuse_on_fault: bool = True) -> bool:
        """Wait up to `seconds` [s] for a condition; False at the timeout. A fault is an error if `refuse_on_fault`."""

        def holds() -> bool:
            if condition():
                return True
            if refuse_on_fault:
                refuse_faults(self.access, self.axis)
            return False

        return reached(self, holds, seconds, POLL_TIME)

    def until(
        self,
        condition: Callable[[], bool],
        seconds: float,
        problem: str,
        remedy: str = "",
        *,
        refuse_on_fault: bool = True,
    ) -> None:
        """Like `reached`; a `MeasurementError` at the timeout."""
        if not self.reached(condition, seconds, refuse_on_fault=refuse_on_fault):
            raise MeasurementError(f"{self.name} {problem} within {seconds:g} s{remedy}")

    def refuse_limits(self, *names: str) -> None:
        """Raise an error if limits are active; by default all that make the shaft deviate from its set-point."""
        word = int(self.value("limits"))
        for flag in self.access.catalogue.active("limits", word):
            if flag.name in (names or _OTHER_MOTION):
                raise MeasurementError(f"{self.name} is limited. {flag.name}: {flag.cause}. {flag.remedy}".rstrip(". "))

    def is_limited(self, name: str) -> bool:
        """Whether a limit is active."""
        return bool(int(self.value("limits")) & self.masks("limits")[name])

    def record(self, capture: Capture) -> Trace:
        """Record as `BoardAccess.record`, with the names of the capture without that of the axis.

        The set-point is rewritten during the recording; a fault is an error.
        """

        def supervise(full: bool) -> None:
            capture.meanwhile(full)
            self._refresh()

        names = [f"{self.name}.{column}" for column in capture.names]
        trigger = capture.trigger and f"{self.name}.{capture.trigger}"
        with faults_refused(self.access, self.axis):
            return self.access.record(replace(capture, names=names, trigger=trigger, meanwhile=supervise))

    # ---- standstill and outputs ------------------------------------------------------------------------------------

    def is_at_rest(self, speed: float = REST_SPEED) -> bool:
        """Whether the shaft is at rest: below `speed` [rad/s], by default without current."""
        return abs(self.value("speed")) < speed

    def wait_for_rest(self, speed: float = REST_SPEED) -> None:
        """Wait until the shaft is at rest; `speed` as in `is_at_rest`.

        A shaft that coasts with little friction may take several times the timeout, as long as it becomes slower. A
        fault is an error: it also brings the shaft to rest.
        """
        before, now = math.inf, abs(self.value("speed"))
        speeds = [0.0]

        def rests() -> bool:
            speeds.append(self.value("speed"))
            return abs(speeds[-1]) < speed

        while now < _SLOWING * before:
            if self.reached(rests, _REST_MAX, refuse_on_fault=False):
                refuse_faults(self.access, self.axis)
                return
            before, now = now, abs(self.value("speed"))
        refuse_faults(self.access, self.axis)
        self.refuse_limits("REGENERATION")
        swing = min(max(speeds), -min(speeds))
        if speed == HELD_SPEED and swing > _SWING * speed:  # else nothing controls it
            text = f"{self.name} oscillates under control, by {swing:.2g} rad/s"
            raise MeasurementError(text, "couple an inertia", about=OSCILLATION)
        raise MeasurementError(
            f"{self.name} does not come to rest within {_REST_MAX:g} s: an external torque moves the shaft"
        )

    def hold(self) -> None:
        """Stop at the acceleration limit and hold the position."""
        self.mode("POSITION")
        self.until(
            lambda: abs(self.value("speed")) < HELD_SPEED and abs(self.value("speed_ref")) < HELD_SPEED,
            _HOLD_MAX,
            "has not come to rest",
        )

    def enable(self, substate: str, seconds: float) -> None:
        """Enable the outputs and wait for a substate, up to `seconds` [s]."""
        self.refuse_ended_session()
        self.write_word("cmd.enable", 1)
        problem = f"has not reached {substate}"
        self.until(lambda: self.substate == substate, seconds, problem, ": check the board")

    def off(self) -> None:
        """Disable the outputs and wait for standstill."""
        self.release()
        self.write_word("cmd.enable", 0)

        def ended() -> bool:
            return self.label("state") in ("STOP", "FAULT") and self.is_at_rest()

        remedy = ": an external torque moves the shaft; remove the load, or balance it"
        self.until(ended, _REST_MAX, "does not come to rest with its outputs off", remedy, refuse_on_fault=False)
        self.wait(0.1)

    # ---- session and restoration ------------------------------------------------------------------------------------

    @contextmanager
    def session(self, steps: Sequence[Step] = (), remedy: str = "") -> Iterator[None]:
        """Begin a session of the board, and end it after these steps; see `restored`.

        Raises
        ------
        MeasurementError
            If the board refuses a session.
        """
        if not self.reached(self._begun, _SESSION_MAX, refuse_on_fault=False):
            raise MeasurementError(f"the board refuses a measurement for {_SESSION_MAX:g} s: {self._refusal()}")
        with self.restored([*steps, ("configuration and parameters", self._end_session)], remedy):
            yield

    def _begun(self) -> bool:
        """Begin a session; a refusal ends the session of a program that was killed."""
        return self.access.write_words(_SESSION, [self.axis + 1])

    def _refusal(self) -> str:
        """Why the board refuses a session, with a remedy."""
        if self._named("measurement.state") == "RESTORING":
            return (
                "it restores the values before another one, and a shaft moves: bring the shafts to rest and try again"
            )
        if self._named("storage.state") != "IDLE":
            return "it stores values in its data flash: wait until it has done so, and try again"
        return (
            "points of a trajectory or another configuration wait to take effect, or another program measures: stop "
            "the other program, disable the axes and try again"
        )

    def _end_session(self) -> None:
        self.access.write_words(_SESSION, [0])
        self.until(
            lambda: self._named("measurement.state") == "NONE",
            _SESSION_MAX,
            "keeps another configuration",
            ": an external torque moves the shaft; the board restores it at rest, and is not enabled before",
            refuse_on_fault=False,
        )

    def refuse_ended_session(self) -> None:
        """Raise an error if the board has ended the session and restored its values: further changes would remain."""
        if self._named("measurement.state") != "OPEN":
            reason = _ENDED[self._named("measurement.ended")]
            raise MeasurementError(f"the board has ended the session and restores its values: {reason}")

    def _check_session(self, variable: str) -> None:
        """Parameters are written in a session only."""
        if variable.startswith("param."):
            self.refuse_ended_session()

    @contextmanager
    def restored(self, steps: Sequence[Step], remedy: str = "") -> Iterator[None]:
        """Execute all of these steps at the end of the block, also after an error; each failed step is repeated.

        Ctrl-C during a step only causes its repetition. Failed steps are reported.

        Raises
        ------
        MeasurementError
            If a step has failed, and no other error has ended the block.
        """
        try:
            yield
        finally:
            self.release()
            self.unrestored = [f"{name}: {reason}" for name, step in steps if (reason := _execute(step))]
            for text in self.unrestored:
                self.report(f"NOT RESTORED: {text}")
        if self.unrestored:
            raise MeasurementError(self.restoring_text(remedy))

    def restoring_text(self, remedy: str = "") -> str:
        """Failed restorations with remedy; empty if there are none."""
        text = f"{self.name} could not be restored: {'; '.join(self.unrestored)}{remedy}"
        return text if self.unrestored else ""


def _execute(step: Callable[[], None]) -> str:
    """Execute a step; returns the cause of its failure, or an empty text."""
    reason = ""
    for _ in range(_ATTEMPTS):
        try:
            step()
        except KeyboardInterrupt:
            reason = "ended by Ctrl-C"
        except Exception as error:  # the access has its own error for a lost link
            reason = str(error) or type(error).__name__
        else:
            return ""
    return reason
