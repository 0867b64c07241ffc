"""Command writes that took effect on the board, and detection of missing ones.

A sample contains the number of command writes that have taken effect and the tick of the last one. The writes
themselves are reported on another topic and may be late or lost. A sample is replayed only when all counted writes have
been reported.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from typing import Final

from servo_msgs_py.convert import AppliedCommand

_COUNT_WRAP: Final = 0xFFFF
_TICK_WRAP: Final = 0xFFFF_FFFF


class AppliedCommands:
    """Queue of commands that wait for their sample, sorted by tick."""

    def __init__(self) -> None:
        self._waiting: list[AppliedCommand] = []
        self._tick = 0
        self._count = 0

    def add(self, command: AppliedCommand) -> bool:
        """Add a command; False if it is already in the queue or not after the last settled sample."""
        if command.tick <= self._tick or command in self._waiting:
            return False
        insort(self._waiting, command, key=_tick)
        return True

    def settle(self, tick: int, count: int) -> None:
        """Remove the commands up to a sample and start counting there.

        Parameters
        ----------
        tick : int
            Tick of the sample, extended past 32 bits.
        count : int
            `applied_count` of the sample.
        """
        del self._waiting[: bisect_right(self._waiting, tick, key=_tick)]
        self._tick, self._count = tick, count

    def forget(self) -> None:
        """Restart after a reset of the board."""
        self._waiting.clear()
        self._tick = self._count = 0

    @property
    def from_reset(self) -> bool:
        """True if all commands since the reset of the board are counted."""
        return self._tick == 0 and self._count == 0

    def missing(self, tick: int, applied_tick: int, applied_count: int) -> int:
        """Number of writes that a sample counts and that have not been reported.

        Parameters
        ----------
        tick : int
            Tick of the sample, extended past 32 bits.
        applied_tick, applied_count : int
            Variables of the board, uint32 and uint16.
        """
        counted = (applied_count - self._count) & _COUNT_WRAP
        if not counted:
            return 0
        last = tick - ((tick - applied_tick) & _TICK_WRAP)
        # Writes that take effect in the same slow tick count once.
        known = len({command.tick for command in self.until(last)})
        return max(counted - known, 0)

    def until(self, tick: int) -> list[AppliedCommand]:
        """Waiting commands that took effect up to `tick`, in order."""
        return self._waiting[: bisect_right(self._waiting, tick, key=_tick)]


def _tick(command: AppliedCommand) -> int:
    return command.tick
