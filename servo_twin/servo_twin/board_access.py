"""`servo_measurement.access.BoardAccess` to a virtual board, in simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from servo_measurement.access import (
    RECORDER_BYTES,
    TRIGGER_TIMEOUT,
    BoardAccess,
    Capture,
    MeasurementError,
    element_of,
)
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.trace import Trace

from servo_twin.board import Board, BoardError

_FAST, _SLOW = 0, 1  # recorders
_TRIGGER_POLL: Final = 0.002  # polling interval of the trigger [s]
_START_TIME: Final = 5.0  # longest time of the function that starts the motion [s]
_CALLBACK_INTERVAL: Final = 0.05  # interval of `meanwhile`, as on a serial line [s]


class VirtualBoardAccess(BoardAccess):
    """Access to a board in this process, without a host timeout.

    Parameters
    ----------
    board : Board
        The board; only `wait` and `record` advance its time.
    """

    def __init__(self, board: Board) -> None:
        self.board = board

    @property
    def catalogue(self) -> Catalogue:
        """Variables of the board."""
        return self.board.catalogue

    def read_words(self, name: str) -> list[int]:
        return self.board.read_words(name)

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        try:
            return self.board.write_words(name, words, first)
        except BoardError as error:
            raise MeasurementError(str(error)) from None

    def clock(self) -> float:
        """Simulated time [s]."""
        return self.board.clock()

    def wait(self, seconds: float) -> None:
        """Advance the simulated time [s]."""
        self.board.run(seconds)

    def capacity(self, names: Sequence[str]) -> int:
        """Capacity of a real recorder, for identical measurements; `record` does not have this limit."""
        return RECORDER_BYTES // sum(element_of(self.catalogue, name)[0].element_size for name in names)

    def record(self, capture: Capture) -> Trace:
        """Record in simulated time; see `BoardAccess.record`."""
        names, trigger = capture.names, capture.trigger
        needed = capture.samples * capture.every
        elements = [element_of(self.catalogue, name) for name in names]
        sampled = list(elements)
        if trigger is not None and trigger not in names:
            sampled.append(element_of(self.catalogue, trigger))
        loop = capture.step / capture.every
        wait = 0.0 if trigger is None else _START_TIME + TRIGGER_TIMEOUT
        capacity = needed + round((wait + _TRIGGER_POLL) / loop) + 1
        try:
            self.board.sample(_SLOW if capture.slow else _FAST, sampled, capacity)
        except BoardError as error:
            raise MeasurementError(str(error)) from None
        try:
            capture.start()
            if trigger is not None and len(self.board.sampled()) + needed > capacity:
                raise MeasurementError(f"starting the motion took longer than {_START_TIME:g} s")
            first = (
                0
                if trigger is None
                else self._first_triggered(names.index(trigger) if trigger in names else len(elements))
            )
            while (missing := first + needed - len(self.board.sampled())) > 0:
                self.board.run(min(missing * loop, _CALLBACK_INTERVAL))
                capture.meanwhile(False)
            points = self.board.sampled()[first : first + needed : capture.every]
        finally:
            self.board.end_sampling()
        capture.meanwhile(True)
        fields = points.dtype.names or ()
        columns = {
            name: points[field].astype(np.float64) * variable.lsb
            for name, field, (variable, _) in zip(names, fields, elements, strict=False)
        }
        return Trace(capture.step, columns)

    def _first_triggered(self, column: int) -> int:
        """Run until the variable of a column is above zero; returns the index of this sample."""
        begin = self.board.time_ns
        while (self.board.time_ns - begin) * 1e-9 < TRIGGER_TIMEOUT:
            self.board.run(_TRIGGER_POLL)
            points = self.board.sampled()
            above = points[(points.dtype.names or ())[column]] > 0
            if above.any():
                return int(np.argmax(above))
        raise MeasurementError(f"no trigger within {TRIGGER_TIMEOUT:g} s")
