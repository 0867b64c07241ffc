"""Fake FreeMASTER v3 target, implemented from the protocol description, independent of the client."""

from __future__ import annotations

from dataclasses import dataclass

from fake_recorder import RUNNING, RecorderSlot
from fake_target import SOB, FakeTarget, Reader, Refused, escaped


@dataclass
class FakeTargetV3(FakeTarget):
    """Fake target of version 3; it inherits the parts that are common to both versions."""

    mtu: int = 60
    wide: bool = True
    narrow: bool = False
    brief: bool = False
    scope_limit: int = 8
    description: str = "oracle v3 board"
    time_base: int = 0x83E8
    table_version: int = 2

    @property
    def _pointer(self) -> int:
        return 4 if self.wide else 2

    @staticmethod
    def _frame(status: int, data: bytes = b"") -> bytes:
        body = bytes([status]) + (bytes([len(data)]) if status == 0x40 else b"") + data
        return escaped(body + bytes([-sum(body) % 256]))

    def _receive(self, byte: int) -> bytes:
        if byte == SOB:
            self._start_received = not self._start_received
            if self._start_received:
                return b""
        elif self._start_received:
            self._crc = bytearray([byte])
            self._buffer = bytearray([byte])
            self._start_received = self._overflow = False
            self._length_expected = byte < 0xC0
            self._bytes_left = 0 if self._length_expected else 2 * (byte >> 4 & 3) + 1
            return b""
        if self._length_expected:
            self._crc.append(byte)
            self._length_expected = False
            self._bytes_left = byte + 1
        elif self._bytes_left > 0:
            self._bytes_left -= 1
            self._crc.append(byte)
            if self._bytes_left == 0:
                return self._finish(byte)
            if len(self._buffer) < self.mtu - 1:
                self._buffer.append(byte)
            else:
                self._overflow = True
        return b""

    def _finish(self, crc: int) -> bytes:
        if self._overflow:
            return self._frame(0x83)
        if sum(self._crc) % 256:
            return self._frame(0x82)
        command, payload = self._buffer[0], bytes(self._buffer[1:])
        self.requests.append((command, payload))
        self.advance(self.ticks_per_request)
        try:
            status, data = self._run_command(command, Reader(payload))
        except Refused as refused:
            return self._frame(int(refused.args[0]))
        return self._frame(status, data)

    def _number(self, r: Reader, size: int) -> int:
        return int.from_bytes(r.take(size), self.order)

    def _bytes(self, value: int, size: int) -> bytes:
        return (value % (1 << 8 * size)).to_bytes(size, self.order)

    def _address(self, r: Reader, wide: bool) -> int:
        if not (self.wide if wide else self.narrow):
            raise Refused(0x81)
        return self._number(r, 4 if wide else 2)

    def _list(self, r: Reader, wide: bool) -> list[tuple[int, int]]:
        count = r.u8()
        if not 0 < count <= self.scope_limit:
            raise Refused(0x85)
        slots = []
        for _ in range(count):
            size = r.u8()
            slots.append((self._address(r, wide), size))
        return slots

    def _run_command(self, command: int, r: Reader) -> tuple[int, bytes]:
        match command:
            case 0xC0 if not self.brief:
                return 0, self._info() + self._bytes(self.recorder_memory, 2) + self._bytes(
                    self.time_base, 2
                ) + self.description.encode().ljust(25, b"\0")[:25]
            case 0xC8 if self.brief:
                return 0, self._info()
            case 0x01 | 0x04:
                size = r.u8()
                address = self._address(r, command == 0x04)
                self._check(address, size, write=False)
                if size > self.mtu:
                    raise Refused(0x84)
                return 0, self.peek(address, size)
            case 0x02 | 0x05:
                return self._write_v3(r, command == 0x05)
            case 0x08 | 0x0A:
                self.scope = []
                slots = self._list(r, command == 0x0A)
                for slot in slots:
                    self._check(*slot, write=False)
                self.scope = list(slots)
                return 0, b""
            case 0xC5:
                if not self.scope:
                    raise Refused(0x88)
                if self.before_scope is not None:
                    self.before_scope()
                return 0, b"".join(self.peek(*slot) for slot in self.scope if slot is not None)
            case 0x11 | 0x12:
                self._require(command == 0x12)
                index = self._number(r, 2)
                address, size = self._table_ranges[index] if index < len(self._table_ranges) else (0, 999)
                flags = self.table_version | (0x0100 if self.field_width == 4 else 0)
                return 0, self._bytes(flags, 2) + self._bytes(size, 2) + self._bytes(address, self._pointer)
            case 0xD4 | 0xE6:
                address = end = self._address(r, command == 0xE6)
                while self.memory.get(end, 0):
                    end += 1
                return 0, self._bytes(end - address, 2)
            case 0x15:
                return self._exchange_pipe(r)
            case 0x10:
                return self._start_command(r)
            case 0xC6:
                if self._command is not None:
                    self._command_status = self._run(*self._command)
                    self._command = None
                return 0, bytes([self._command_status])
            case 0x09 | 0x0B:
                return self._set_up_recorder(r, command == 0x0B)
            case 0xC1 | 0xC2 | 0xC3 | 0xC4 | 0xC9:
                return self._recorder_command(command)
        raise Refused(0x81)

    def _require(self, wide: bool) -> None:
        if self._pointer != (4 if wide else 2):
            raise Refused(0x81)

    def _info(self) -> bytes:
        return bytes([3, int(self.big_endian), 1, 2, 0, self.mtu])

    def _write_v3(self, r: Reader, wide: bool) -> tuple[int, bytes]:
        size = r.u8()
        address = self._address(r, wide)
        self._check(address, size, write=True)
        data = r.take(size)
        self.poke(address, data)
        if self.on_write is not None:
            self.on_write(address, data)
        return 0, b""

    def _set_up_recorder(self, r: Reader, wide: bool) -> tuple[int, bytes]:
        mode, total, post, divide = r.u8(), self._number(r, 2), self._number(r, 2), self._number(r, 2)
        address, size, compare = self._address(r, wide), r.u8(), r.u8()
        threshold = self._number(r, 4)
        slots = self._list(r, wide)
        recorder = self.recorders[0]
        if not 0 < total <= recorder.size // sum(s for _, s in slots):
            raise Refused(0x86)
        recorder.set_up(len(slots) + 1, total, total - 1 - post, divide)
        recorder.slots = [RecorderSlot(a, s) for a, s in slots]
        kind = {0: 1, 1: 2, 3: 3}[compare]
        if kind == 2 and threshold >> 31:
            threshold -= 1 << 32
        flags = kind | 0x04 | {0: 0, 1: 0x10, 2: 0x20}[mode]
        recorder.slots.append(RecorderSlot(address, size, flags, threshold))
        recorder.configured, recorder.state = True, 1
        return 0, b""

    def _recorder_command(self, command: int) -> tuple[int, bytes]:
        recorder = self.recorders[0] if self.recorders else None
        if recorder is None or not recorder.configured:
            raise Refused(0x88)
        running = recorder.state == RUNNING
        match command:
            case 0xC1:
                recorder.start()
                return int(running), b""
            case 0xC2:
                recorder.fire()
                return 0 if running else 2, b""
            case 0xC3:
                return 1 if running else 2, b""
        self._require(command == 0xC9)
        if running:
            raise Refused(0x87)
        return 0, self._bytes(recorder.address, self._pointer) + self._bytes(recorder.first, 2)
