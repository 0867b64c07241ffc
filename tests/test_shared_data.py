"""What loops, interrupts and background share is whole, whatever instant the one interrupts the other at.

The rules stand in firmware/doc/schedule.md. Requests are sent so that their bytes, and the work of the server on them,
fall on every part of a slow tick of the virtual chip, in which handlers take their time.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_bridge.freemaster.codec import encode_request
from servo_bridge.freemaster.commands import write_memory
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS
from servo_twin.board import Board
from servo_twin.simulation import enable

TICK_NS: Final = SLOW_PERIODS * PERIOD_NS
INSTANTS: Final = 333
"""Of a slow tick: 1.5 us apart, which no handler is shorter than."""


def changed(log: NDArray[np.void], axis: int, before: int) -> int:
    """Row in which the speed set-point of an axis begins to change."""
    rows = np.nonzero(log[f"axis{axis + 1}.speed_ref"] != before)[0]
    return int(rows[0]) if rows.size else -1


def test_set_points_of_both_axes_take_effect_in_one_tick_whenever_they_are_written() -> None:
    with Board(level="registers", baud=1e6, seed=2) as board:
        enable(board)
        board.write("cmd.mode", [board.catalogue.enums["control_mode_t"]["SPEED"]] * AXES)
        board.run(0.02)
        address = board.address("cmd.speed")
        speed = board.catalogue["cmd.speed"].encode_raw
        for k in range(INSTANTS):
            board.advance((board.time_ns // TICK_NS + 1) * TICK_NS + k * TICK_NS // INSTANTS)
            before = [board.read_raw(f"axis{axis + 1}.speed_ref")[0] for axis in range(AXES)]
            target = 20_000_000 if k % 2 == 0 else 0  # 5 rad/s
            request = write_memory(address, speed([target, -target]))
            assert board.serial_in(encode_request(request.command, request.payload))
            log = board.record(board.time_ns + 4 * TICK_NS)
            rows = [changed(log, axis, before[axis]) for axis in range(AXES)]
            assert rows[0] == rows[1], f"instant {k}: not in one tick"
            assert rows[0] >= 0, f"instant {k}: lost"
            assert log["applied_tick"][rows[0]] == log["tick"][rows[0]], f"instant {k}: not in the stated tick"
            assert np.unique(log["applied_count"]).size <= 2, f"instant {k}: taken twice"
            board.run(0.01)
        assert board.stats().serial_overruns == 0
        assert board.read_raw("late_loops")[0] == 0
