"""Trace of the chip, as by a logic analyser: counters, triggers, samples, gates and interrupts."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

CLOCK: Final = 10e-9
"""Period of the bus clock [s]."""


class Kind(IntEnum):
    """``trace_kind_t``: kind of event; the comments describe `a` and `b`."""

    CYCLE = 0  # restart of a PWM counter: 4 * module + submodule, first count
    MATCH = 1  # compare: 4 * module + submodule, number of the VAL register
    LOAD = 2  # load of buffered registers: 4 * module + submodule
    GATES = 3  # pair of gate signals: 4 * module + submodule, bit 0 upper, bit 1 lower switch
    TRIGGER = 4  # pulse: input of crossbar A
    SYNC = 5  # trigger pulse at the ADC: converter, 1 if accepted
    SAMPLE = 6  # sample and hold of a channel: sample, channel
    SCAN_END = 7  # end of scan: converter
    ENTER = 8  # start of an interrupt handler: vector, level
    LEAVE = 9  # end of an interrupt handler: vector
    WRITE = 10  # write to a register: address, value
    CAPTURE = 11  # capture of a timer: 4 * module + channel, value


class ChipTrace:
    """Events of the chip in the order of time.

    Parameters
    ----------
    entries : ndarray, shape (n,), dtype `servo_twin.board.TRACE_ENTRY`
        Sorted by time.
    """

    def __init__(self, entries: NDArray[np.void]) -> None:
        self.entries = entries

    def of(self, kind: Kind, a: int | None = None, b: int | None = None) -> NDArray[np.void]:
        """Entries of one kind, shape (entries,), optionally with these values of `a` and `b`."""
        chosen = self.entries["kind"] == int(kind)
        if a is not None:
            chosen &= self.entries["a"] == a
        if b is not None:
            chosen &= self.entries["b"] == b
        result: NDArray[np.void] = self.entries[chosen]
        return result

    def clocks(self, kind: Kind, a: int | None = None, b: int | None = None) -> NDArray[np.int64]:
        """Times of the entries `of` selects [clocks]."""
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
            ends = ends[1:]  # started before the recording
        runs = min(begins.size, ends.size)
        return np.column_stack([begins[:runs], ends[:runs]])

    def intervals(self, submodule: int, switch: int) -> NDArray[np.int64]:
        """Complete on-intervals of a switch.

        Parameters
        ----------
        submodule : int
            4 * module + submodule.
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
            ends = ends[1:]  # switched on before the recording
        runs = min(begins.size, ends.size)
        return np.column_stack([begins[:runs], ends[:runs]])
