"""A board is a function of its inputs: splitting a run into calls and reading between them have no effect."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import astuple
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES
from servo_twin.board import Board
from servo_twin.fault_injection import (
    CurrentNoise,
    EncoderGlitches,
    InjectedFault,
    OpenPhase,
    SlippedEncoder,
    StalledCore,
    StuckLine,
    SupplyDip,
)

pytestmark = pytest.mark.usefixtures("level")

MS = 1_000_000
END = 1_000 * MS
TAIL = 20 * MS  # recorded at the end of both runs
GET_TABLE = bytes.fromhex("2B 29 01 00 6C")  # FreeMASTER v4 GETTSAINFO of table 0

Input = tuple[int, Callable[[Board], object]]
"""A time [ns] and the input of the board at that time."""


def sends(variable: str, *values: float) -> Callable[[Board], object]:
    return lambda board: board.write(variable, list(values))


def breaks(fault: InjectedFault) -> Callable[[Board], object]:
    return lambda board: board.inject(fault)


# Both axes are under control after 540 ms.
BEGIN: Final[list[Input]] = [
    (20 * MS, lambda board: board.write("param.command_timeout", 0.0)),
    (30 * MS, sends("cmd.enable", 1, 1)),
]
MOVE: Final[list[Input]] = [*BEGIN, (570 * MS, sends("cmd.position", 12.0, -7.0))]
SENSORLESS: Final[list[Input]] = [
    (10 * MS, sends("param.feedback", 1, 1)),
    *BEGIN,
    (40 * MS, sends("cmd.mode", 1, 1)),
    (50 * MS, sends("cmd.speed", 120.0, -160.0)),
]
RUNS: Final[dict[str, list[Input]]] = {
    "move": MOVE,
    "loads": [
        *MOVE,
        (591_234_567, lambda board: board.set_load(0, 0.05)),
        (620 * MS, lambda board: board.lock_shaft(1)),
        (650 * MS, lambda board: board.lock_shaft(1, False)),
        (700 * MS, lambda board: board.obstruct_shaft(0, 2.0, 3.0)),
        (800 * MS, lambda board: board.set_supply(21.0)),
    ],
    "host": [*MOVE, *((t * MS, lambda board: board.serial_in(3 * GET_TABLE)) for t in range(100, 900, 7))],
    "sensorless": SENSORLESS,
    "sensorless, loads": [*SENSORLESS, (600 * MS, lambda board: board.set_load(0, 0.04))],
    "open phase": [*MOVE, (610 * MS, breaks(OpenPhase(0, "b")))],
    "bad encoder": [
        *MOVE,
        (650 * MS, breaks(EncoderGlitches(1, "A", 500.0))),
        (660 * MS, breaks(SlippedEncoder(0, 90))),
        (680 * MS, breaks(StuckLine(1, "B"))),
    ],
    "reset by the watchdog": [*MOVE, (700 * MS, breaks(StalledCore(0.1))), (900 * MS, sends("cmd.enable", 1, 1))],
    "noise and a dip": [*MOVE, (600 * MS, breaks(CurrentNoise(0, 0.05))), (650 * MS, breaks(SupplyDip(12.0, 0.05)))],
}


def state(board: Board) -> list[Any]:
    """All readable values of a board."""
    values = [board.read_words(name) for name in board.catalogue.variables]
    return [board.time_ns, values, [board.truth(axis) for axis in range(AXES)], astuple(board.stats())]


class Recorder:
    """Runs a board; records the bytes that it sends and its telemetry."""

    def __init__(self, board: Board, seed: int | None) -> None:
        self.board = board
        self.sent = b""
        self.logs: list[NDArray[np.void]] = []
        self._random = None if seed is None else random.Random(seed)

    def run_to(self, until_ns: int) -> None:
        if self._random is None:
            self._record(until_ns)
            return
        while self.board.time_ns < until_ns:
            length = int(10 ** self._random.uniform(2.0, 7.3))  # 100 ns .. 20 ms
            self._random.choice([self._advance, self._record, self._trace, self._read_all])(
                min(until_ns, self.board.time_ns + length)
            )

    def _advance(self, until_ns: int) -> None:
        self.board.advance(until_ns)

    def _record(self, until_ns: int) -> None:
        self.logs.append(self.board.record(until_ns))

    def _trace(self, until_ns: int) -> None:
        self.board.trace(until_ns, 100)

    def _read_all(self, until_ns: int) -> None:
        self.board.advance(until_ns)
        self.sent += self.board.serial_out()
        self.board.serial_next_ns()
        state(self.board)

    def rows(self) -> dict[tuple[int, int], bytes]:
        """Recorded telemetry; key: number of resets, tick since the last reset."""
        rows, resets, last = {}, 0, 0
        for row in np.concatenate(self.logs):
            tick = int(row["tick"])
            resets += tick < last
            last = tick
            rows[resets, tick] = row.tobytes()
        return rows


def play(inputs: list[Input], seed: int | None) -> Recorder:
    """One run, in one call between two inputs or split at random."""
    run = Recorder(Board(seed=6), seed)
    for time_ns, act in sorted(inputs, key=lambda one: one[0]):
        run.run_to(time_ns)
        act(run.board)
    run.run_to(END)
    run.logs.append(run.board.record(END + TAIL))
    run.sent += run.board.serial_out()
    return run


@pytest.mark.parametrize("name", RUNS)
def test_a_run_does_not_depend_on_the_calls_that_it_is_split_into(name: str) -> None:
    whole = play(RUNS[name], None)
    moved = [np.ptp(np.concatenate(whole.logs)[f"axis{n}.position"]) for n in (1, 2)]
    assert min(moved) > 1000
    expected = whole.rows()
    for seed in (1, 2):
        pieces = play(RUNS[name], seed)
        rows = pieces.rows()
        assert len(rows) > 200
        differ = [tick for tick, row in rows.items() if row != expected[tick]]
        assert not differ, f"from tick {min(differ)} on"
        assert pieces.sent == whole.sent
        assert state(pieces.board) == state(whole.board)


def test_a_trace_does_not_depend_on_the_calls_that_it_is_split_into() -> None:
    ends = [*range(0, 40 * MS, 123_456), 40 * MS]
    whole, pieces = Board(seed=4), Board(seed=4)
    traces = [pieces.trace(end) for end in ends]
    expected = whole.trace(ends[-1])
    assert np.concatenate(traces).tobytes() == expected.tobytes()
    assert state(pieces) == state(whole)
