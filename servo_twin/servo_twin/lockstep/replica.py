"""A virtual board that is controlled by ticks: run to a tick, write with effect at a tick.

The firmware latches writes at the start of a slow tick and takes its snapshot at the end of the same tick. A write
between two slow ticks therefore takes effect with the later one, on the real and on the virtual board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from itertools import chain
from operator import itemgetter
from typing import Final

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.convert import state_label
from servo_msgs_py.units import PERIOD, PERIOD_NS, SLOW_PERIODS, TICK

from servo_twin.board import Board
from servo_twin.lockstep.samples import expired_mask

_WRAP: Final = 1 << 32


POLL: Final = 16 * TICK
"""Period of the test of a condition [s]."""


def slow_tick(tick: int) -> int:
    """Last slow tick up to `tick`."""
    return tick - tick % SLOW_PERIODS


class Replica:
    """One board that is advanced in steps of slow ticks.

    Parameters
    ----------
    board : Board
        A board after power-on.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self.catalogue = board.catalogue
        self._expired = expired_mask(board.catalogue)
        self._label = cache(partial(state_label, board.catalogue))
        self._states = [(f"{prefix}.state", f"{prefix}.substate") for prefix in map(axis_name, range(AXES))]
        self._limits = [f"{axis_name(axis)}.limits" for axis in range(AXES)]
        self._positions = [f"{axis_name(axis)}.position" for axis in range(AXES)]
        self._all_states = itemgetter(*self._limits, *chain.from_iterable(self._states))
        self.tick = 0  # last completed slow tick [PWM periods since reset]
        self.raw: Mapping[str, int] = {}  # raw snapshot of `tick`, by variable name; empty before the first

    def close(self) -> None:
        """Free the board."""
        self.board.close()

    def run_to(self, tick: int) -> None:
        """Run until the end of slow tick `tick`; no effect if it is in the past.

        Raises
        ------
        ValueError
            If `tick` is not a slow tick.
        """
        if tick % SLOW_PERIODS:
            raise ValueError(f"tick {tick} is not a multiple of {SLOW_PERIODS}")
        if tick <= self.tick:
            return
        log = self.board.record((tick + 1) * PERIOD_NS)  # the handler of the slow tick may last into the next period
        self.tick = tick
        self.raw = dict(zip(log.dtype.names or (), log[-1].tolist(), strict=True))
        assert self.raw["tick"] == tick % _WRAP

    def write(self, variable: str, raw: Sequence[int], mask: int) -> None:
        """Write the masked axes of a command variable; effective with the next slow tick.

        Parameters
        ----------
        variable : str
            Name of an array with one element per axis.
        raw : sequence of int
            Firmware integers, one per axis.
        mask : int
            Bit per axis; bit 0 is axis 1. Other axes are not written, because a write restarts the command timeout.
        """
        size = self.catalogue[variable].element_size
        data = self.catalogue[variable].encode_raw(raw)
        address = self.board.address(variable)
        for axis in range(AXES):
            if mask >> axis & 1:
                self.board.write_memory(address + axis * size, data[axis * size : (axis + 1) * size])

    def write_first(self, variable: str, raw: Sequence[int]) -> None:
        """Write the first elements of a variable in one access."""
        self.board.write_memory(self.board.address(variable), self.catalogue[variable].pack(raw))

    def read_words(self, name: str) -> list[int]:
        """Firmware integers of any variable, one per element."""
        return self.board.read_words(name)

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        """Write elements of a variable in one access; False if the board refuses a value as out of range."""
        return self.board.write_words(name, words, first)

    def clock(self) -> float:
        """Time of the last completed slow tick [s]."""
        return self.tick * PERIOD

    def wait(self, seconds: float) -> None:
        """Run at least for `seconds` [s], to the end of a slow tick."""
        self.run_to(slow_tick(self.tick - (-round(seconds * 1e9) // PERIOD_NS) + SLOW_PERIODS - 1))

    def label(self, axis: int) -> str:
        """State of an axis, such as ``STOP`` or ``RUN/SPIN``."""
        if not self.raw:
            return "INIT"
        state, substate = self._states[axis]
        return self._label(self.raw[state], self.raw[substate])

    def states(self) -> tuple[int, ...]:
        """Raw states and limits of all axes."""
        found: tuple[int, ...] = self._all_states(self.raw)
        return found

    def position(self) -> tuple[int, ...]:
        """Positions of all axes [counts]."""
        return tuple([self.raw[name] for name in self._positions])

    def expired(self, axis: int) -> bool:
        """True if an axis has stopped after the timeout of its set-point."""
        return bool(self.raw.get(self._limits[axis], 0) & self._expired)
