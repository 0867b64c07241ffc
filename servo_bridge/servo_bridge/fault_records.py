"""Reads the record of the first fault of an axis from the board, for the log and for a topic."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Final

from servo_msgs_py.catalogue import AXES, Value
from servo_msgs_py.fault_record import FaultRecord, record_variable

from servo_bridge.board_context import BoardContext
from servo_bridge.outcome import error_of
from servo_bridge.part import Part
from servo_bridge.telemetry import Snapshot

SECOND_READ: Final = 4000
"""PWM periods after which the first fault is final: the firmware may replace a symptom by its cause until then."""


class FaultRecords(Part):
    """Records of the first faults of all axes, read at the fault and again when the fault is final.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    changed : callable
        Called with a record that is new or whose fault has changed.
    """

    def __init__(self, context: BoardContext, changed: Callable[[FaultRecord], None]) -> None:
        self._context = context
        self._changed = changed
        self._words = [0] * AXES
        self._again: list[int | None] = [None] * AXES
        self.records: list[FaultRecord | None] = [None] * AXES

    def on_sample(self, snapshot: Snapshot) -> None:
        """Check the fault words of a sample."""
        tick = snapshot.tick
        for axis, word in enumerate(snapshot.faults):
            due = self._again[axis]
            if word == 0:
                self._again[axis] = None
                self.records[axis] = None
            elif self._words[axis] == 0:
                self._again[axis] = tick + SECOND_READ
                self._fetch(axis)
            elif due is not None and tick >= due:
                self._again[axis] = None
                self._fetch(axis)
            self._words[axis] = word

    def lost(self, reason: str) -> None:
        """Forget the records of the board."""
        self._words = [0] * AXES
        self._again = [None] * AXES
        self.records = [None] * AXES

    def _fetch(self, axis: int) -> None:
        self._context.when_done(self._context.read(record_variable(axis)), partial(self._take, axis))

    def _take(self, axis: int, done: Future[Value]) -> None:
        if error_of(done) is not None or self._words[axis] == 0:
            return  # link lost, or fault cleared; the fault itself is reported elsewhere
        try:
            record = FaultRecord.of(axis, done.result(), self._context.catalogue)
        except ValueError:  # firmware with other records; as above
            return
        before = self.records[axis]
        if record.fault is None:
            return
        self.records[axis] = record
        if before is None or (before.fault, before.tick) != (record.fault, record.tick):
            self._changed(record)
