"""The way of a command write to the board and the proof that it took effect.

One command write is under way at a time. It counts as done when telemetry shows that the firmware has latched one
more write; that sample's `applied_tick` is then exactly the tick of this write, so a twin can replay it. Urgent
writes (enable, stop, clear) go before set-points. Pure; the link is handed in.
Data go one way: the arbiter puts set-points into a `SetPointQueue`, and this takes them out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field

from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.units import SLOW_PERIODS

from servo_bridge.set_point_queue import CommandWrite, SetPointQueue

_TIMEOUT = 40 * SLOW_PERIODS
"""PWM periods (20 ms) after which an accepted write that no sample has shown is given up. The board latches within one
slow tick; the rest is for a sample that was already on its way."""


@dataclass
class _Item:
    write: CommandWrite
    done: Future[int] | None = None  # of an urgent write: the tick at which it took effect
    acknowledged: bool = False
    first_tick: int | None = field(default=None)  # of the first sample after the acknowledgement


class Dispatcher:
    """Sends command writes and attributes ticks to them. Every method is called from one thread.

    Parameters
    ----------
    send : callable
        Starts one write and returns at once; the owner reports its end through `acknowledged`.
    set_points : SetPointQueue
        Taken from whenever no write is under way.
    on_trouble : callable
        Gets a sentence for the log.
    """

    def __init__(
        self,
        send: Callable[[CommandWrite], None],
        set_points: SetPointQueue,
        on_trouble: Callable[[str], None],
    ) -> None:
        self._send = send
        self._set_points = set_points
        self._on_trouble = on_trouble
        self._urgent: deque[_Item] = deque()
        self._under_way: _Item | None = None
        self._count: int | None = None
        self._open = False

    def open(self, carried_out: CommandWrite | None = None) -> None:
        """Start sending: the link is up.

        Parameters
        ----------
        carried_out : CommandWrite, optional
            What the link has had the board do before its first sample, which tells the tick.
        """
        self._open = True
        self._count = None
        self._under_way = None if carried_out is None else _Item(carried_out, acknowledged=True)

    def close(self, reason: str) -> None:
        """Stop sending and throw away everything that waits; the futures of urgent writes fail with `reason`."""
        self._open = False
        items = ([self._under_way] if self._under_way is not None else []) + list(self._urgent)
        self._under_way = None
        self._urgent.clear()
        for item in items:
            _fail(item, reason)

    def urgent(self, write: CommandWrite) -> Future[int]:
        """Queue a write that goes before every set-point.

        Returns
        -------
        Future
            The tick at which it took effect, or a `ConnectionError` that says why it did not.
        """
        item = _Item(write, Future())
        assert item.done is not None
        if not self._open:
            _fail(item, "not connected")
        else:
            self._urgent.append(item)
            self.pump()
        return item.done

    def pump(self) -> None:
        """Send the next write when the way is free."""
        if not self._open or self._under_way is not None or self._count is None:
            return  # without a first sample the effect of a write could not be told
        if self._urgent:
            item = self._urgent.popleft()
        else:
            write = self._set_points.next_write()
            if write is None:
                return
            item = _Item(write)
        self._under_way = item
        self._send(item.write)

    def acknowledged(self, write: CommandWrite, error: str | None) -> None:
        """Take the board's answer to a write: None, or why it was refused."""
        item = self._under_way
        if item is None or item.write is not write:
            return  # thrown away meanwhile
        if error is None:
            item.acknowledged = True
            if item.done is None:
                self._set_points.accepted(write)
            return
        self._under_way = None
        if item.done is None:
            self._set_points.failed(write)
            self._on_trouble(f"the write of {write.variable} failed and its set-point is void: {error}")
        _fail(item, error)
        self.pump()

    def on_sample(self, tick: int, applied_tick: int, applied_count: int) -> AppliedCommand | None:
        """Look in a sample for the effect of the write under way.

        Parameters
        ----------
        tick : int
            Extended tick of the sample.
        applied_tick : int
            uint32 tick of the last write that took effect.
        applied_count : int
            uint16 number of writes that took effect.
        """
        before, self._count = self._count, applied_count
        item = self._under_way
        if item is None or not item.acknowledged:
            self.pump()
            return None
        if applied_count != before:
            extended = tick - ((tick - applied_tick) & 0xFFFF_FFFF)
            write = item.write
            self._finish(item, extended)
            return AppliedCommand(write.variable, extended, write.numbers(), write.mask)
        if item.first_tick is None:
            item.first_tick = tick
        elif tick - item.first_tick > _TIMEOUT:
            self._on_trouble(f"the board took a write of {item.write.variable} but did not carry it out")
            if item.done is None:
                self._set_points.failed(item.write)
            _fail(item, "the board took the command but did not carry it out")
            self._under_way = None
            self.pump()
        return None

    def _finish(self, item: _Item, tick: int) -> None:
        self._under_way = None
        if item.done is not None:
            item.done.set_result(tick)
        self.pump()


def _fail(item: _Item, reason: str) -> None:
    if item.done is not None:
        item.done.set_exception(ConnectionError(reason))
