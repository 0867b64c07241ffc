"""Independent reference of the recorders of the FreeMASTER server: operations, triggers and samples."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from freemaster_model import SAMPLES, Answer, Layout, uleb

SLOTS: Final = 8

NAMES: Final = (b"fast", b"slow")
TIMEBASE: Final = (1_000_000, 0)
OK: Final = Answer(0)

UNSIGNED, SIGNED, FLOAT = 1, 2, 3
NOT_STORED, ABOVE, BELOW, LEVEL, VARIABLE = 0x04, 0x10, 0x20, 0x40, 0x80


START, STOP = b"\x03\x00", b"\x04\x00"


def operation(code: int, data: bytes) -> bytes:
    """Operation of SETREC."""
    return bytes([code, len(data)]) + data


def memory(slots: int, total: int = 0, before: int = 0, divider: int = 0) -> bytes:
    """CFGMEM."""
    return operation(1, bytes([slots]) + uleb(total) + uleb(before) + uleb(divider))


def variable(slot: int, address: int, size: int, mode: int = 0, threshold: bytes = b"\0") -> bytes:
    """CFGVAR."""
    return operation(2, bytes([slot]) + uleb(address) + bytes([size, mode]) + threshold)


class Refused(Exception):
    """An operation is refused with this status."""

    def __init__(self, status: int) -> None:
        super().__init__(f"{status:#x}")
        self.status = status


class Reader:
    """Fields of an operation; a missing field is read as 0 and reported at the end."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at, self._missing = data, 0, False

    def missing(self) -> bool:
        """Whether a requested field was missing."""
        return self._missing

    def complete(self) -> bool:
        """Whether all fields were present, without further bytes."""
        return not self._missing and self._at == len(self._data)

    def u8(self) -> int:
        if self._at >= len(self._data):
            self._end()
            return 0
        self._at += 1
        return self._data[self._at - 1]

    def number(self, signed: bool = False) -> int:
        """Number of 32 bits; bits that do not fit are dropped."""
        group = next((k for k in range(self._at, len(self._data)) if self._data[k] < 0x80), None)
        if group is None:
            self._end()
            return 0
        groups = self._data[self._at : group + 1]
        self._at = group + 1
        value = sum((byte & 0x7F) << 7 * k for k, byte in enumerate(groups))
        if signed and groups[-1] & 0x40:
            value -= 1 << 7 * len(groups)
        value &= 0xFFFF_FFFF
        return value - (1 << 32) if signed and value >> 31 else value

    def _end(self) -> None:
        self._missing, self._at = True, len(self._data)


@dataclass
class Slot:
    """A variable of a recorder."""

    address: int
    size: int
    mode: int
    limit: int
    """Threshold, or its address."""
    above: bool = False

    @property
    def stored(self) -> bool:
        return not self.mode & NOT_STORED


@dataclass
class Memory:
    """Memory of the board; the test changes it together with the board."""

    layout: Layout
    variables: bytearray
    live: bytearray
    samples: bytearray = field(default_factory=lambda: bytearray(SAMPLES))
    owner: Recorder | None = None
    """Whose samples these are."""

    def bytes_at(self, address: int, size: int) -> bytes:
        """Bytes of the control loops at an address."""
        source = self.layout.source(address, size)
        if source is not None:
            return bytes(self.live[source : source + size])
        offset = address - self.layout.variables
        return bytes(self.variables[offset : offset + size])

    def recorded(self, address: int, size: int) -> bytes | None:
        """Samples at an address; None if they cannot be read."""
        offset = address - self.layout.samples
        if self.owner is None or self.owner.running or offset < 0 or offset + size > SAMPLES:
            return None
        return bytes(self.samples[offset : offset + size])


