"""Start and end of every program: signals from the first moment, closed pipes, full disks, missing ROS.

This module imports little: it runs before the modules that a program needs, whose import takes long.

=========================  =================================================================
event                      exit status, after the clean-up of the program
=========================  =================================================================
SIGINT, SIGTERM, SIGHUP    128 plus the number of the signal (130, 143, 129), without a message
reader of the output gone  141, without a message
error of a file            2 if it cannot be opened, else 1 (disk full), with its name and reason
=========================  =================================================================

A program that runs until it is told to end gives another status to a signal itself.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import import_module
from types import FrameType
from typing import Any, Final, NoReturn, ParamSpec

from servo_msgs_py.board_description import VARIABLE, OtherBoardError

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PIPE_CLOSED: Final = 128 + signal.SIGPIPE
_NOT_OPENED: Final = (errno.ENOENT, errno.EACCES, errno.EISDIR, errno.ENOTDIR, errno.EPERM, errno.ENAMETOOLONG)

_NOT_WRITTEN: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

P = ParamSpec("P")
Handler = Callable[[int, FrameType | None], None]


class Interrupted(KeyboardInterrupt):
    """SIGINT, SIGTERM or SIGHUP; a KeyboardInterrupt, so that no library takes it for an error.

    Parameters
    ----------
    number : int
        The signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number  # exit status


class Stop:
    """Request of a signal to end, noted within `deferred`."""

    def __init__(self) -> None:
        self.number: int | None = None  # the first signal; None: no request
        self._raised = False

    @property
    def requested(self) -> bool:
        return self.number is not None

    def check(self) -> None:
        """Raise `Interrupted` once; further signals do not disturb the clean-up."""
        if self.number is not None and not self._raised:
            self._raised = True
            raise Interrupted(self.number)

    def note(self, number: int, frame: FrameType | None = None) -> None:
        """Handle a signal."""
        if self.number is None:
            self.number = number


@contextlib.contextmanager
def deferred() -> Iterator[Stop]:
    """Note signals instead of raising `Interrupted` at once, to end between two steps of the program.

    For a program that has something to leave in order: a shaft, a board, a node (an exception of a signal handler would
    not pass through the executor of ROS unchanged). In another thread than the main one no signal is noted.
    """
    stop = Stop()
    with _handled(stop.note):
        yield stop


def run(name: str, module: str, *, ros: bool = False) -> int:
    """Import a module and run its ``main``, for an entry point.

    Parameters
    ----------
    name : str
        Name of the program for messages.
    module : str
        Module with ``main``, which returns the exit status.
    ros : bool
        Whether it needs rclpy.

    Returns
    -------
    int
        Exit status.
    """
    _install(_end_at_once)  # nothing has begun, so nothing has to be left in order
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)  # blocked by the script of the program
    try:
        if ros:
            import_module("rclpy")
    except ImportError as error:
        complain(
            f"{name}: rclpy cannot be imported by {sys.executable} ({error}); install ROS 2 Jazzy and source its "
            "setup.bash (its rclpy is for Python 3.12), or install its wheels with pip install 'servo_msgs_py[ros]'"
        )
        return 1
    try:
        main = import_module(module).main
    except OtherBoardError as error:  # scales are read with the modules that use them
        complain(f"{name}: {VARIABLE}: {error}")
        return 2
    return int(main())


def end(name: str, status: int) -> NoReturn:
    """End the process of a program that has left everything in order, without the destructors of its libraries.

    The middleware of ROS has threads that run while the interpreter and the C++ libraries destroy their objects; such
    an end was once a segmentation fault (status 139) after the right message.
    """
    failed = _flushed(name)
    os._exit(status or failed)


def program(name: str) -> Callable[[Callable[P, int]], Callable[P, int]]:
    """Decorate the ``main`` of a program: it returns the exit status of an event that ends it (table above).

    Parameters
    ----------
    name : str
        Name of the program for messages.
    """

    def decorate(main: Callable[P, int]) -> Callable[P, int]:
        @functools.wraps(main)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> int:
            with _handled(_raise_once):
                try:
                    status = main(*args, **kwargs)
                except Interrupted as stopped:
                    status = stopped.status
                except KeyboardInterrupt:
                    status = 128 + signal.SIGINT
                except BrokenPipeError:
                    status = _PIPE_CLOSED
                except OSError as error:
                    status = _report(name, error)
                except SystemExit as ended:  # of argparse
                    failed = _flushed(name)
                    raise SystemExit(ended.code or failed) from None
                failed = _flushed(name)
                return status or failed

        return guarded

    return decorate


def _flushed(name: str) -> int:
    """Write what the streams hold; at its end the interpreter would report an error. Returns an exit status."""
    status = 0
    for stream in (sys.stdout, sys.stderr):
        if stream is None or stream.closed:
            continue
        try:
            stream.flush()
        except OSError as error:
            _discard(stream)
            status = status or (_PIPE_CLOSED if isinstance(error, BrokenPipeError) else _report(name, error))
    return status


def _report(name: str, error: OSError) -> int:
    where = error.filename or ("output" if error.errno in _NOT_WRITTEN else "")
    complain(f"{name}: {f'{where}: ' if where else ''}{error.strerror or error}")
    return 2 if error.errno in _NOT_OPENED else 1


def complain(text: str) -> None:
    """Print a message to standard error, if there is one; the terminal may have been closed."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def _discard(stream: Any) -> None:
    """Direct a stream that cannot be written to nowhere."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


# ---- signals
@contextlib.contextmanager
def _handled(handler: Handler) -> Iterator[None]:
    """Use a handler for the ending signals; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = _install(handler)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _install(handler: Handler) -> dict[int, Any]:
    """Use a handler for the ending signals; returns the previous ones. ``nohup`` keeps SIGHUP ignored."""
    owner = os.getpid()
    # Found now: a terminal that is gone is none any more.
    terminals = [each for each in (sys.stdout, sys.stderr) if each is not None and not each.closed and each.isatty()]

    def handle(number: int, frame: FrameType | None) -> None:
        if os.getpid() != owner:  # a forked worker, which its parent ends
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        if number == signal.SIGHUP:
            for stream in terminals:
                _discard(stream)  # an error would disturb the clean-up
        handler(number, frame)

    numbers = [number for number in _ENDING if signal.getsignal(number) != signal.SIG_IGN or number == signal.SIGINT]
    return {number: signal.signal(number, handle) for number in numbers}


def _end_at_once(number: int, _: FrameType | None) -> None:
    os._exit(128 + number)


def _raise_once(number: int, _: FrameType | None) -> None:
    _install(lambda *_: None)
    raise Interrupted(number)
