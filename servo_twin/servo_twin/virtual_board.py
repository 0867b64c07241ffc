"""Virtual board with a pseudo-terminal as serial port, in real time.

It replaces a real board at a USB serial port without changes of the host. `Pacer` converts wall time to simulated time,
`Terminal` is the port, `serve` is the loop that advances the board and transfers the bytes.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import hashlib
import math
import os
import select
import sys
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from servo_msgs_py.board_description import DEFAULT_BOARD, VARIABLE, BoardDescription, known_boards
from servo_msgs_py.output_file import write_file
from servo_msgs_py.run_file.run_info import VirtualBoard
from servo_msgs_py.run_file.virtual_board_file import virtual_board_file, write_virtual_board
from servo_msgs_py.runtime.claim import claimed
from servo_msgs_py.runtime.notify import notify
from servo_msgs_py.runtime.program import complain, deferred, program
from servo_msgs_py.text_file import TextFileError, read_bytes
from servo_msgs_py.units import TICK_NS

from servo_msgs_py import argument
from servo_twin.board import Board, BoardError, SimulationError, flash_bytes
from servo_twin.level import ELF_VARIABLE, Level, add_level_options, use_elf
from servo_twin.plant import PlantConfig
from servo_twin.robot.command import MODEL_HELP as ROBOT_HELP
from servo_twin.robot.command import load as load_robot

if TYPE_CHECKING:
    from servo_twin.robot.robot_model import RobotModel
    from servo_twin.simulation_clock import SimulationClock

MAX_LAG_S: Final = 0.05
"""Largest backlog that is caught up; a longer one is skipped and counted as a slip [s]."""

IDLE_SLICE_S: Final = 0.002
"""Longest sleep while the line is idle [s]."""

REPORT_INTERVAL_S: Final = 10.0
"""Shortest time between two slip warnings [s]."""

_TERMINALS: Final = "/dev/pts/"  # folder of the pseudo-terminals

FIRST_REPORT_S: Final = 1.0
"""Averaging time before the first slip warning [s]."""


class LinkError(Exception):
    """The link to the pseudo-terminal cannot be created; the message contains the reason."""


class Pacer:
    """Simulated time as a function of wall time, with absolute deadlines.

    Parameters
    ----------
    now_ns : int
        Wall time that corresponds to simulated time `sim_ns` [ns].
    sim_ns : int
        Simulated time at that moment [ns].
    speed : float
        Simulated seconds per second of wall time.
    max_lag_s : float
        Largest backlog that is caught up [s of wall time].
    """

    def __init__(self, now_ns: int, sim_ns: int = 0, *, speed: float = 1.0, max_lag_s: float = MAX_LAG_S) -> None:
        self._wall_ns = now_ns
        self._sim_ns = sim_ns
        self._speed = speed
        self._max_lag_s = max_lag_s
        self._max_lag_ns = round(max_lag_s * 1e9 * speed)
        self.slips = 0  # number of skipped backlogs
        self.slipped_s = 0.0  # total of skipped wall time [s]

    def target(self, now_ns: int, reached_ns: int) -> int:
        """Present set-point of the simulated time [ns].

        Parameters
        ----------
        now_ns : int
            Wall time [ns].
        reached_ns : int
            Simulated time of the board [ns].
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
        missing = max(sim_ns - self._at(now_ns), 0)
        return missing / self._speed * 1e-9 if missing and self._speed else math.inf if missing else 0.0

    def set_speed(self, now_ns: int, speed: float) -> None:
        """Change the speed from wall time `now_ns` on; 0 stops the time, and then no backlog is skipped."""
        self._wall_ns, self._sim_ns, self._speed = now_ns, self._at(now_ns), speed
        self._max_lag_ns = round(self._max_lag_s * 1e9 * speed) if speed else sys.maxsize

    def step(self, duration_ns: int) -> None:
        """Let an additional simulated time [ns] elapse."""
        self._sim_ns += duration_ns

    def _at(self, now_ns: int) -> int:
        return self._sim_ns + int((now_ns - self._wall_ns) * self._speed)


