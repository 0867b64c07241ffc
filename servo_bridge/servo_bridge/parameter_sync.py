"""Parameters of the connected board: read, compare with the request, write, verify, report.

All methods run in the thread of the executor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

from servo_msgs_py.board_parameters import Assignment, RawParameters, applied, contradiction, parameters, si
from servo_msgs_py.catalogue import Value, numbers
from servo_msgs_py.value_text import value_text

from servo_bridge.board_context import BoardContext
from servo_bridge.outcome import error_of
from servo_bridge.part import Part


class ParameterSync(Part):
    """Keeps the parameters of the board at the values that the user requests.

    Parameters that are not requested keep the value of the board. `trouble` has the first error.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    write_raw : callable
        Starts to write all elements of a variable as firmware integers.
    changed : callable
        Receives the raw parameters after each reading.
    """

    def __init__(
        self,
        context: BoardContext,
        write_raw: Callable[[str, Sequence[int]], Future[Any]],
        changed: Callable[[RawParameters], None],
    ) -> None:
        self.wanted: Sequence[Assignment] = ()
        self.values: RawParameters | None = None  # read from the board; None: not known
        self.trouble = ""  # first error of the present request; empty: none
        self._context = context
        self._catalogue = context.catalogue
        self._names = [variable.name for variable in parameters(context.catalogue)]
        self._write_raw = write_raw
        self._changed = changed
        self._connected = False
        self._round = 0  # results of earlier rounds are ignored

    # ---- calls of the owner
    def request(self, assignments: Sequence[Assignment]) -> None:
        """Set these parameters now and after every connection."""
        self.wanted = assignments
        self.refresh()

    def refresh(self) -> None:
        """Read the parameters again if a board is connected: their defaults may have changed."""
        if self._connected:
            self._begin()

    def check(self, assignments: Sequence[Assignment]) -> str:
        """Reason to refuse these parameters; empty if they are valid."""
        return contradiction(applied(assignments, self.values or {}), self._catalogue)

    def connected(self) -> None:
        """Read the parameters, and write those that are requested."""
        self._connected = True
        self._begin()

    def lost(self, reason: str) -> None:
        """Forget the parameters of the board."""
        self._connected = False
        self._round += 1
        self.values = None
        self.trouble = ""

    # ---- one round: read, write differences, read again
    def _begin(self) -> None:
        self._round += 1
        self.trouble = ""
        self._fetch(self._compare)

    def _fetch(self, then: Callable[[dict[str, list[int]]], None]) -> None:
        number = self._round

        def take(values: list[Value], error: str | None) -> None:
            if number != self._round:
                return
            if error is not None:
                self._fail(f"the parameters of the board cannot be read: {error}")
                return
            pairs = zip(self._names, values, strict=True)
            then({name: [self._raw(name, x) for x in numbers(value)] for name, value in pairs})

        self._context.read_all(self._names, take)

    def _compare(self, found: dict[str, list[int]]) -> None:
        target = applied(self.wanted, found)
        problem = contradiction(target, self._catalogue)
        if problem:
            self._tell(found)
            self._fail(f"the parameters stay as they are: {problem}")
            return
        names = [name for name in target if target[name] != found[name]]
        if not names:
            self._tell(found)
            return
        futures = {name: self._write_raw(name, target[name]) for name in names}
        number = self._round

        def written(_: Future[Any]) -> None:
            if number != self._round:
                return
            errors = {name: error_of(future) for name, future in futures.items()}
            self._fetch(lambda now: self._verify(names, found, target, now, errors))

        # The link works in order: the last future is the last to be done.
        self._context.when_done(futures[names[-1]], written)

    def _verify(
        self,
        names: Sequence[str],
        before: RawParameters,
        target: RawParameters,
        now: dict[str, list[int]],
        errors: dict[str, str | None],
    ) -> None:
        for name in names:
            if list(now[name]) == list(target[name]):
                self._context.info(f"{name}: {self._text(name, before)} -> {self._text(name, now)}")
            else:
                reason = errors[name] or "the board has another value"
                self._fail(f"{name} is {self._text(name, now)}, requested {self._text(name, target)}: {reason}")
        self._tell(now)

    # ---- details
    def _tell(self, values: dict[str, list[int]]) -> None:
        self.values = values
        self._changed(values)

    def _fail(self, text: str) -> None:
        self.trouble = self.trouble or text
        self._context.warn(text)

    def _raw(self, name: str, value: float) -> int:
        return round(value / self._catalogue[name].lsb)

    def _text(self, name: str, values: RawParameters) -> str:
        return value_text(self._catalogue[name], si({name: values[name]}, self._catalogue)[name], self._catalogue)
