"""A virtual board on a serial port: a pseudo-terminal, paced in real time.

Whatever talks to a real board over a USB serial port talks to this one in the same way. `Pacer` decides what time it is
on the board, `Terminal` is the port, `serve` moves bytes and time between them.
"""

from __future__ import annotations

import argparse
import errno
import os
import select
import signal
import stat
import sys
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final, Protocol

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.level import Level, add_level_option
from servo_twin.plant import PlantConfig, PlantError

MAX_LAG_S: Final = 0.05
"""Backlog that is made up for; a longer stall of the machine is given up and counted as a slip [s]."""

IDLE_SLICE_S: Final = 0.002
"""Longest sleep while nothing moves on the wire [s]."""

REPORT_INTERVAL_S: Final = 10.0
"""Shortest time between two messages about slips [s]."""

FIRST_REPORT_S: Final = 1.0
"""Time that has to pass before the first one, to know the speed [s]."""


class LinkError(Exception):
    """The link to the pseudo-terminal cannot be made; the message says why."""


class Pacer:
    """Simulated time as a function of wall time, with absolute deadlines.

    Parameters
    ----------
    now_ns : int
        Wall time that stands for simulated time `sim_ns` [ns].
    sim_ns : int
        Simulated time at that moment [ns].
    speed : float
        Simulated seconds per second of wall time.
    max_lag_s : float
        Backlog that is made up for [s of wall time].
    """

    def __init__(self, now_ns: int, sim_ns: int = 0, *, speed: float = 1.0, max_lag_s: float = MAX_LAG_S) -> None:
        self._wall_ns = now_ns
        self._sim_ns = sim_ns
        self._speed = speed
        self._max_lag_ns = round(max_lag_s * 1e9 * speed)
        self.slips = 0  # number of longer backlogs that were dropped
        self.slipped_s = 0.0  # dropped wall time in all [s]

    def target(self, now_ns: int, reached_ns: int) -> int:
        """Simulated time that the board should have now [ns].

        Parameters
        ----------
        now_ns : int
            Wall time [ns].
        reached_ns : int
            Simulated time that it has reached [ns].
        """
        target = self._at(now_ns)
        excess = target - reached_ns - self._max_lag_ns
        if excess > 0:
            self.slips += 1
            self.slipped_s += excess / self._speed * 1e-9
            self._wall_ns, self._sim_ns = now_ns, target - excess
            target -= excess
        return target

    def delay(self, now_ns: int, sim_ns: int) -> float:
        """Wall time until simulated time `sim_ns`, 0 if that has passed [s]."""
        return max(sim_ns - self._at(now_ns), 0) / self._speed * 1e-9

    def _at(self, now_ns: int) -> int:
        return self._sim_ns + int((now_ns - self._wall_ns) * self._speed)


