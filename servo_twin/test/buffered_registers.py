"""Writes to buffered registers of the PWM, as with a debugger."""

from __future__ import annotations

from servo_twin.board import Board

CLOCK_NS = 10
TRIES = 200


def poke_buffered(board: Board, address: int, value: int) -> None:
    """Change a buffered register; while a load is pending it is locked."""
    wanted = value & 0xFFFF
    for _ in range(TRIES):
        board.poke(address, wanted)
        if board.peek(address) == wanted:
            return
        board.advance(board.time_ns + 100 * CLOCK_NS)
    raise AssertionError(f"register {address:#06x} stays locked")
