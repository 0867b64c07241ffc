"""Size of the state of a virtual board, and the time to save and to restore it: ``make bench-state``."""

from __future__ import annotations

import timeit
from typing import Final, get_args

from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.simulation import enable

ROUNDS: Final = 5  # the best counts, as other load disturbs
CALLS: Final = 1000


def measured(level: Level) -> str:
    """Line of the table."""
    board = Board(level=level)
    enable(board)
    state = board.state()
    lib, ffi, handle = board._lib, board._ffi, board._board
    image, size = ffi.new("uint8_t[]", state.image), ffi.new("size_t *")
    room = len(state.image)
    calls = (
        lambda: lib.board_save(handle, image, room, size),
        lambda: lib.board_restore(handle, image, room),
        board.state,
        lambda: board.restore(state),
    )
    best = [min(timeit.repeat(call, number=CALLS, repeat=ROUNDS)) / CALLS * 1e6 for call in calls]
    return f"{level:<9}  {room:12d}  {best[0]:9.1f}  {best[1]:12.1f}  {best[2]:16.1f}  {best[3]:18.1f}"


def main() -> None:
    """Print the table."""
    print("level      image [byte]  save [us]  restore [us]  Board.state [us]  Board.restore [us]")
    for level in get_args(Level):
        print(measured(level))


if __name__ == "__main__":
    main()
