"""Data that loops, interrupts and background share are consistent at every instant of an interrupt.

See firmware/doc/schedule.md. Requests are sent so that their bytes, and their processing by the server, are at every
part of a slow tick of the virtual chip, where handlers take time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_bridge.freemaster.commands import Request, ScopeSlot, read_memory, read_scope, set_scope, write_memory
from servo_bridge.freemaster.frames import V4, AnswerParser
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.units import TICK_NS
from servo_twin.board import Board
from servo_twin.simulation import enable

BAUDS: Final = (300_000, 2_000_000)
"""A rate at which the background also reads bytes, and the highest rate: the FIFO is full after 20 us."""
SPEED: Final = 20_000_000  # raw number of 5 rad/s
SLOTS: Final = ("tick", "axis1.position", "axis1.i_q", "axis1.u_q", "axis2.position", "axis2.i_q", "axis2.u_q", "tick")
"""Slots of the scope: values that change at each slow tick, and the tick before and after them."""


@pytest.fixture(params=BAUDS)
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """A board with both axes in speed mode."""
    with Board(level="registers", baud=request.param, seed=2) as board:
        enable(board)
        board.write("cmd.mode", [board.catalogue.enums["control_mode_t"]["SPEED"]] * AXES)
        board.run(0.02)
        yield board
        assert board.stats().serial_overruns == 0
        assert board.read_words("late_loops")[0] == 0


def instants(board: Board, count: int) -> Iterator[int]:
    """Run the board to one instant of each of the next slow ticks, at uniform offsets."""
    for k in range(count):
        board.advance((board.time_ns // TICK_NS + 1) * TICK_NS + k * TICK_NS // count)
        yield k


def send(board: Board, request: Request) -> None:
    assert board.serial_in(V4.encode(request.command, request.payload))


def changed(log: NDArray[np.void], axis: int, before: int) -> int:
    """Row of the first change of the speed set-point of an axis."""
    rows = np.nonzero(log[f"axis{axis + 1}.speed_ref"] != before)[0]
    return int(rows[0]) if rows.size else -1


@pytest.mark.parametrize(
    ("waiting", "count"),
    [
        (False, 333),  # 1.5 us apart, shorter than every handler
        (True, 1250),  # 0.4 us apart: two bytes of a copy
    ],
)
def test_set_points_of_both_axes_take_effect_in_the_same_tick(board: Board, waiting: bool, count: int) -> None:
    """A pending earlier write does not apply a part of the later one."""
    address = board.address("cmd.speed")
    speed = board.catalogue["cmd.speed"].encode_raw
    for k in instants(board, count):
        before = [board.read_words(f"axis{axis + 1}.speed_ref")[0] for axis in range(AXES)]
        target = SPEED if k % 2 == 0 else 0
        if waiting:
            board.write_raw("cmd.speed", before)
        send(board, write_memory(address, speed([target, -target])))
        log = board.record(board.time_ns + 4 * TICK_NS)
        rows = [changed(log, axis, before[axis]) for axis in range(AXES)]
        assert rows[0] == rows[1], f"instant {k}: not in one tick"
        assert rows[0] >= 0, f"instant {k}: lost"
        for sign, axis in ((1, "axis1"), (-1, "axis2")):
            on_the_way = sign * log[f"{axis}.speed_ref"]
            assert 0 <= on_the_way.min() <= on_the_way.max() <= SPEED, f"instant {k}: neither the old nor the new one"
        assert log["applied_tick"][rows[0]] == log["tick"][rows[0]], f"instant {k}: not in the stated tick"
        assert np.unique(log["applied_count"]).size <= 2 + waiting, f"instant {k}: applied twice"
        board.run(0.01)


def test_scope_values_are_of_the_same_tick(board: Board) -> None:
    """The server copies slot by slot, and can be interrupted by loops of the next tick."""
    board.write_raw("cmd.speed", [SPEED, -SPEED])
    board.run(0.1)
    variables = [board.catalogue[name] for name in SLOTS]
    for request in set_scope([ScopeSlot(board.address(v.name), v.size) for v in variables]):
        send(board, request)
        board.run(0.005)
    size = sum(variable.size for variable in variables)
    board.serial_out()
    for k in instants(board, 333):
        earlier = board.record(board.time_ns + TICK_NS)
        send(board, read_scope(size))
        log = np.concatenate([earlier, board.record(board.time_ns + 4 * TICK_NS)])
        answer = AnswerParser(size).feed(board.serial_out())
        assert answer is not None
        assert not answer.is_error
        ends = np.cumsum([variable.size for variable in variables])
        read = [v.decode_raw(answer.data[end - v.size : end])[0] for v, end in zip(variables, ends, strict=True)]
        row = log[log["tick"] == read[0]]
        assert row.size == 1, f"instant {k}: of no tick"
        assert read == [int(row[name][0]) for name in SLOTS], f"instant {k}: not of one tick"


def test_reading_host_does_not_disturb_the_control() -> None:
    """Inputs and outputs of the loops are bit-identical with requests at any instant."""
    logs = []
    for reads in (False, True):
        with Board(level="registers", seed=6) as board:
            request = read_memory(board.address("snapshot"), 120)
            steps = np.random.default_rng(1).integers(9_000_000, 11_000_000, 180)
            log = []
            for k, step in enumerate(steps):
                if k == 2:
                    board.write("cmd.enable", [1] * AXES)
                elif k == 90:
                    board.write("cmd.position", [12.0, -18.0])
                if reads:
                    send(board, request)
                    board.serial_out()
                log.append(board.record(board.time_ns + int(step)))
            logs.append(np.concatenate(log))
    silent, read = logs
    assert np.ptp(silent["axis1.position"]) > 1000
    assert silent.tobytes() == read.tobytes()