class FlashFile:
    """File with the non-volatile memory of a board: `Board.flash_image`.

    It is updated after every flash command, so that any end of the process is equivalent to a power failure.

    Parameters
    ----------
    path : Path
        A missing file means an erased flash.

    Raises
    ------
    ValueError
        If it is no image of a flash.
    OSError
        If the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kept: bytes | None = None
        if not path.exists():
            return
        if not path.is_file():
            raise ValueError(f"{path} is not a regular file; choose another name")
        size = flash_bytes(BoardDescription.load().name)
        with contextlib.suppress(TextFileError):  # too large
            self._kept = read_bytes(path, size)
        if self._kept is None or len(self._kept) != size:
            raise ValueError(f"{path} is no image of a flash, which has {size} bytes; choose another file")

    @property
    def image(self) -> bytes | None:
        """Contents of the file; None if it did not exist."""
        return self._kept

    def update(self, board: Board) -> None:
        """Replace the file atomically if the flash of the board has changed."""
        image = board.flash_image()
        if image != self._kept:
            write_file(self._path, image)
            self._kept = image


class Terminal:
    """A raw pseudo-terminal, and optionally a symbolic link to its slave end.

    Keeps the slave end open, so that clients can close and reopen it.

    Parameters
    ----------
    link : Path, optional
        Path of the link. The link of a terminal that has ended is replaced; other files and links are not.

    Raises
    ------
    LinkError
        If the link cannot be created.
    ClaimError
        If it is the link of another `Terminal`.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._claim = contextlib.ExitStack()
        if link is not None:
            self._claim.enter_context(claimed(link))
        self._master, self._slave = os.openpty()
        self._link = link
        self.lost = 0  # bytes discarded because no client read them
        try:
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self.device = os.ttyname(self._slave)  # name of the slave end, such as ``/dev/pts/3``
            if link is not None:
                _make_link(link, self.device)
        except BaseException:
            self._close_ends()
            raise

    def close(self) -> None:
        """Remove the link with the file beside it, unless it has been replaced, and close both ends."""
        if self._link is not None:
            try:
                if os.readlink(self._link) == self.device:
                    self._link.unlink()
                    virtual_board_file(self._link).unlink(missing_ok=True)
            except OSError:
                pass  # removed or replaced in the meantime
            self._link = None
        self._close_ends()

    def _close_ends(self) -> None:
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)
        self._master = self._slave = -1
        self._claim.close()

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def wait(self, timeout: float, *, readable: bool = True) -> bool:
        """Sleep until a client has sent data, at most `timeout` [s]; without `readable` always `timeout`."""
        ready, _, _ = select.select([self._master] if readable else [], [], [], timeout)
        return bool(ready)

    def read(self) -> bytes:
        """Received data; may be empty."""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the client; bytes beyond the buffer of the terminal are lost."""
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._master, view) :]
            except BlockingIOError:
                self.lost += len(view)
                return


def _make_link(link: Path, device: str) -> None:
    """Create a symbolic link to a device, or replace that of a terminal, atomically."""
    try:
        if link.is_symlink():
            if not os.readlink(link).startswith(_TERMINALS):
                raise LinkError(f"{link} is a link to {os.readlink(link)}; choose another name or remove it")
        elif link.exists():
            raise LinkError(f"{link} exists and is not a link; choose another name or remove it")
        temporary = link.with_name(f".{link.name}.{os.getpid()}")
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(device)
        temporary.replace(link)
    except OSError as error:
        reason = "folder does not exist" if error.errno == errno.ENOENT else error.strerror
        raise LinkError(f"cannot create the link {link}: {reason}") from error


class _Board(Protocol):
    """Interface of a board for `serve`."""

    @property
    def time_ns(self) -> int: ...
    def advance(self, until_ns: int) -> None: ...
    def serial_in(self, data: bytes) -> int: ...
    def serial_out(self) -> bytes: ...
    def serial_next_ns(self) -> int | None: ...


class _Line(Protocol):
    """Interface of a terminal for `serve`."""

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
    """Run a board in real time and connect it with a line until `stopped`.

    Parameters
    ----------
    board : Board
        The board.
    line : Terminal
        Serial line to the client.
    pacer : Pacer
        Simulated time as a function of wall time.
    stopped : callable
        Polled at least every few milliseconds.
    clock_ns : callable
        Monotonic wall time [ns].
    on_slip : callable
        Called after a slip.
    on_step : callable
        Called after every advance of the board.
    """
    waiting = b""  # received from the client, not yet accepted by the board
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
            # the transmission of the bytes starts now, not at the last advance of the board
            board.advance(pacer.target(clock_ns(), board.time_ns))
            waiting = waiting[board.serial_in(waiting) :]


def slip_reporter(level: Level, clock_ns: Callable[[], int] = time.monotonic_ns) -> Callable[[Pacer], None]:
    """Warning about slips, with the mean speed since the previous one, at most every `REPORT_INTERVAL_S`.

    Parameters
    ----------
    level : {"registers", "ideal"}
        Level of the board, for the text.
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
        text = (
            f"the machine is too slow for a board at level {level}: it lost {pacer.slipped_s - slipped_s:.3f} s"
            f" in the last {passed_s:.1f} s; {_slips(pacer)}"
        )
        complain(f"virtual_board: warning: {text}")
        notify(text)
        last_ns, slipped_s = clock_ns(), pacer.slipped_s

    return report


def _slips(pacer: Pacer) -> str:
    return f"time slipped {pacer.slips} times, {pacer.slipped_s:.3f} s in total"