@dataclass
class Recorder:
    """One recorder."""

    index: int
    memory: Memory
    slots: list[Slot | None] = field(default_factory=list)
    total: int = 0
    before: int = 0
    divider: int = 0
    configured: bool = False
    started: bool = False
    running: bool = False
    written: int = 0
    """Points since the start."""
    remaining: int | None = None
    """Points to come once a trigger has fired."""
    skip: int = 0

    @property
    def point(self) -> int:
        return sum(slot.size for slot in self.slots if slot is not None and slot.stored)

    def forget(self) -> None:
        """Discard the configuration."""
        self.slots = []
        self.configured = self.started = self.running = False
        self.written = 0

    # ---- the loop ------------------------------------------------------------------------------------------------

    def sample(self) -> None:
        """One call of the loop."""
        if not self.running:
            return
        if self.skip:
            self.skip -= 1
            return
        self.skip = self.divider
        point = b""
        for slot in self.slots:
            assert slot is not None
            if slot.mode & 3:
                self._judge(slot)
            if slot.stored:
                point += self.memory.bytes_at(slot.address, slot.size)
        at = self.written % self.total * self.point
        self.memory.samples[at : at + self.point] = point
        self.written += 1
        if self.remaining is not None:
            self.running = self.remaining > 0
            self.remaining -= 1

    def _judge(self, slot: Slot) -> None:
        def number(address: int) -> int:
            return int.from_bytes(self.memory.bytes_at(address, slot.size), "little", signed=slot.mode & 3 == SIGNED)

        above = number(slot.address) >= (number(slot.limit) if slot.mode & VARIABLE else slot.limit)
        requested = bool(slot.mode & (ABOVE if above else BELOW))
        if (
            self.written >= self.total
            and self.remaining is None
            and requested
            and (slot.mode & LEVEL or slot.above != above)
        ):
            self.remaining = self.total - 1 - self.before
        slot.above = above

    # ---- requests ------------------------------------------------------------------------------------------------

    def set(self, operations: bytes) -> Answer:
        """Fields of SETREC after the index."""
        while len(operations) >= 2:
            code, length = operations[0], operations[1]
            data, operations = operations[2 : 2 + length], operations[2 + length :]
            if len(data) < length:
                return Answer(0x86)
            try:
                self._operation(code, Reader(data))
            except Refused as refusal:
                return Answer(refusal.status)
        return OK

    def get(self, code: int) -> Answer:
        """Fields of GETREC after the index."""
        if code == 0x81:
            return Answer(0x40, NAMES[self.index])
        if code == 0x82:
            return Answer(0x40, uleb(SAMPLES) + uleb(TIMEBASE[self.index]) + b"\0\0")
        if code == 0x83:
            return Answer(0x40, self._info())
        if code == 0x84:
            return Answer(0x40, bytes([self.state()]))
        return Answer(0x95)

    def state(self) -> int:
        """State, as in the answer to STATUS."""
        if not self._finish():
            return 0
        if self.running:
            return 2
        if not self.started:
            return 1
        return 4 if self.written >= self.total else 3

    def _info(self) -> bytes:
        state = self.state()
        if state == 0:
            return bytes(6)
        stored = sum(1 for slot in self.slots if slot is not None and slot.stored)
        full = not self.started or self.written >= self.total
        count, first = (self.total, self.written % self.total) if full else (self.written, 0)
        numbers = (self.memory.layout.samples, self.point, count, first)
        return bytes([state, stored]) + b"".join(map(uleb, numbers))

    def _operation(self, code: int, reader: Reader) -> None:
        if code == 1:
            self._reserve(reader)
        elif code == 2:
            self._variable(reader)
        elif code in (3, 4):
            if not reader.complete():
                raise Refused(0x86)
            self._start() if code == 3 else self._stop()
        else:
            raise Refused(0x95)

    def _reserve(self, reader: Reader) -> None:
        count, total, before, divider = reader.u8(), reader.number(), reader.number(), reader.number()
        if not reader.complete() or count > SLOTS:
            raise Refused(0x86)
        owner = self.memory.owner
        if owner is not None and owner is not self:
            if owner.running:
                raise Refused(0x87)
            owner.forget()
        self.forget()
        self.memory.owner = self
        self.slots = [None] * count
        self.total, self.before, self.divider = total, before, divider

    def _variable(self, reader: Reader) -> None:
        layout = self.memory.layout
        index = reader.u8()
        if not reader.missing() and index >= len(self.slots):
            raise Refused(0x94)
        if self.configured:
            raise Refused(0x87)
        address, size, mode = reader.number(), reader.u8(), reader.u8()
        if reader.missing() or size not in (1, 2, 4, 8):
            raise Refused(0x86)
        if not layout.recordable(address, size):
            raise Refused(0x89)
        if mode & 3 == FLOAT:
            raise Refused(0x86 if size < 4 else 0x90)
        limit = reader.number(signed=mode & 3 == SIGNED and not mode & VARIABLE)
        if mode & VARIABLE and not reader.missing() and not layout.recordable(limit, size):
            raise Refused(0x89)
        if not reader.complete():
            raise Refused(0x86)
        self.slots[index] = Slot(address, size, mode, limit)

    def _finish(self) -> bool:
        if not self.configured and all(slot is not None for slot in self.slots) and self.point:
            fitting = SAMPLES // self.point
            self.total = self.total if 0 < self.total <= fitting else fitting
            self.before = self.before if self.before < self.total else 0
            self.configured = True
        return self.configured

    def _start(self) -> None:
        if not self._finish():
            raise Refused(0x86)
        if not self.running:
            self.started = self.running = True
            self.written, self.skip, self.remaining = 0, 0, None

    def _stop(self) -> None:
        if not self.configured:
            raise Refused(0x88)
        self.running = False
