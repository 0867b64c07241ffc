"""What a logic analyser on the chip recorded: instants of counters, triggers, samples, gates and interrupts. Pure."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

CLOCK: Final = 10e-9
"""Clock of the bus [s]."""


class Kind(IntEnum):
    """``trace_kind_t``: what happened; the comments say what `a` and `b` are."""

    CYCLE = 0  # counter of a PWM starts anew: 4 module + submodule, first count
    MATCH = 1  # compare: 4 module + submodule, number of the VAL register
    LOAD = 2  # buffered registers become active: 4 module + submodule
    GATES = 3  # pair of gate signals: 4 module + submodule, bit 0 upper, bit 1 lower switch
    TRIGGER = 4  # pulse: input of crossbar A
    SYNC = 5  # pulse at the ADC: converter, 1 if it was obeyed
    SAMPLE = 6  # a channel is held: sample, channel
    SCAN_END = 7  # converter
    ENTER = 8  # interrupt handler begins: vector, level
    LEAVE = 9  # and ends: vector
    WRITE = 10  # register: address, value
    CAPTURE = 11  # timer: 4 module + channel, value


class Trace:
    """A recording.

    Parameters
    ----------
    entries : ndarray, shape (n,), dtype `servo_twin.board.TRACE_ENTRY`
        In order of time.
    """

    def __init__(self, entries: NDArray[np.void]) -> None:
        self.entries = entries

    def of(self, kind: Kind, a: int | None = None, b: int | None = None) -> NDArray[np.void]:
        """Entries of one kind, shape (entries,), with these marks if they are given."""
        chosen = self.entries["kind"] == int(kind)
        if a is not None:
            chosen &= self.entries["a"] == a
        if b is not None:
            chosen &= self.entries["b"] == b
        result: NDArray[np.void] = self.entries[chosen]
        return result

    def clocks(self, kind: Kind, a: int | None = None, b: int | None = None) -> NDArray[np.int64]:
        """When that happened [clocks]."""
        return np.asarray(self.of(kind, a, b)["clock"].astype(np.int64))

    def handlers(self, vector: int) -> NDArray[np.int64]:
        """Complete runs of a handler.

        Returns
        -------
        ndarray, shape (n, 2)
            First and last clock of each.
        """
        begins, ends = self.clocks(Kind.ENTER, vector), self.clocks(Kind.LEAVE, vector)
        if begins.size and ends.size and ends[0] < begins[0]:
            ends = ends[1:]  # it had begun before the recording
        runs = min(begins.size, ends.size)
        return np.column_stack([begins[:runs], ends[:runs]])

    def intervals(self, submodule: int, switch: int) -> NDArray[np.int64]:
        """Complete intervals in which a switch was on.

        Parameters
        ----------
        submodule : int
            4 module + submodule.
        switch : int
            0 upper, 1 lower.

        Returns
        -------
        ndarray, shape (n, 2)
            First and last clock of each.
        """
        gates = self.of(Kind.GATES, submodule)
        on = (gates["b"] >> switch & 1).astype(np.int8)
        clocks = gates["clock"].astype(np.int64)
        if on.size == 0:
            return np.empty((0, 2), np.int64)
        change = np.diff(on)
        begins, ends = clocks[1:][change == 1], clocks[1:][change == -1]
        if on[0] == 1:
            ends = ends[1:]  # on since before the recording
        runs = min(begins.size, ends.size)
        return np.column_stack([begins[:runs], ends[:runs]])
