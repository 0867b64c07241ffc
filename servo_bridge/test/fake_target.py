"""Fake FreeMASTER v4 target, implemented from the protocol description, independent of the client.

It maps received bytes to answered bytes. Every memory access follows the rules of TSA safety.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from fake_recorder import RECORD_BYTES, SLOT_BYTES, FakeRecorder, RecorderSlot

SOB = 0x2B
NONE, RO, FLASH, RW = 0, 1, 2, 3
STRUCT, ENUM, CONST = b"\xed:STRUCT", b"\xed:ENUM", b"\xed:CONST"


def checksum(data: bytes) -> int:
    """CRC-8, bit by bit."""
    crc = 0
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (crc >> 7) ^ (byte >> bit & 1)
            crc = (crc << 1 & 0xFF) ^ (0x07 if feedback else 0)
    return crc


def escaped(body: bytes) -> bytes:
    out = bytearray([SOB])
    for byte in body:
        out += bytes([byte, byte]) if byte == SOB else bytes([byte])
    return bytes(out)


def uleb(value: int) -> bytes:
    out = []
    while True:
        low, value = value % 128, value // 128
        out.append(low + (128 if value else 0))
        if not value:
            return bytes(out)


@dataclass
class FakeEntry:
    """One row of a TSA table."""

    name: str
    type: bytes | None
    address: int
    size: int
    kind: int


class Refused(Exception):
    """Refusal of a command with a status."""


class Reader:
    """Reads fields of a payload."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.offset = 0

    def u8(self) -> int:
        self.offset += 1
        return self.data[self.offset - 1]

    def uleb(self) -> int:
        value = shift = 0
        while True:
            byte = self.u8()
            value += (byte % 128) << shift
            shift += 7
            if byte < 128:
                return value

    def sleb(self) -> int:
        start = self.offset
        value = self.uleb()
        bits = 7 * (self.offset - start)
        return value - (1 << bits) if self.data[self.offset - 1] & 0x40 else value

    def take(self, count: int) -> bytes:
        self.offset += count
        return self.data[self.offset - count : self.offset]


