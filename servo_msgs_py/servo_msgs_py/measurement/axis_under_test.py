"""The axis under test: what it has to be like before, commands and motion under guard, and the way back. Pure.

A set-point is written again within `param.command_timeout` as long as it is wanted: when the host falls silent, the
board stops the shaft.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Final

from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.measurement.access import (
    BoardAccess,
    MeasurementError,
    Recording,
    faults_refused,
    refuse_faults,
    send_configuration,
)

LOOK: Final = 0.02  # between two looks at the board [s]
REST_SPEED: Final = 0.5  # of a shaft that stands without current [rad/s]
HELD_SPEED: Final = 1.0  # of one that is held: position control moves it by a count [rad/s]

_REST_MAX: Final = 6.0  # until a shaft without current stands [s]
_HOLD_MAX: Final = 5.0  # until one that is stopped does [s]
_RENEWED: Final = 0.25  # of the time-out, between two writes of a set-point
_RENEW_MAX: Final = 0.25  # the same where set-points do not expire [s]
_INSTANT: Final = 1e-6  # less than a write takes [s]
_TRIES: Final = 3
_COMMANDS: Final = ("cmd.i_q", "cmd.speed", "cmd.mode")
_NOT_OF_AN_AXIS: Final = ("param.monitor",)
"""Arrays whose elements are not the axes."""
_OTHER_MOTION: Final = ("EXPIRED", "STARVED", "POSITION", "NOT_HOMED", "INPUT")

Step = tuple[str, Callable[[], None]]
"""Something to be brought back, and what does it."""


class AxisUnderTest:
    """One axis of a board that is being measured.

    Parameters
    ----------
    access : BoardAccess
        The board.
    axis : int
        Index of the axis.
    report : callable, optional
        Gets a line about what is done, and about what could not be brought back.
    """

    def __init__(self, access: BoardAccess, axis: int, report: Callable[[str], None] = lambda text: None) -> None:
        self.access, self.axis, self.name, self.report = access, axis, axis_name(axis), report
        self.unrestored: list[str] = []  # what is not as it was before, each with the reason; complete after `restored`
        self._set_point: tuple[str, float] | None = None
        self._due = 0.0  # when it has to be written again, by the clock of the access [s]
        self._find_interval()

    # ---- variables ---------------------------------------------------------------------------------------------------

    def value(self, variable: str) -> float:
        """Value [SI] of a variable of the axis, or number of an enumeration value."""
        return self.access.read(f"{self.name}.{variable}")[0]

    def label(self, variable: str) -> str:
        """Name of an enumeration value."""
        enum = self.access.catalogue[f"{self.name}.{variable}"].enum
        assert enum is not None
        return self.access.catalogue.label(enum, int(self.value(variable)))

    def masks(self, kind: str) -> dict[str, int]:
        """Bits of flags by name."""
        return {flag.name: flag.mask for flag in self.access.catalogue.flags[kind]}

    def write(self, variable: str, value: float) -> None:
        """Write an element [SI] of an array variable."""
        self.access.write(variable, [value], self.axis)

    def write_word(self, variable: str, raw: int) -> None:
        if not self.access.write_words(variable, [raw], self.axis):
            raise MeasurementError(f"{variable}: the board refuses {raw}")

    @property
    def substate(self) -> str:
        """Of RUN; empty in another state."""
        return self.label("substate") if self.label("state") == "RUN" else ""

    # ---- set-points --------------------------------------------------------------------------------------------------

    def mode(self, mode: str) -> None:
        """Another mode; a set-point of the last one is not kept up any more."""
        self.release()
        self.write_word("cmd.mode", self.access.catalogue.enums["control_mode_t"][mode])

    def command(self, variable: str, value: float) -> None:
        """Write a set-point [SI], and keep it up from now on; an expiry of the last one meanwhile is refused."""
        if self._set_point is not None:
            self.refuse_limits("EXPIRED")
        self.write(variable, value)
        self._set_point, self._due = (variable, value), self.access.clock() + self._interval

    def release(self) -> None:
        """Keep up no set-point any more: the next one may come after the last one has expired."""
        self._set_point = None

    def command_timeout(self, seconds: float) -> None:
        """Another time after which set-points of the board expire [s]."""
        self.access.write("param.command_timeout", [seconds])
        self._find_interval()

    def _find_interval(self) -> None:
        timeout = self.access.read("param.command_timeout")[0]
        self._interval = _RENEWED * timeout if timeout else _RENEW_MAX

    def renew(self) -> None:
        """Write the set-point again."""
        if self._set_point is not None:
            self.command(*self._set_point)

    # ---- under guard -------------------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Let time pass [s]; the set-point is kept up, also where exchanges have taken the time."""
        while True:
            self._keep_up()
            if seconds < _INSTANT:
                return
            part = seconds if self._set_point is None else min(seconds, max(self._due - self.access.clock(), _INSTANT))
            self.access.wait(part)
            seconds -= part

    def _keep_up(self) -> None:
        if self._set_point is not None and self.access.clock() > self._due - _INSTANT:
            self.renew()

    def reached(self, condition: Callable[[], bool], seconds: float, *, guarded: bool = True) -> bool:
        """Wait for a condition, at most `seconds` [s]; a fault is refused if `guarded`. False: it has not come."""
        for _ in range(math.ceil(seconds / LOOK - 1e-6)):
            if condition():
                return True
            if guarded:
                refuse_faults(self.access, self.axis)
            self.wait(LOOK)
        return condition()

    def until(
        self, condition: Callable[[], bool], seconds: float, problem: str, remedy: str = "", *, guarded: bool = True
    ) -> None:
        """The same; a `MeasurementError` if it does not come."""
        if not self.reached(condition, seconds, guarded=guarded):
            raise MeasurementError(f"{self.name} {problem} within {seconds:g} s{remedy}")

    def refuse_limits(self, *names: str) -> None:
        """Refuse some limits; by default all in which a shaft does not turn as it is asked to."""
        word = int(self.value("limits"))
        for flag in self.access.catalogue.active("limits", word):
            if flag.name in (names or _OTHER_MOTION):
                raise MeasurementError(
                    f"{self.name} is held back. {flag.name}: {flag.cause}. {flag.remedy}".rstrip(". ")
                )

    def record(
        self,
        columns: Sequence[str],
        samples: int,
        every: int,
        slow: bool,
        start: Callable[[], None] | None = None,
        *,
        triggered: bool = True,
        lead: float = 0.0,
        meanwhile: Callable[[bool], None] = lambda full: None,
    ) -> Recording:
        """Variables of the axis, from the beginning of a test signal on if `triggered`; see `BoardAccess.record`.

        The set-point is kept up; a fault meanwhile is refused.
        """

        def attend(full: bool) -> None:
            meanwhile(full)
            self._keep_up()

        names = [f"{self.name}.{column}" for column in columns]
        trigger = f"{self.name}.test_point" if triggered else None
        with faults_refused(self.access, self.axis):
            return self.access.record(names, samples, every, slow, start, trigger=trigger, lead=lead, meanwhile=attend)

    # ---- rest and outputs --------------------------------------------------------------------------------------------

    def stands(self) -> bool:
        """Whether a shaft without current is at rest."""
        return abs(self.value("speed")) < REST_SPEED

    def stand(self) -> None:
        """Wait for that."""
        self.until(self.stands, _REST_MAX, "does not come to rest", ": something turns the shaft", guarded=False)

    def hold(self) -> None:
        """Stop at the limit and hold the position."""
        self.mode("POSITION")
        self.until(
            lambda: abs(self.value("speed")) < HELD_SPEED and abs(self.value("speed_ref")) < HELD_SPEED,
            _HOLD_MAX,
            "has not come to rest",
        )

    def enable(self, substate: str, seconds: float) -> None:
        """Outputs on, until a sub-state is reached, at most `seconds` [s]."""
        self.write_word("cmd.enable", 1)
        problem = f"has not reached {substate}"
        self.until(lambda: self.substate == substate, seconds, problem, ": is the board in order?")

    def off(self, rest: bool = True) -> None:
        """Outputs off, and the shaft at rest if `rest`."""
        self.release()
        self.write_word("cmd.enable", 0)

        def ended() -> bool:
            return self.label("state") in ("STOP", "FAULT") and (not rest or self.stands())

        remedy = ": something turns the shaft; take the load off, or balance it"
        self.until(ended, _REST_MAX, "does not come to rest with its outputs off", remedy, guarded=False)
        self.wait(0.1)

    # ---- the way back ------------------------------------------------------------------------------------------------

    @contextmanager
    def restored(self, steps: Sequence[Step], remedy: str = "") -> Iterator[None]:
        """Whatever ends the block, do all of these steps, each on its own and several times if need be.

        A Ctrl-C meanwhile only repeats the step that it ends. What could not be done is reported.

        Raises
        ------
        MeasurementError
            If something could not be done, and nothing else has ended the block.
        """
        try:
            yield
        finally:
            self.release()
            self.unrestored = [f"{what}: {reason}" for what, step in steps if (reason := _done(step))]
            for text in self.unrestored:
                self.report(f"NOT RESTORED: {text}")
        if self.unrestored:
            raise MeasurementError(self.restoring_text(remedy))

    def restoring_text(self, remedy: str = "") -> str:
        """What is not as before, and what to do about it; empty if all is."""
        text = f"{self.name} is not as it was before: {'; '.join(self.unrestored)}{remedy}"
        return text if self.unrestored else ""


