"""Recorder of a fake target, implemented from the protocol description, independent of the client."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

UNCONFIGURED, EMPTY, RUNNING, CUT_SHORT, FULL = range(5)
RECORD_BYTES, SLOT_BYTES = 64, 32  # overhead of the reference target


@dataclass
class RecorderSlot:
    """One variable; `flags` as in protocol version 4."""

    address: int
    size: int
    flags: int = 0
    threshold: int = 0
    before: bool | None = None

    @property
    def stored(self) -> bool:
        return not self.flags & 0x04


class FakeRecorder:
    """Samples on `tick` as described in the protocol: no trigger before the memory has been filled once."""

    def __init__(self, peek: Callable[[int, int], bytes], big_endian: bool, size: int, address: int) -> None:
        self.peek = peek
        self.order = ">" if big_endian else "<"
        self.size = size
        self.address = address
        self.slots: list[RecorderSlot | None] = []
        self.total = self.pre = self.divide = 0
        self.configured = False
        self.state = UNCONFIGURED
        self.points: list[bytes] = []
        self.position = 0
        self.remaining: int | None = None
        self.skipped = 0

    def set_up(self, count: int, total: int, pre: int, divide: int) -> None:
        self.slots = [None] * count
        self.total, self.pre, self.divide = total, pre if pre < total else 0, divide
        self.configured, self.state = False, UNCONFIGURED

    @property
    def point_size(self) -> int:
        return sum(slot.size for slot in self.slots if slot is not None and slot.stored)

    def capacity(self, record: int = RECORD_BYTES, each: int = SLOT_BYTES) -> int:
        return (self.size - record - each * len(self.slots)) // self.point_size

    def ready(self) -> bool:
        """True if all slots are valid, which completes the configuration."""
        if not self.configured and self.slots and all(s is not None for s in self.slots) and self.point_size:
            fitting = self.capacity()
            self.total = min(self.total or fitting, fitting)
            self.configured, self.state, self.points = True, EMPTY, []
        return self.configured

    def start(self) -> None:
        if self.state != RUNNING:
            self.points, self.position, self.remaining, self.skipped, self.state = [], 0, None, self.divide, RUNNING

    def stop(self) -> None:
        if self.state == RUNNING:
            self.state = FULL if len(self.points) == self.total else CUT_SHORT

    def fire(self) -> None:
        if self.remaining is None:
            self.remaining = self.total - 1 - self.pre
            if self.remaining == 0:
                self.state = FULL

    def value(self, slot: RecorderSlot, data: bytes) -> float:
        kind = slot.flags & 3
        if kind == 3:
            return float(struct.unpack(self.order + ("f" if slot.size == 4 else "d"), data)[0])
        return int.from_bytes(data, "big" if self.order == ">" else "little", signed=kind == 2)

    def limit(self, slot: RecorderSlot) -> float:
        if slot.flags & 0x80:
            return self.value(slot, self.peek(slot.threshold, slot.size))
        if slot.flags & 3 == 3:
            code, size = ("f", 4) if slot.size == 4 else ("d", 8)
            return float(struct.unpack("<" + code, slot.threshold.to_bytes(size, "little"))[0])
        return slot.threshold

    def tick(self) -> None:
        if self.state != RUNNING:
            return
        self.skipped += 1
        if self.skipped <= self.divide:
            return
        self.skipped = 0
        fired, point = False, b""
        full = len(self.points) == self.total
        for slot in self.slots:
            assert slot is not None
            data = self.peek(slot.address, slot.size)
            if slot.flags & 3:
                above = self.value(slot, data) >= self.limit(slot)
                if self.remaining is None and full:
                    level = bool(slot.flags & 0x40)
                    fired |= bool(slot.flags & 0x10) and above and (level or slot.before is False)
                    fired |= bool(slot.flags & 0x20) and not above and (level or slot.before is True)
                slot.before = above
            point += data if slot.stored else b""
        if full:
            self.points[self.position] = point
        else:
            self.points.append(point)
        self.position = (self.position + 1) % self.total
        if self.remaining is not None:
            self.remaining -= 1
            if self.remaining == 0:
                self.state = FULL
        elif fired:
            self.fire()

    @property
    def first(self) -> int:
        return self.position if len(self.points) == self.total and self.points else 0

    def content(self) -> bytes:
        return b"".join(self.points)
