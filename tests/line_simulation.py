"""Test fixture: a virtual board and clients on its serial line, in simulated time."""

from __future__ import annotations

import bisect
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.errors import AnswerTimeoutError, DamagedAnswerError
from servo_bridge.freemaster.line import Line
from servo_msgs_py.board_port import active, place
from servo_msgs_py.catalogue import AXES
from servo_twin.board import Board
from servo_twin.level import Level

BAUDS: Final = (19_200, 115_200, 1_000_000)
STEP_NS: Final = 2_000_000
"""Period of the log of both shafts [ns]."""

ClientAction = Callable[[], object]
"""One action of a client, called periodically."""


@dataclass
class Log:
    """True motion of both shafts, one entry per 2 ms."""

    time: list[float] = field(default_factory=list)  # simulated time [s]
    theta: list[tuple[float, ...]] = field(default_factory=list)  # angles, shape (entries, axes) [rad]
    omega: list[tuple[float, ...]] = field(default_factory=list)  # speeds, shape (entries, axes) [rad/s]


class SimulatedLine:
    """Transport of a FreeMASTER client that advances simulated time while it waits."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.plugged = True  # bytes pass in both directions
        self.log = Log()

    def clock(self) -> int:
        return self.board.time_ns

    def advance(self, until_ns: int) -> None:
        """Advance simulated time and log the shafts."""
        now = self.board.time_ns
        while now < until_ns:
            step_end = (now // STEP_NS + 1) * STEP_NS
            now = min(until_ns, step_end)
            self.board.advance(now)
            if now == step_end:
                truths = [self.board.truth(axis) for axis in range(AXES)]
                self.log.time.append(now * 1e-9)
                self.log.theta.append(tuple(t.theta_m for t in truths))
                self.log.omega.append(tuple(t.omega_m for t in truths))

    def write(self, data: bytes) -> None:
        while data and self.plugged:
            data = data[self.board.serial_in(data) :]
            if data:
                self.advance(self.board.time_ns + STEP_NS)

    def read(self, deadline: int) -> bytes:
        while True:
            data = self.board.serial_out()
            if data and self.plugged:
                return data
            now = self.board.time_ns
            if now >= deadline:
                return b""
            following = self.board.serial_next_ns()
            self.advance(min(deadline, now + STEP_NS if following is None else max(following, now + 1)))


class Host:
    """One client of the board."""

    def __init__(self, line: SimulatedLine, baud: int) -> None:
        self._line = line
        self.client = Client(Line(line, baud=baud, clock=line.clock, latency=0.02, retries=0))
        self.client.mtu = 254

    def write(self, name: str, *values: float, first: int = 0) -> None:
        """Write consecutive elements of a variable, in SI units."""
        variable = self._line.board.catalogue[name]
        data = variable.pack(map(variable.to_raw, values))
        self.client.write_memory(self._line.board.address(name) + first * variable.element_size, data)

    def write_raw(self, name: str, *raw: int, first: int = 0) -> None:
        """Write consecutive elements of a variable, as raw integers."""
        variable = self._line.board.catalogue[name]
        data = variable.pack(raw)
        self.client.write_memory(self._line.board.address(name) + first * variable.element_size, data)

    def command(self, name: str) -> None:
        """Run an application command."""
        self.client.run_command(self._line.board.catalogue.bits["command"][name])

    def keep_alive(self) -> None:
        self.command("KEEP_ALIVE")

    def read_snapshot(self) -> None:
        """Read the snapshot, as a client that only reads."""
        self.client.read_memory(self._line.board.address("snapshot"), 40)


class LineSimulation:
    """A board with both axes and its clients in simulated time.

    Parameters
    ----------
    level : {"ideal", "registers"}
        Level of the board.
    baud : int
        Line speed [bit/s].
    reader : bool
        True: a second client reads continuously.
    """

    def __init__(self, level: Level, baud: int, *, reader: bool = False, seed: int = 7) -> None:
        self._level: Level = level
        self._baud, self._seed = float(baud), seed
        self.board = self._new_board()
        self.line = SimulatedLine(self.board)
        self.host = Host(self.line, baud)
        self._readers: list[ClientAction] = [Host(self.line, baud).read_snapshot] if reader else []

    def _new_board(self) -> Board:
        return Board(level=self._level, baud=self._baud, seed=self._seed)

    def close(self) -> None:
        self.board.close()

    def restart(self) -> None:
        """Switch the board off and on, with an empty log of the shafts."""
        self.board.close()
        self.board = self.line.board = self._new_board()
        self.line.log = Log()

    # ---- time
    @property
    def now(self) -> float:
        """Simulated time [s]."""
        return self.board.time_ns * 1e-9

    def run(self, seconds: float, *actions: ClientAction, period: float = 0.05) -> None:
        """Run for a time [s]; do all actions in turn once per period, or as fast as the line permits."""
        end = self.board.time_ns + round(seconds * 1e9)
        while self.board.time_ns < end:
            due = self.board.time_ns + round(period * 1e9)
            for action in (*actions, *self._readers):
                with contextlib.suppress(AnswerTimeoutError, DamagedAnswerError):
                    action()
            self.line.advance(min(due, end))

    def until(self, condition: Callable[[], bool], within: float, *actions: ClientAction) -> None:
        """Run until a condition holds; fail after `within` [s]."""
        end = self.now + within
        while not condition():
            assert self.now < end, f"not within {within} s: {self.states()}"
            self.run(0.05, *actions)

    # ---- the board
    def states(self) -> list[str]:
        """State of every axis: ``SPIN``, ``STOP``, ``FAULT HOST_SILENT`` ..."""
        return [" ".join([place(self.board, axis), *sorted(active(self.board, axis))]) for axis in range(AXES)]

    def enable(self) -> None:
        """Enable both axes over the line and wait until they hold their positions."""
        self.until(lambda: self.states() == ["STOP"] * AXES, 1.0)
        self.host.write("cmd.enable", 1, 1)
        self.until(lambda: self.states() == ["SPIN"] * AXES, 6.0, self.host.keep_alive)
        self.run(0.1, self.host.keep_alive)

    def reach_speed(self, speed: float, mode: str = "SPEED", within: float = 1.0) -> ClientAction:
        """Run both shafts up to a speed [rad/s]; return the action that renews the set-point."""
        modes = self.board.catalogue.enums["control_mode_t"]
        self.host.write("cmd.mode", *[modes[mode]] * AXES)
        write_speed = self.speed_writer(speed)
        self.until(lambda: all(abs(w - speed) < 0.1 * abs(speed) for w in self.line.log.omega[-1]), within, write_speed)
        return write_speed

    def speed_writer(self, speed: float) -> ClientAction:
        """Action that writes a speed set-point of both shafts [rad/s]."""
        return lambda: self.host.write("cmd.speed", *[speed] * AXES)

    # ---- the shafts
    def since(self, start: float, values: Sequence[tuple[float, ...]]) -> tuple[NDArray[np.float64], ...]:
        """Times after `start` [s] and the values of both axes, shape (entries, axes)."""
        first = bisect.bisect_left(self.line.log.time, start)
        return np.asarray(self.line.log.time[first:]) - start, np.asarray(values[first:])

    def speed_max(self, start: float, end: float = np.inf) -> float:
        """Largest speed of either shaft between two times [rad/s]."""
        time, omega = self.since(start, self.line.log.omega)
        return float(np.abs(omega[time <= end - start]).max())

    def travel(self, start: float) -> float:
        """Largest distance of either shaft from its position at `start` [rad]."""
        _, theta = self.since(start, self.line.log.theta)
        return float(np.abs(theta - theta[0]).max())

    def stop_time(self, start: float, speed: float = 2.0) -> float:
        """Time after `start` when both shafts remain slower than `speed` [s]; infinite if one does not."""
        time, omega = self.since(start, self.line.log.omega)
        fast = np.nonzero(np.abs(omega).max(axis=1) > speed)[0]
        if fast.size == 0:
            return 0.0
        return float(time[fast[-1] + 1]) if fast[-1] + 1 < time.size else np.inf
