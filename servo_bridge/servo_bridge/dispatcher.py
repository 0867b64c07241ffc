"""Sends command writes one at a time and confirms each by `applied_count` and `applied_tick` in the telemetry.

A write is confirmed when the telemetry shows one more applied write; the `applied_tick` of that sample is then the
exact tick of this write, so a twin can replay it. Urgent writes (enable, stop, clear) precede parameters, which precede
set-points. The arbiter puts set-points into a `SetPointQueue`, the dispatcher removes them. The link is a parameter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

from servo_msgs_py.catalogue import AXES
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.units import SLOW_PERIODS

from servo_bridge.part import Part
from servo_bridge.set_point_queue import CommandWrite, SetPointQueue
from servo_bridge.telemetry import Snapshot

_TIMEOUT = 40 * SLOW_PERIODS
"""PWM periods (20 ms) after which an acknowledged write without effect is given up. The board applies writes within one
slow tick; the remainder allows for a sample that was already being transmitted."""

_STOP_AT_CONNECTION = CommandWrite("cmd.quick_stop", 0, (1,) * AXES)
"""First write of the link, see `wire.stop_at_connection`."""


@dataclass
class _Item:
    write: CommandWrite
    done: Future[int] | None = None  # of an urgent write: the tick at which it took effect
    acknowledged: bool = False
    first_tick: int | None = field(default=None)  # of the first sample after the acknowledgement


class Dispatcher(Part):
    """Sends command writes and finds the ticks of their effect. All methods are called from one thread.

    Parameters
    ----------
    send : callable
        Starts a write and returns at once; the owner reports the response through `acknowledged`.
    set_points : SetPointQueue
        Source of set-points while no write is pending.
    on_trouble : callable
        Receives messages for the log.
    on_applied : callable
        Receives every write with the tick of its effect.
    """

    def __init__(
        self,
        send: Callable[[CommandWrite], None],
        set_points: SetPointQueue,
        on_trouble: Callable[[str], None],
        on_applied: Callable[[AppliedCommand], None] = lambda _: None,
    ) -> None:
        self._on_applied = on_applied
        self._send = send
        self._set_points = set_points
        self._on_trouble = on_trouble
        self._urgent: deque[_Item] = deque()
        self._parameters: deque[_Item] = deque()
        self._pending: _Item | None = None
        self._count: int | None = None
        self._open = False

    def connected(self) -> None:
        """Start sending; the link has stopped the axes before its first sample."""
        self.open(_STOP_AT_CONNECTION)

    def open(self, carried_out: CommandWrite | None = None) -> None:
        """Start sending after the link is up.

        Parameters
        ----------
        carried_out : CommandWrite, optional
            Write that the link has executed before its first sample; that sample has the tick.
        """
        self._open = True
        self._count = None
        self._pending = None if carried_out is None else _Item(carried_out, acknowledged=True)

    def lost(self, reason: str) -> None:
        """Stop sending and discard all pending writes; the futures of urgent writes fail with `reason`."""
        self._open = False
        items = ([self._pending] if self._pending is not None else []) + [*self._urgent, *self._parameters]
        self._pending = None
        self._urgent.clear()
        self._parameters.clear()
        for item in items:
            _fail(item, reason)

    def urgent(self, write: CommandWrite) -> Future[int]:
        """Queue a write that precedes all others.

        Returns
        -------
        Future
            The tick of its effect, or a `ConnectionError` with the reason.
        """
        return self._queued(write, self._urgent)

    def parameter(self, variable: str, raw: Sequence[int]) -> Future[int]:
        """Queue a write of all elements of a parameter, which precedes all set-points; returns as `urgent`."""
        return self._queued(CommandWrite(variable, 0, tuple(raw)), self._parameters)

    def _queued(self, write: CommandWrite, queue: deque[_Item]) -> Future[int]:
        item = _Item(write, Future())
        assert item.done is not None
        if not self._open:
            _fail(item, "not connected")
        else:
            queue.append(item)
            self.pump()
        return item.done

    def pump(self) -> None:
        """Send the next write if none is pending."""
        if not self._open or self._pending is not None or self._count is None:
            return  # without a first sample the effect of a write cannot be detected
        if queue := self._urgent or self._parameters:
            item = queue.popleft()
        else:
            write = self._set_points.next_write()
            if write is None:
                return
            item = _Item(write)
        self._pending = item
        self._send(item.write)

    def acknowledged(self, write: CommandWrite, error: str | None) -> bool:
        """Process the response of the board to a write; `error` None: accepted.

        Returns
        -------
        bool
            True: the write has failed, and its set-points are discarded.
        """
        item = self._pending
        if item is None or item.write is not write:
            return False  # discarded in the meantime
        if error is None:
            item.acknowledged = True
            if item.done is None:
                self._set_points.accepted(write)
            return False
        self._pending = None
        discarded = item.done is not None or self._set_points.failed(write)
        if item.done is None and discarded:
            self._on_trouble(f"the write of {write.variable} failed, its set-point is discarded: {error}")
        _fail(item, error)
        self.pump()
        return discarded

    def on_sample(self, snapshot: Snapshot) -> None:
        """Report the pending write if a sample has its effect."""
        applied = self.confirm(snapshot.tick, snapshot.applied_tick, snapshot.applied_count)
        if applied is not None:
            self._on_applied(applied)

    def confirm(self, tick: int, applied_tick: int, applied_count: int) -> AppliedCommand | None:
        """Check a sample for the effect of the pending write.

        Parameters
        ----------
        tick : int
            Extended tick of the sample.
        applied_tick : int
            uint32 tick of the last applied write.
        applied_count : int
            uint16 number of applied writes.
        """
        before, self._count = self._count, applied_count
        item = self._pending
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
            self._on_trouble(f"the write of {item.write.variable} was acknowledged but not applied within 20 ms")
            if item.done is None:
                self._set_points.failed(item.write)
            _fail(item, "the command was acknowledged but not applied within 20 ms")
            self._pending = None
            self.pump()
        return None

    def _finish(self, item: _Item, tick: int) -> None:
        self._pending = None
        if item.done is not None:
            item.done.set_result(tick)
        self.pump()


def _fail(item: _Item, reason: str) -> None:
    if item.done is not None:
        item.done.set_exception(ConnectionError(reason))