@dataclass
class FakeTarget:
    """Fake target with its memory and tables."""

    mtu: int = 240
    field_width: int = 4
    big_endian: bool = False
    safety: bool = True
    scopes: int = 1
    scope_limit: int = 8
    passwords: dict[int, str] = field(default_factory=dict)
    recorder_memory: int = 0
    recorder_period_ns: int = 62_500
    ticks_per_request: int = 0
    config: dict[str, bytes] = field(default_factory=dict)
    tables: list[list[FakeEntry]] = field(default_factory=lambda: [[]])
    accepts: Callable[[int, bytes], bool] | None = None
    on_write: Callable[[int, bytes], None] | None = None
    before_scope: Callable[[], None] | None = None
    on_tick: Callable[[int], None] | None = None
    pipe: bytearray = field(default_factory=bytearray)
    commands: dict[int, Callable[[bytes], int]] = field(default_factory=dict)
    requests: list[tuple[int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.memory: dict[int, int] = {}
        self._strings: dict[bytes, int] = {}
        self._next_string = 0x0804_F115
        self._table_ranges: list[tuple[int, int]] = []
        self._start_received = False
        self._length_expected = False
        self._bytes_left = 0
        self._crc = bytearray()
        self._buffer = bytearray()
        self._overflow = False
        self.scope: list[tuple[int, int] | None] = []
        self._command_status = 0xFF
        self._command: tuple[int, bytes] | None = None
        self.ticks_done = 0
        self.open_level = min(self.passwords, default=4) - 1
        self.level = self.open_level
        self._pipe_odd, self._pipe_accepted = False, 0
        self.pipe_received = b""
        self._salts = 0
        self.recorders = (
            [FakeRecorder(self.peek, self.big_endian, self.recorder_memory, 0x2000_8000 if self.mtu > 64 else 0x8000)]
            if self.recorder_memory
            else []
        )
        values = {
            "MTU": uleb(self.mtu), "VS": b"fake 1.0\0", "NM": b"fake\0", "DS": b"test target\0", "BD": b"today\0",
            "F1": bytes([0x02 | self.big_endian | min(self.passwords, default=0) << 4]),
            "RC": bytes([len(self.recorders)]), "SC": bytes([self.scopes]), "PV": b"\x04", "PC": b"\0",
        }  # fmt: skip
        self.config = {**values, **self.config}

    # ---- building
    @property
    def order(self) -> Literal["little", "big"]:
        return "big" if self.big_endian else "little"

    def poke(self, address: int, data: bytes) -> None:
        for k, byte in enumerate(data):
            self.memory[address + k] = byte

    def peek(self, address: int, size: int) -> bytes:
        return bytes(self.memory.get(address + k, 0) for k in range(size))

    def set_int(self, address: int, value: int, size: int) -> None:
        self.poke(address, (value % (1 << 8 * size)).to_bytes(size, self.order))

    def _string(self, text: bytes) -> int:
        if text not in self._strings:
            self._strings[text] = self._next_string
            self.poke(self._next_string, text + b"\0")
            self._next_string += len(text) + 1
        return self._strings[text]

    def build(self, table_address: int = 0x2000_10E0) -> None:
        """Write the tables and their strings to memory."""
        self._table_ranges = []
        for table in self.tables:
            data = b""
            for e in table:
                name = self._string(e.name.encode()) if e.name else 0
                kind = self._string(e.type) if e.type is not None else 0
                for word in (name, kind, e.address, e.size << 2 | e.kind):
                    data += (word % (1 << 8 * self.field_width)).to_bytes(self.field_width, self.order)
            self.poke(table_address, data)
            self._table_ranges.append((table_address, len(data)))
            table_address += len(data) + 64

    # ---- receiver
    def feed(self, data: bytes) -> bytes:
        """Receive bytes and return the answer."""
        return b"".join(self._receive(byte) for byte in data)

    def _receive(self, byte: int) -> bytes:
        if byte == SOB:
            self._start_received = not self._start_received
            if self._start_received:
                return b""
        elif self._start_received:
            self._crc = bytearray([byte])
            self._buffer = bytearray([byte])
            self._bytes_left, self._length_expected, self._start_received, self._overflow = 0, True, False, False
            return b""
        if self._length_expected:
            self._bytes_left = (byte + 1) % 256
            self._crc.append(byte)
            self._length_expected = False
        elif self._bytes_left > 0:
            self._bytes_left -= 1
            if self._bytes_left:
                self._crc.append(byte)
                if len(self._buffer) < self.mtu - 1:
                    self._buffer.append(byte)
                else:
                    self._overflow = True
            else:
                return self._finish(byte)
        return b""

    def _finish(self, crc: int) -> bytes:
        if self._overflow:
            return self._frame(0x83)
        if crc != checksum(bytes(self._crc)):
            return self._frame(0x82)
        command, payload = self._buffer[0], bytes(self._buffer[1:])
        self.requests.append((command, payload))
        self.advance(self.ticks_per_request)
        try:
            status, data = self._execute(command, Reader(payload))
        except Refused as refused:
            return self._frame(int(refused.args[0]))
        if len(data) > 252:
            return self._frame(0x84)
        return self._frame(status, data)

    @staticmethod
    def _frame(status: int, data: bytes = b"") -> bytes:
        body = bytes([status]) + (bytes([len(data)]) if status & 0x40 and status < 0x80 else b"") + data
        return escaped(body + bytes([checksum(body)]))

    # ---- commands
    def _execute(self, command: int, r: Reader) -> tuple[int, bytes]:
        match command:
            case 0x20:
                return self._get_config(r)
            case 0x21:
                address, size = r.uleb(), r.uleb()
                if self.level < 1:
                    raise Refused(0x91)
                self._check(address, size, write=False)
                if size > self.mtu:
                    raise Refused(0x84)
                return 0, self.peek(address, size)
            case 0x23:
                return self._write(r)
            case 0x26:
                return self._set_scope(r)
            case 0x27:
                return self._read_scope(r)
            case 0x28:
                return self._exchange_pipe(r)
            case 0x29:
                index = r.uleb()
                address, size = self._table_ranges[index] if index < len(self._table_ranges) else (0, 999)
                width = {2: 0, 4: 1, 8: 2}[self.field_width]
                return 0x40, bytes([0x03 | width << 4]) + uleb(size) + uleb(address)
            case 0x2A:
                address = r.uleb()
                end = address
                while self.memory.get(end, 0):
                    end += 1
                return 0x40, uleb(end - address)
            case 0x24:
                return self._set_recorder(r)
            case 0x25:
                return self._get_recorder(r)
            case 0x2C if self.passwords:
                level = r.u8()
                if level <= self.open_level:
                    self.level = max(level, self.open_level)
                    return 0x40, b"\0"
                self._salts += 1
                return 0x40, b"\1" + self._salts.to_bytes(16, "big")
            case 0x2D if self.passwords:
                return self._log_in(r.u8(), r.take(20))
            case 0x30:
                return self._start_command(r)
            case 0x31:
                # As in the firmware: a command runs when its result is requested.
                if self._command is not None:
                    self._command_status = self._run(*self._command)
                    self._command = None
                return 0, bytes([self._command_status])
        raise Refused(0x81)

    def _get_config(self, r: Reader) -> tuple[int, bytes]:
        index = r.u8()
        key = r.data[1:].split(b"\0")[0][:3].decode("latin-1") if index == 0 else ""
        if key not in self.config:
            raise Refused(0x89)
        return 0x40, key.encode() + b"\0" + self.config[key]

    def _write(self, r: Reader) -> tuple[int, bytes]:
        masked, address, size = r.u8(), r.uleb(), r.uleb()
        assert not masked
        if self.level < 2:
            raise Refused(0x91)
        self._check(address, size, write=True)
        data = r.take(size)
        if self.accepts is not None and not self.accepts(address, data):
            raise Refused(0x97)
        self.poke(address, data)
        if self.on_write is not None:
            self.on_write(address, data)
        return 0, b""

    def _set_scope(self, r: Reader) -> tuple[int, bytes]:
        if not r.data:
            raise Refused(0x86)
        if r.u8() >= self.scopes:
            raise Refused(0x94)
        while len(r.data) - r.offset >= 2:
            op, length = r.u8(), r.u8()
            if length > len(r.data) - r.offset:
                raise Refused(0x86)
            body = Reader(r.take(length))
            if op == 1:
                count = body.u8()
                if count > self.scope_limit:
                    raise Refused(0x86)
                self.scope = [None] * count
            elif op == 2:
                slot, address, size = body.u8(), body.uleb(), body.u8()
                if slot >= len(self.scope):
                    raise Refused(0x85)
                if size not in (1, 2, 4, 8) or body.offset != length:
                    raise Refused(0x86)
                self._check(address, size, write=False)
                self.scope[slot] = (address, size)
            else:
                raise Refused(0x81)
        return 0, b""

    def _read_scope(self, r: Reader) -> tuple[int, bytes]:
        if r.u8() >= self.scopes:
            raise Refused(0x94)
        if not self.scope:
            raise Refused(0x88)
        if self.before_scope is not None:
            self.before_scope()
        return 0, b"".join(self.peek(*slot) for slot in self.scope if slot is not None)

    def _log_in(self, level: int, key: bytes) -> tuple[int, bytes]:
        salt = self._salts.to_bytes(16, "big")
        for known in (3, 2, 1):
            own = max((k for k in self.passwords if k <= known), default=0)
            inner = hashlib.sha1(self.passwords[own].encode()).digest() if own else b""
            if own and hashlib.sha1(salt + inner + salt).digest() == key:
                self.level = max(min(known, level), self.open_level)
                return 0, bytes([min(known, level)])
        self.level = self.open_level
        raise Refused(0x92)

    def _exchange_pipe(self, r: Reader) -> tuple[int, bytes]:
        """Pipe 1 is open and accepts four bytes per request."""
        head, acknowledged = r.u8(), r.u8()
        if head & 0x7F != 1:
            raise Refused(0x8C)
        if bool(head & 0x80) == self._pipe_odd:
            self._pipe_odd = not self._pipe_odd
            del self.pipe[:acknowledged]
            taken = r.data[r.offset : r.offset + 4]
            self.pipe_received += taken
            self._pipe_accepted = len(taken)
        return 0x40, bytes([head, self._pipe_accepted]) + self.pipe[: self.mtu - 3]

    # ---- recorder
    def advance(self, ticks: int) -> None:
        """Run the fast loop."""
        for _ in range(ticks):
            self.ticks_done += 1
            if self.on_tick is not None:
                self.on_tick(self.ticks_done)
            for recorder in self.recorders:
                recorder.tick()
        for recorder in self.recorders:
            self.poke(recorder.address, recorder.content())

    def _set_recorder(self, r: Reader) -> tuple[int, bytes]:
        if not r.data:
            raise Refused(0x86)
        index = r.u8()
        if index >= len(self.recorders):
            raise Refused(0x94)
        recorder = self.recorders[index]
        while r.offset < len(r.data):
            op, length = r.u8(), r.u8()
            if length > len(r.data) - r.offset:
                raise Refused(0x86)
            body = Reader(r.take(length))
            match op:
                case 1:
                    count = body.u8()
                    if RECORD_BYTES + SLOT_BYTES * count >= recorder.size:
                        raise Refused(0x86)
                    recorder.set_up(count, body.uleb(), body.uleb(), body.uleb())
                case 2:
                    slot, address, size, flags = body.u8(), body.uleb(), body.u8(), body.u8()
                    threshold = body.sleb() if flags & 3 == 2 and not flags & 0x80 else body.uleb()
                    if slot >= len(recorder.slots):
                        raise Refused(0x94)
                    if recorder.configured:
                        raise Refused(0x87)
                    if size not in (1, 2, 4, 8):
                        raise Refused(0x86)
                    self._check(address, size, write=False)
                    recorder.slots[slot] = RecorderSlot(address, size, flags, threshold)
                case 3:
                    if not recorder.ready():
                        raise Refused(0x86)
                    recorder.start()
                case 4:
                    if not recorder.configured:
                        raise Refused(0x88)
                    recorder.stop()
                case _:
                    raise Refused(0x95)
            if body.offset != length:
                raise Refused(0x86)
        return 0, b""

    def _get_recorder(self, r: Reader) -> tuple[int, bytes]:
        index, op = r.u8(), r.u8()
        if index >= len(self.recorders):
            raise Refused(0x94)
        recorder = self.recorders[index]
        match op:
            case 0x81:
                return 0x40, b"fast"
            case 0x82:
                numbers = (recorder.size, self.recorder_period_ns, RECORD_BYTES, SLOT_BYTES)
                return 0x40, b"".join(map(uleb, numbers))
            case 0x83:
                if not recorder.ready():
                    return 0x40, bytes(6)
                stored = sum(slot is not None and slot.stored for slot in recorder.slots)
                count = recorder.total if recorder.state == 1 else len(recorder.points)
                numbers = (recorder.address, recorder.point_size, count, recorder.first)
                return 0x40, bytes([recorder.state, stored]) + b"".join(map(uleb, numbers))
            case 0x84:
                recorder.ready()
                return 0x40, bytes([recorder.state])
        raise Refused(0x95)

    def _start_command(self, r: Reader) -> tuple[int, bytes]:
        if not r.data:
            raise Refused(0x86)
        if self._command_status == 0xFE:
            raise Refused(0x87)
        self._command, self._command_status = (r.u8(), r.data[1:]), 0xFE
        return 0, b""

    def _run(self, code: int, arguments: bytes) -> int:
        command = self.commands.get(code)
        return 0 if command is None else command(arguments)

    # ---- TSA safety
    def _check(self, address: int, size: int, *, write: bool) -> None:
        if not self.safety:
            return

        def inside(start: int, length: int) -> bool:
            return start <= address and address + size <= start + length

        kinds = (RW,) if write else (RO, FLASH, RW)
        for table in self.tables:
            for e in table:
                if e.kind in kinds and not (e.type or b"").startswith(b"\xed") and inside(e.address, e.size):
                    return
        if not write:
            if any(inside(recorder.address, recorder.size) for recorder in self.recorders):
                return
            if any(inside(start, length) for start, length in self._table_ranges):
                return
            if any(inside(start, len(text)) for text, start in self._strings.items()):
                return
        raise Refused(0x89)

    def reset(self) -> None:
        """Reset of the target."""
        self.scope = []
        self.level = self.open_level
        self._start_received = self._length_expected = False
        self._bytes_left = 0
