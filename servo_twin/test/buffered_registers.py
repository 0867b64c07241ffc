"""Writes to buffered registers of the PWM by the debug interface."""

from __future__ import annotations

from servo_twin.board import Board

CLOCK_NS = 10
TRIES = 200


def poke_buffered(board: Board, address: int, value: int) -> None:
    """Change a buffered register, which is locked while a load is pending; retry until it succeeds."""
    word = value & 0xFFFF
    for _ in range(TRIES):
        board.poke(address, word)
        if board.peek(address) == word:
            return
        board.advance(board.time_ns + 100 * CLOCK_NS)
    raise AssertionError(f"register {address:#06x} stays locked")
