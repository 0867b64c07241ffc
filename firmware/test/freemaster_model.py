"""Independent reference of the FreeMASTER server in Python: protocol, table and access rules."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

from hypothesis import settings

SOB = 0x2B
NONE, RO, FLASH, RW = range(4)

COMM_SOURCES = tuple(
    f"comm/{name}.c"
    for name in (
        "access",
        "app_command",
        "getconfig",
        "crc8",
        "frame",
        "freemaster",
        "leb128",
        "payload",
        "pipe",
        "recorder",
        "recorder_take",
        "scope",
        "sha1",
        "tsa",
    )
)


def examples(count: int) -> settings:
    """Number of examples of a property; the same examples in every run."""
    return settings(max_examples=count, derandomize=True, deadline=None, database=None)


# ---- wire ----------------------------------------------------------------------------------------------------------


def crc8(data: bytes) -> int:
    """CRC-8, polynomial 0x07, bit by bit."""
    crc = 0
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (crc >> 7) ^ (byte >> bit & 1)
            crc = (crc << 1 & 0xFF) ^ (0x07 if feedback else 0)
    return crc


def uleb(value: int, padding: int = 0) -> bytes:
    """Unsigned LEB128, optionally with `padding` superfluous bytes."""
    groups = [value >> shift & 0x7F for shift in range(0, max(value.bit_length(), 1), 7)] + [0] * padding
    return bytes(group | 0x80 for group in groups[:-1]) + bytes(groups[-1:])


def sleb(value: int) -> bytes:
    """Signed LEB128, shortest form."""
    size = 1
    while not -(1 << 7 * size - 1) <= value < 1 << 7 * size - 1:
        size += 1
    groups = [value >> 7 * i & 0x7F for i in range(size)]
    return bytes(group | 0x80 for group in groups[:-1]) + bytes(groups[-1:])


def double(body: bytes) -> bytes:
    """Frame of a body on the wire: start byte, then every 2B doubled."""
    return bytes([SOB]) + body.replace(b"\x2b", b"\x2b\x2b")


def request(code: int, payload: bytes = b"") -> bytes:
    """Request frame as it goes over the wire."""
    body = bytes([code, len(payload)]) + payload
    return double(body + bytes([crc8(body)]))


def answer(status: int, data: bytes = b"") -> bytes:
    """Answer frame as it goes over the wire."""
    body = bytes([status, len(data)]) + data if status == 0x40 else bytes([status]) + data
    return double(body + bytes([crc8(body)]))


@dataclass(frozen=True)
class Answer:
    """One parsed answer."""

    status: int
    data: bytes = b""


def parse_answer(wire: bytes) -> Answer:
    """Parse one complete answer; ValueError otherwise."""
    if len(wire) < 3 or wire[0] != SOB:
        raise ValueError(f"no frame: {wire.hex(' ')}")
    body = wire[1:].replace(b"\x2b\x2b", b"\x2b")
    if double(body) != wire:
        raise ValueError(f"wrong doubling: {wire.hex(' ')}")
    if crc8(body[:-1]) != body[-1]:
        raise ValueError(f"wrong checksum: {wire.hex(' ')}")
    status, data = body[0], body[1:-1]
    if status == 0x40:
        if len(data) != 1 + data[0]:
            raise ValueError(f"wrong length: {wire.hex(' ')}")
        data = data[1:]
    elif status != 0 and (status < 0x80 or data):
        raise ValueError(f"wrong status: {wire.hex(' ')}")
    return Answer(status, data)


# ---- table of the server -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """One entry of the table.

    `at` is an offset in the memory or, if `live`, in the region of the loops' variables; or the value itself when no
    memory is behind it.
    """

    name: str
    type: bytes
    at: int
    size: int
    kind: int
    absolute: bool = False
    live: bool = False


# The addresses of the first entries are those of the protocol's byte examples.
ENTRIES = (
    Entry("M.var_u16", b"\xe1", 0x20, 2, RW),
    Entry("M.var_i32", b"\xf2", 0x24, 4, RW),
    Entry("M.const_u16", b"\xe1", 0x2A, 2, RO),
    Entry("M.counter", b"\xe2", 0x38, 4, RO),
    Entry("M.ramp", b"\xf1", 0x3C, 2, RW),
    Entry("M.plus", b"\xe1", 0x40, 2, RW),
    Entry("M.var_u8", b"\xe0", 0x42, 1, RW),
    Entry("M.var_i8", b"\xf0", 0x43, 1, RW),
    Entry("M.snapshot", b"\xe0", 0x54, 16, RO),  # covers the next four
    Entry("M.word0", b"\xf5", 0x54, 2, RW),
    Entry("M.word1", b"\xf5", 0x56, 2, RW),
    Entry("M.pair", b"\xf2", 0x58, 8, RW),
    Entry("M.word6", b"\xf5", 0x60, 4, RO),
    Entry("M.limit", b"\xf1", 0x66, 2, RW),
    Entry("M.float", b"\xfa", 0x6C, 4, RW),
    Entry("M.bytes", b"\xe0", 0x70, 64, RW),
    Entry("M.q16_16", b"\xf4:15.16", 0xB8, 4, RW),
    Entry("M.frac32", b"\xf6", 0xBC, 4, RW),
    Entry("M.in_flash", b"\xe2", 0xC0, 4, FLASH),
    Entry("M.wide", b"\xf3", 0xC8, 8, RW),
    Entry("M.large", b"\xe0", 0x100, 300, RW),
    Entry("M.mode", b"mode_t", 0xD0, 2, RW),
    Entry("mode_t", b"\xed:ENUM", 0, 2, NONE, absolute=True),
    Entry("SPEED", b"\xed:CONST", 1, 0, NONE, absolute=True),
    Entry("M", b"\xed:DIR", 0xD8, 8, RW),  # a directory gives no access to memory, independent of its entry
    Entry("M.member", b"\xe1", 0xE0, 2, NONE),
    Entry("M.beyond", b"\xe2", 0x22E, 4, RW),  # an invalid entry: half of it is beyond the memory
    Entry("M.last", b"\xe1", 0x22E, 2, RW),
    Entry("L.word", b"\xf1", 0, 2, RO, live=True),
    Entry("L.long", b"\xf2", 4, 4, RO, live=True),
    Entry("L.beyond", b"\xe2", 8, 4, RO, live=True),
)
MEMORY_SIZE = 0x230
LIVE_SIZE = 32

SOURCES = {"L.word": 6, "L.long": 12, "L.beyond": 30, "M.word0": 2, "M.wide": 16}
"""Sources of variables in the memory of the loops; half of one source is beyond that memory."""

SAMPLES = 1024
"""Bytes of the recorders."""


def initial_memory() -> bytes:
    """Memory content with the values of the byte examples, all other bytes different from their neighbours."""
    memory = bytearray(7 * i + 1 & 0xFF for i in range(MEMORY_SIZE))
    memory[0x20:0x22] = struct.pack("<H", 0x1234)
    memory[0x24:0x28] = struct.pack("<i", -2)
    memory[0x2A:0x2C] = struct.pack("<H", 0xBEEF)
    memory[0x40:0x42] = b"\x2b\x2b"
    return bytes(memory)


@dataclass(frozen=True)
class Layout:
    """Addresses of the regions and size of the message buffer."""

    name: str
    variables: int
    strings: int
    table: int
    mtu: int
    live: int = 0x0030_0000
    samples: int = 0x0040_0000

    @property
    def defines(self) -> tuple[str, ...]:
        """Preprocessor definitions that build the server for this layout."""
        return (
            f"TSA_VARIABLES_BASE=UINT32_C({self.variables:#x})",
            f"TSA_STRINGS_BASE=UINT32_C({self.strings:#x})",
            f"TSA_TABLE_BASE=UINT32_C({self.table:#x})",
            f"TSA_LIVE_BASE=UINT32_C({self.live:#x})",
            f"TSA_SAMPLES_BASE=UINT32_C({self.samples:#x})",
            f"FRAME_MTU={self.mtu}",
        )

    @property
    def data_max(self) -> int:
        """Largest answer."""
        return min(self.mtu, 252)

    @cached_property
    def blob(self) -> bytes:
        """Names and types, each string once."""
        strings = [part for entry in ENTRIES for part in (entry.name.encode(), entry.type)]
        return b"".join(part + b"\0" for part in dict.fromkeys(strings))

    def string_offset(self, text: bytes) -> int:
        """Offset of a string in the blob."""
        return (b"\0" + self.blob).index(b"\0" + text + b"\0")

    def address(self, entry: Entry) -> int:
        """Address field of an entry."""
        if entry.absolute:
            return entry.at
        return (self.live if entry.live else self.variables) + entry.at

    def wire_table(self) -> bytes:
        """The table in the format that a client reads."""
        return b"".join(
            struct.pack(
                "<4I",
                self.strings + self.string_offset(entry.name.encode()),
                self.strings + self.string_offset(entry.type),
                self.address(entry),
                entry.size << 2 | entry.kind,
            )
            for entry in ENTRIES
        )

    def writable(self, address: int, size: int) -> bool:
        """Access rule for writing."""
        return self._in_entry(address, size, {RW})

    def readable(self, address: int, size: int) -> bool:
        """Access rule for reading."""
        if self._in_entry(address, size, {RO, FLASH, RW}):
            return True
        if self.table <= address and address + size <= self.table + 16 * len(ENTRIES):
            return True
        if address >= self.live and self.source(address, size) is not None:
            return True
        start = address - self.strings
        inside = start >= 0 and start + size <= len(self.blob)
        return inside and 0 not in self.blob[start : start + size]

    def source(self, address: int, size: int) -> int | None:
        """Offset of the source of a range in the memory of the loops."""
        for entry in ENTRIES:
            offset = address - self.address(entry)
            if entry.name in SOURCES and offset >= 0 and offset + size <= entry.size:
                place = SOURCES[entry.name] + offset
                return place if place + size <= LIVE_SIZE else None
        return None

    def recordable(self, address: int, size: int) -> bool:
        """Access rule for recorders."""
        return self.source(address, size) is not None or self._in_entry(address, size, {RO, FLASH, RW})

    def content(self, memory: bytes, live: bytes, address: int, size: int) -> bytes:
        """Bytes at a readable address."""
        source = self.source(address, size)
        if address >= self.live and source is not None:
            return live[source : source + size]
        for base, data in ((self.variables, memory), (self.strings, self.blob), (self.table, self.wire_table())):
            if base <= address <= base + len(data):
                return data[address - base : address - base + size]
        raise ValueError(f"nothing at {address:#x}")

    def _in_entry(self, address: int, size: int, kinds: set[int]) -> bool:
        end = address + size
        return any(
            entry.kind in kinds
            and not entry.live
            and not entry.type.startswith(b"\xed")
            and self.address(entry) <= address
            and end <= self.address(entry) + entry.size
            and self.variables <= address
            and end <= self.variables + MEMORY_SIZE
            for entry in ENTRIES
        )

    def c_source(self) -> str:
        """The same table and memory as C source."""
        rows = ",\n".join(
            f"    {{{self.string_offset(entry.name.encode())}, {self.string_offset(entry.type)}, "
            f"UINT32_C({self.address(entry):#x}), {entry.size}, {entry.kind}}}"
            for entry in ENTRIES
        )
        sources = ",\n".join(
            f"    {{UINT32_C({self.address(entry):#x}), {SOURCES[entry.name]}, {entry.size}}}"
            for entry in ENTRIES
            if entry.name in SOURCES
        )
        return (
            '#include "freemaster_harness.h"\n'
            f"static const uint8_t strings[] TABLE_MEMORY = {{{c_bytes(self.blob)}}};\n"
            f"static const tsa_entry_t entry[] TABLE_MEMORY = {{\n{rows}\n}};\n"
            f"static const tsa_source_t source[] TABLE_MEMORY = {{\n{sources}\n}};\n"
            "const tsa_table_t fixture_table = "
            f"{{entry, {len(ENTRIES)}, strings, sizeof strings, source, {len(SOURCES)}}};\n"
            f"const uint16_t fixture_live_size = {LIVE_SIZE};\n"
            f"const uint16_t fixture_memory_size = {MEMORY_SIZE};\n"
            f"const uint8_t fixture_memory[] = {{{c_bytes(initial_memory())}}};\n"
        )


def c_bytes(data: bytes) -> str:
    """Initialiser of a byte array."""
    return ", ".join(map(str, data))


SHEET = Layout("sheet", 0x2000_0000, 0x0804_F115, 0x2000_10E0, 240, 0x3000_0000, 0x2000_2080)  # as in the byte examples
SERVO = Layout("servo", 0x0000_1000, 0x0010_0000, 0x0020_0000, 254)  # as in the product
TINY = Layout("tiny", 0x0000_1000, 0x0010_0000, 0x0020_0000, 32)  # the smallest buffer