class FlashFile:
    """What stays of a board without power, in a file: `Board.flash_image`.

    It is brought up to date whenever a command of the flash has ended: the end of the process, however it comes, is
    like a power failure.

    Parameters
    ----------
    path : Path
        A file that does not exist yet is an erased flash.

    Raises
    ------
    OSError
        If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kept = path.read_bytes() if path.exists() else None

    @property
    def image(self) -> bytes | None:
        """As the file has it."""
        return self._kept

    def update(self, board: Board) -> None:
        """Write what is in the flash of a board, if it is something else; in one step."""
        image = board.flash_image()
        if image != self._kept:
            fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
            fresh.write_bytes(image)
            fresh.replace(self._path)
            self._kept = image


class Terminal:
    """A raw pseudo-terminal, and optionally a symbolic link to its other end.

    It keeps that other end open itself, so clients may close and open it as they like.

    Parameters
    ----------
    link : Path, optional
        Where to put the link. A link to a terminal or to nowhere is replaced; anything else is left alone.

    Raises
    ------
    LinkError
        If the link cannot be made.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._master, self._slave = os.openpty()
        self._link = link
        self.lost = 0  # bytes discarded because no client fetched them
        try:
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self.device = os.ttyname(self._slave)  # name of the other end, such as ``/dev/pts/3``
            if link is not None:
                _make_link(link, self.device)
        except BaseException:
            self._close_ends()
            raise

    def close(self) -> None:
        """Remove the link, unless it leads elsewhere by now, and close both ends."""
        if self._link is not None:
            try:
                if os.readlink(self._link) == self.device:
                    self._link.unlink()
            except OSError:
                pass  # removed or replaced meanwhile
            self._link = None
        self._close_ends()

    def _close_ends(self) -> None:
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)
        self._master = self._slave = -1

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def wait(self, timeout: float, *, readable: bool = True) -> bool:
        """Sleep until a client has sent something, at most `timeout` [s]; without `readable` just sleep."""
        ready, _, _ = select.select([self._master] if readable else [], [], [], timeout)
        return bool(ready)

    def read(self) -> bytes:
        """What clients have sent, empty if nothing."""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Hand bytes to the client; what does not fit because it is not read is lost, as on a wire."""
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._master, view) :]
            except BlockingIOError:
                self.lost += len(view)
                return


def _make_link(link: Path, device: str) -> None:
    """Symbolic link to a device, in one step even if there is one already."""
    try:
        if link.is_symlink():
            if link.exists() and not stat.S_ISCHR(link.stat().st_mode):
                raise LinkError(f"{link} is a link to {os.readlink(link)}, which is no terminal; choose another name")
        elif link.exists():
            raise LinkError(f"{link} exists and is not a link; choose another name or remove it")
        fresh = link.with_name(f".{link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(device)
        fresh.replace(link)
    except OSError as error:
        reason = "its folder does not exist" if error.errno == errno.ENOENT else error.strerror
        raise LinkError(f"cannot make the link {link}: {reason}") from error


class _Board(Protocol):
    """What `serve` needs of a board."""

    @property
    def time_ns(self) -> int: ...
    def advance(self, until_ns: int) -> None: ...
    def serial_in(self, data: bytes) -> int: ...
    def serial_out(self) -> bytes: ...
    def serial_next_ns(self) -> int | None: ...


class _Line(Protocol):
    """What `serve` needs of a terminal."""

    def wait(self, timeout: float, *, readable: bool = True) -> bool: ...
    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...


def serve(
    board: _Board,
    line: _Line,
    pacer: Pacer,
    stopped: Callable[[], bool],
    *,
    clock_ns: Callable[[], int] = time.monotonic_ns,
    on_slip: Callable[[Pacer], None] = lambda pacer: None,
    on_step: Callable[[], None] = lambda: None,
) -> None:
    """Run a board in step with the clock and connect it with a line until `stopped`.

    Parameters
    ----------
    board : Board
        The board.
    line : Terminal
        The client's side of its serial line.
    pacer : Pacer
        What time it is on the board.
    stopped : callable
        Asked at least every few milliseconds.
    clock_ns : callable
        Monotonic wall time [ns].
    on_slip : callable
        Told when time has slipped.
    on_step : callable
        Called whenever the board has been brought up to the clock.
    """
    waiting = b""  # sent by the client, no room on the board's side yet
    slips = pacer.slips
    while not stopped():
        board.advance(pacer.target(clock_ns(), board.time_ns))
        if pacer.slips != slips:
            slips = pacer.slips
            on_slip(pacer)
        on_step()
        sent = board.serial_out()
        if sent:
            line.write(sent)
        now_ns, next_ns = clock_ns(), board.serial_next_ns()
        delay = IDLE_SLICE_S if next_ns is None else min(IDLE_SLICE_S, pacer.delay(now_ns, next_ns))
        if line.wait(delay, readable=not waiting):
            waiting = line.read()
        if waiting:
            # the bytes begin on the wire now, not when the board was last looked at
            board.advance(pacer.target(clock_ns(), board.time_ns))
            waiting = waiting[board.serial_in(waiting) :]


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
    """Turn SIGINT and SIGTERM into a flag."""
    caught: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        caught.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def slip_reporter(level: Level, clock_ns: Callable[[], int] = time.monotonic_ns) -> Callable[[Pacer], None]:
    """Warning about slips, with what is left of the speed since the one before, at most every `REPORT_INTERVAL_S`.

    Parameters
    ----------
    level : {"registers", "ideal"}
        Of the board, to be named.
    clock_ns : callable
        Monotonic wall time [ns].
    """
    last_ns = clock_ns()
    slipped_s = 0.0

    def report(pacer: Pacer) -> None:
        nonlocal last_ns, slipped_s
        passed_s = (clock_ns() - last_ns) * 1e-9
        if passed_s < FIRST_REPORT_S or (slipped_s > 0.0 and passed_s < REPORT_INTERVAL_S):
            return
        factor = max(1.0 - (pacer.slipped_s - slipped_s) / passed_s, 0.0)
        print(
            f"virtual_board: warning: the machine is too slow for a board at level {level}: time runs at"
            f" {factor:.2f} of its speed (last {passed_s:.1f} s); {_slips(pacer)}",
            file=sys.stderr,
            flush=True,
        )
        last_ns, slipped_s = clock_ns(), pacer.slipped_s

    return report


def _slips(pacer: Pacer) -> str:
    return f"time slipped {pacer.slips} times, {pacer.slipped_s:.3f} s in all"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="virtual_board",
        description="A servo board without hardware: the firmware, two motors and a DC bus behind a serial port (a "
        "pseudo-terminal), in real time. Stop it with Ctrl-C.",
        epilog="Exit status: 0 stopped by SIGINT or SIGTERM, 1 the system refused something, 2 wrong options, link or "
        "plant file. Example: virtual_board --link /tmp/servo --baud 1000000",
    )
    parser.add_argument("--link", type=Path, help="symbolic link to the port, to have a name that stays the same")
    parser.add_argument(
        "--baud", type=float, default=115200.0, help="speed of the line in bit/s (default: %(default)g)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the sensor noise; the same seed gives the same board"
    )
    parser.add_argument("--plant", type=Path, help="TOML file with what differs from the packaged plant.toml")
    parser.add_argument(
        "--flash",
        type=Path,
        metavar="FILE",
        help="keep what the board stores in its data flash (default: until it ends)",
    )
    add_level_option(parser, "the board is")
    parser.add_argument(
        "--speed", type=argument.positive, default=1.0, help="simulated seconds per second (default: %(default)g)"
    )
    return parser


def main(argv: list[str] | None = None) -> int:
    """Command ``virtual_board``; returns its exit status."""
    options = _parser().parse_args(argv)
    try:
        flash = FlashFile(options.flash) if options.flash else None
        board = Board(
            PlantConfig.load(options.plant),
            seed=options.seed,
            baud=options.baud,
            level=options.level,
            flash=flash.image if flash else None,
        )
    except (PlantError, ValueError) as error:
        return _complain(str(error), 2)
    except OSError as error:
        return _complain(f"{error.filename or options.plant}: {error.strerror}", 2)
    try:
        with board, _stop_signals() as stopped, Terminal(options.link) as line:
            where = f"{options.link} -> {line.device}" if options.link else line.device
            what = f"{options.baud:g} baud, seed {options.seed}, level {board.level}"
            print(f"virtual_board: {where}, {what}; Ctrl-C stops it", flush=True)
            pacer = Pacer(time.monotonic_ns(), speed=options.speed)
            keep = _keeper(board, flash)
            serve(board, line, pacer, stopped, on_slip=slip_reporter(board.level), on_step=keep)
            print(
                f"virtual_board: stopped after {board.time_ns * 1e-9:.3f} s; {_slips(pacer)}; "
                f"bytes lost: {board.stats().serial_overruns} to the board, {line.lost} to the client"
            )
    except LinkError as error:
        return _complain(str(error), 2)
    except OSError as error:
        return _complain(str(error), 1)
    return 0


def _keeper(board: Board, flash: FlashFile | None) -> Callable[[], None]:
    """Brings the file of the flash up to date when a command has been begun or has ended."""
    if flash is None:
        return lambda: None
    before = board.flash_state()
    flash.update(board)

    def keep() -> None:
        nonlocal before
        now = board.flash_state()
        if now != before:
            before = now
            flash.update(board)

    return keep


def _complain(message: str, status: int) -> int:
    print(f"virtual_board: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