def _parser() -> argparse.ArgumentParser:
    parser = argument.Parser(
        prog="virtual_board",
        description="Simulated servo board: the firmware, two motors and a DC bus at a serial port (a "
        "pseudo-terminal), in real time. Stop it with Ctrl-C.",
        epilog="Exit status: 0 stopped by SIGINT, SIGTERM or SIGHUP, 1 operating system error, 2 wrong options, "
        "link or plant file. Example: virtual_board --link /tmp/servo --baud 1000000. The environment variable "
        f"{VARIABLE} selects the board: {', '.join(known_boards())}; all but {DEFAULT_BOARD} need --elf or "
        "--level ideal.",
    )
    parser.add_argument(
        "--link", type=Path, help="symbolic link to the port, as a fixed name; LINK.json then says what the board is"
    )
    parser.add_argument(
        "--baud", type=argument.positive, default=115200.0, help="speed of the line in bit/s (default: %(default)g)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the sensor noise")
    parser.add_argument("--plant", type=Path, help="TOML file with changes of the packaged plant.toml")
    parser.add_argument(
        "--flash",
        type=Path,
        metavar="FILE",
        help="file for the contents of the data flash (default: lost at the end)",
    )
    parser.add_argument("--robot", metavar="MODEL", help=ROBOT_HELP)
    add_level_options(parser, "the board is")
    parser.add_argument(
        "--clock",
        action="store_true",
        help="publish the simulated time on /clock, for nodes with use_sim_time; the node /simulation has the services "
        "pause and step and the parameter speed (needs ROS)",
    )
    parser.add_argument(
        "--speed", type=argument.positive, default=1.0, help="simulated seconds per second (default: %(default)g)"
    )
    return parser


@program("virtual_board")
def main(argv: list[str] | None = None) -> int:
    """Command ``virtual_board``; returns its exit status."""
    options = _parser().parse_args(argv)
    with contextlib.ExitStack() as owned:
        try:
            flash = owned.enter_context(_flash_file(options.flash)) if options.flash else None
            robot = None if options.robot is None else load_robot(options.robot)
            board, step_ns = _simulated(options, robot, flash.image if flash else None)
            owned.enter_context(board)
            stop = owned.enter_context(deferred())
            line = owned.enter_context(Terminal(options.link))
        except (BoardError, LinkError, SimulationError, ValueError) as error:
            return _print_error(str(error), 2)
        update_flash = _flash_updater(board, flash)
        where = f"{options.link} -> {line.device}" if options.link else line.device
        what = f"{options.baud:g} baud, seed {options.seed}, level {board.level}"
        if board.elf_sha256:
            what += f", {os.environ[ELF_VARIABLE]} (SHA-256 {board.elf_sha256})"
        print(f"virtual_board: {where}, {what}; Ctrl-C stops it", flush=True)
        if options.link:
            write_virtual_board(options.link, _facts(board, robot, options, line.device))
        pacer = Pacer(time.monotonic_ns(), speed=options.speed)
        try:
            clock = owned.enter_context(_clock(pacer, step_ns, options.speed)) if options.clock else None
        except (ImportError, RuntimeError) as error:
            return _print_error(str(error), 1)

        def on_step() -> None:
            update_flash()
            if clock is not None:
                clock.serve(board.time_ns)

        serve(board, line, pacer, lambda: stop.requested, on_slip=slip_reporter(board.level), on_step=on_step)
        print(
            f"virtual_board: stopped after {board.time_ns * 1e-9:.3f} s; {_slips(pacer)}; "
            f"bytes lost: {board.stats().serial_overruns} to the board, {line.lost} to the client"
        )
    return 0


def _simulated(options: argparse.Namespace, robot: RobotModel | None, flash: bytes | None) -> tuple[Board, int]:
    """The board, and the length of a step of what it is part of [ns]."""
    use_elf(options)
    settings = {"seed": options.seed, "baud": options.baud, "level": options.level, "flash": flash}
    plant = PlantConfig.load(options.plant)
    if robot is None:
        return Board(plant, **settings), TICK_NS
    drives = robot.on_line(plant, **settings)
    return drives.boards[0], drives.step_ns


def _clock(pacer: Pacer, step_ns: int, speed: float) -> SimulationClock:
    """ROS time by this simulation."""
    from servo_twin.simulation_clock import SimulationClock  # needs ROS

    return SimulationClock(
        lambda changed: pacer.set_speed(time.monotonic_ns(), changed), lambda: pacer.step(step_ns), speed
    )


def _facts(board: Board, robot: RobotModel | None, options: argparse.Namespace, device: str) -> VirtualBoard:
    """What a recording of the board needs to repeat it."""
    return VirtualBoard(
        device=device,
        level=board.level,
        seed=options.seed,
        speed=options.speed,
        baud=options.baud,
        plant=board.plant.text(),
        flash=hashlib.sha256(board.flash_image()).hexdigest() if options.flash else "",
        build=board.build,
        robot="" if robot is None else robot.name,
        robot_sha256="" if robot is None else robot.sha256,
    )


@contextlib.contextmanager
def _flash_file(path: Path) -> Iterator[FlashFile]:
    """Flash file that no other board uses; a link stands for its file."""
    with claimed(Path(os.path.realpath(path))):
        yield FlashFile(path)


def _flash_updater(board: Board, flash: FlashFile | None) -> Callable[[], None]:
    """Function that updates the flash file after the start or end of a flash command."""
    if flash is None:
        return lambda: None
    before = board.flash_state()
    flash.update(board)

    def update() -> None:
        nonlocal before
        now = board.flash_state()
        if now != before:
            before = now
            flash.update(board)

    return update


def _print_error(message: str, status: int) -> int:
    complain(f"virtual_board: {message}")
    return status


if __name__ == "__main__":
    sys.exit(main())
