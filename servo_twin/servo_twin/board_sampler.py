"""Continuous sampling by a recorder of a virtual board into a ring buffer of this process."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_twin.board_memory import BoardError, status_text


class BoardSampler:
    """Samples several addresses in every call of a loop, at the same point as the recorder of the firmware.

    Takes the computing time of the recorder; nothing is copied before `points` is called.

    Parameters
    ----------
    ffi, lib : cffi library
        Library with the interface of ``board.h``.
    board : cffi pointer
        The board; must exist until `close`.
    recorder : int
        0: every PWM period; 1: every slow tick.
    addresses : sequence of int
        Addresses of the sampled numbers, at most 8.
    layout : dtype
        Layout of a point: one field per number, in the same order, without gaps.
    capacity : int
        Capacity [points]; the newest points are kept.

    Raises
    ------
    BoardError
        If the board refuses the addresses.
    """

    def __init__(
        self,
        ffi: Any,
        lib: Any,
        board: Any,
        recorder: int,
        addresses: Sequence[int],
        layout: np.dtype[np.void],
        capacity: int,
    ) -> None:
        self._ffi, self._lib, self._board = ffi, lib, board
        self._memory = np.zeros(-(-capacity * layout.itemsize // 4), np.uint32)  # whole words
        self._points: NDArray[np.void] = self._memory.view(np.uint8)[: capacity * layout.itemsize].view(layout)
        sizes = [layout[k].itemsize for k in range(len(addresses))]
        cells = ffi.new("board_cell_t[]", list(zip(addresses, sizes, strict=True)))
        self._buffer = ffi.from_buffer("uint32_t[]", self._memory, require_writable=True)
        status = lib.board_sample(board, recorder, cells, len(addresses), self._buffer, capacity)
        if status != 0:
            raise BoardError(f"sampling {len(addresses)} numbers: {status_text(status)}", status)

    def points(self) -> NDArray[np.void]:
        """The last raw points (points,), oldest first."""
        following = self._ffi.new("uint32_t *")
        count = self._lib.board_sampled(self._board, following)
        first = following[0] if count == len(self._points) else 0
        return np.concatenate([self._points[first:count], self._points[:first]])

    def close(self) -> None:
        """End the sampling; the recorder uses its own memory again."""
        self._lib.board_sample_end(self._board)