def _done(step: Callable[[], None]) -> str:
    """Do something; returns why it cannot be done."""
    reason = ""
    for _ in range(_TRIES):
        try:
            step()
        except KeyboardInterrupt:
            reason = "ended by Ctrl-C"
        except Exception as error:  # a lost line is an error of the access's own
            reason = str(error) or type(error).__name__
        else:
            return ""
    return reason


class AxisState:
    """Configuration, parameters, mode and set-points of an axis with its outputs off, as they are now.

    Parameters
    ----------
    it : AxisUnderTest
        The axis.
    """

    def __init__(self, it: AxisUnderTest) -> None:
        access = it.access
        self._it, self._block = it, read_block(access, it.axis)
        names = [
            name
            for name, variable in access.catalogue.variables.items()
            if name in _COMMANDS
            or (name.startswith("param.") and variable.count == AXES and name not in _NOT_OF_AN_AXIS)
        ]
        self._words = {name: access.read_words(name)[it.axis] for name in names}
        self._timeout = access.read_words("param.command_timeout")

    def word(self, name: str) -> int:
        """Raw integer of a parameter or set-point of the axis."""
        return self._words[name]

    def value(self, name: str) -> float:
        """The same in SI."""
        return float(self._it.access.catalogue[name].scale(self._words[name]))

    @property
    def steps(self) -> list[Step]:
        """What brings all of it back; parameters are read back."""
        it = self._it

        def configuration() -> None:
            it.stand()  # one of another motor is refused before
            send_configuration(it.access, {it.axis: self._block})

        steps: list[Step] = [
            ("outputs off and shaft at rest", it.off),
            ("configuration", configuration),
            ("param.command_timeout", lambda: self._write("param.command_timeout", self._timeout, 0)),
        ]
        # a configuration brings default values of parameters with it, so these come later; mode and set-points last
        for name in sorted(self._words, key=lambda name: name in _COMMANDS):
            steps.append((name, partial(self._write, name, [self._words[name]], it.axis)))
        return steps

    def _write(self, name: str, words: Sequence[int], first: int) -> None:
        access = self._it.access
        taken = access.write_words(name, words, first)
        if not taken or access.read_words(name)[first : first + len(words)] != list(words):
            raise MeasurementError(f"the board refuses {list(words)}")
