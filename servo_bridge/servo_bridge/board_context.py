"""Access of the parts of the supervisor to the board, the thread of the executor and the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from servo_msgs_py.catalogue import Catalogue, Value

from servo_bridge.outcome import error_of
from servo_bridge.wire.session import Call

T = TypeVar("T")


@dataclass(frozen=True)
class BoardContext:
    """A board, the thread that owns its state, and the log."""

    catalogue: Catalogue
    read: Callable[[str], Future[Value]]  # starts to read a variable [SI]
    call: Call  # calls a function with the session of the board, in the thread of the link
    post: Callable[[Callable[[], None]], None]  # runs a function in the thread of the executor; from any thread
    info: Callable[[str], None]  # logs a message
    warn: Callable[[str], None]  # logs a warning

    def when_done(self, future: Future[T], function: Callable[[Future[T]], None]) -> None:
        """Call a function with a future in the thread of the executor as soon as the future is done."""
        future.add_done_callback(lambda done: self.post(partial(function, done)))

    def read_all(self, names: Sequence[str], take: Callable[[list[Value], str | None], None]) -> None:
        """Read variables and pass the result to a function, in the thread of the executor.

        Parameters
        ----------
        names : sequence of str
            At least one variable.
        take : callable
            Called once, with the values [SI] in the order of the names and None; or, if a read has failed, with an
            empty list and the first error. The caller checks whether it still needs the result.
        """
        futures = [self.read(name) for name in names]

        def all_read(_: Future[Value]) -> None:
            error = next((error for error in map(error_of, futures) if error is not None), None)
            take([future.result() for future in futures] if error is None else [], error)

        # The link works in order: the last future is the last to be done, unless the queue is full; then it has failed.
        self.when_done(futures[-1], all_read)
