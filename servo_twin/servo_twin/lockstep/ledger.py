"""Which commands took effect on the board, and whether all of them are known. Pure.

A sample says how many command writes have taken effect so far and when the last one did. The writes themselves come on
another topic, so one may be late or lost. A sample may be replayed only when every write that it counts is known.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from typing import Final

from servo_msgs_py.convert import AppliedCommand

_COUNT_WRAP: Final = 0xFFFF
_TICK_WRAP: Final = 0xFFFF_FFFF


class CommandLedger:
    """Commands that wait for their sample, in the order of their ticks."""

    def __init__(self) -> None:
        self._waiting: list[AppliedCommand] = []
        self._tick = 0
        self._count = 0

    def add(self, command: AppliedCommand) -> bool:
        """Note a command; returns False for one that is known or that the last settled sample already contained."""
        if command.tick <= self._tick or command in self._waiting:
            return False
        insort(self._waiting, command, key=_tick)
        return True

    def settle(self, tick: int, count: int) -> None:
        """Count from a sample on: everything that took effect up to it is dealt with.

        Parameters
        ----------
        tick : int
            Tick of the sample, extended past 32 bits.
        count : int
            Its `applied_count`.
        """
        del self._waiting[: bisect_right(self._waiting, tick, key=_tick)]
        self._tick, self._count = tick, count

    def forget(self) -> None:
        """Begin anew with a board that has just been reset."""
        self._waiting.clear()
        self._tick = self._count = 0

    @property
    def from_reset(self) -> bool:
        """Whether everything since the reset of the board is still counted."""
        return self._tick == 0 and self._count == 0

    def missing(self, tick: int, applied_tick: int, applied_count: int) -> int:
        """How many writes that a sample counts are not known.

        Parameters
        ----------
        tick : int
            Tick of the sample, extended past 32 bits.
        applied_tick, applied_count : int
            uint32 and uint16, as the board sent them.
        """
        last = tick - ((tick - applied_tick) & _TICK_WRAP)
        # Writes that a slow tick latches together count once.
        known = len({command.tick for command in self.until(last)})
        return max(((applied_count - self._count) & _COUNT_WRAP) - known, 0)

    def until(self, tick: int) -> list[AppliedCommand]:
        """Waiting commands that took effect not later than `tick`, in order."""
        return self._waiting[: bisect_right(self._waiting, tick, key=_tick)]


def _tick(command: AppliedCommand) -> int:
    return command.tick
