"""FreeMASTER v3 commands: codes, and forms with 16-bit and 32-bit addresses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from servo_bridge.freemaster.commands import COMMAND_IDLE, Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.errors import CodecError
from servo_bridge.freemaster.frames import V3
from servo_bridge.freemaster.tsa import ByteOrder

INFO_SIZE: Final = 35
BRIEF_INFO_SIZE: Final = 6

_WIDE_TABLE: Final = 0x0100


def get_info() -> Request:
    """Read the identification; a target has this form or the brief one."""
    return Request("GETINFO", 0xC0, b"", INFO_SIZE, framing=V3)


def get_info_brief() -> Request:
    """Read the brief identification, without recorder memory, time base and description."""
    return Request("GETINFOBRIEF", 0xC8, b"", BRIEF_INFO_SIZE, framing=V3)


def exchange_pipe(payload: bytes) -> Request:
    """Exchange bytes with a pipe, as in version 4."""
    return Request(f"PIPE {payload[0] & 0x7F}", 0x15, payload, None, framing=V3)


@dataclass(frozen=True)
class MemoryForm:
    """Commands with addresses or numbers of the target."""

    order: ByteOrder = "little"  # byte order of the target and of the line
    wide: bool = True  # 32-bit instead of 16-bit addresses

    def _code(self, plain: int, wide: int) -> int:
        return wide if self.wide else plain

    def number(self, value: int, size: int) -> bytes:
        """Encode a number of the target.

        Raises
        ------
        CodecError
            If it does not fit.
        """
        try:
            return value.to_bytes(size, self.order)
        except OverflowError:
            raise CodecError(f"{value} does not fit {size} byte(s) of a version 3 request") from None

    def value(self, data: bytes) -> int:
        """Decode a number of the target."""
        return int.from_bytes(data, self.order)

    @property
    def address_size(self) -> int:
        """Bytes of an address."""
        return 4 if self.wide else 2

    def address(self, address: int) -> bytes:
        """Encode an address."""
        return self.number(address, self.address_size)

    def read_memory(self, address: int, size: int) -> Request:
        """Read `size` bytes."""
        payload = self.number(size, 1) + self.address(address)
        return Request(f"READMEM {size} bytes at 0x{address:X}", self._code(0x01, 0x04), payload, size, framing=V3)

    def write_memory(self, address: int, data: bytes, *, lengthy: bool = False) -> Request:
        """Write bytes."""
        name, code = f"WRITEMEM {len(data)} bytes at 0x{address:X}", self._code(0x02, 0x05)
        payload = self.number(len(data), 1) + self.address(address) + data
        return Request(name, code, payload, 0, framing=V3, lengthy=lengthy)

    def slots(self, slots: Sequence[ScopeSlot]) -> bytes:
        """Encode a list of variables for scope or recorder."""
        return self.number(len(slots), 1) + b"".join(self.number(s.size, 1) + self.address(s.address) for s in slots)

    def set_scope(self, slots: Sequence[ScopeSlot]) -> Request:
        """Set up the scope, in one frame."""
        return Request(
            f"SETUPSCOPE {len(slots)} slots", self._code(0x08, 0x0A), self.slots(slots), 0, framing=V3, lengthy=True
        )

    def read_scope(self, size: int) -> Request:
        """Read all slots, `size` bytes in total."""
        return Request("READSCOPE", 0xC5, b"", size, framing=V3)

    def get_tsa_info(self, index: int) -> Request:
        """Read the location of table `index`."""
        payload, size = self.number(index, 2), 4 + self.address_size
        return Request(f"GETTSAINFO {index}", self._code(0x11, 0x12), payload, size, framing=V3)

    def parse_tsa_info(self, data: bytes) -> TsaTable:
        """Decode the location of a table."""
        flags, size, address = self.value(data[:2]), self.value(data[2:4]), self.value(data[4:])
        return TsaTable(flags & 0x0F, 4 if flags & _WIDE_TABLE else 2, size, address)

    def get_string_length(self, address: int) -> Request:
        """Read the length of the text at `address`."""
        return Request(f"GETSTRLEN 0x{address:X}", self._code(0xD4, 0xE6), self.address(address), 2, framing=V3)

    def send_command(self, code: int, arguments: bytes, *, repeatable: bool = False) -> Request:
        """Start an application command; see `commands.send_command`."""
        if not 0 <= code < COMMAND_IDLE:
            raise CodecError(f"application command {code} is not 0 .. 254")
        return Request(f"SENDAPPCMD {code}", 0x10, bytes((code,)) + arguments, 0, idempotent=repeatable, framing=V3)

    def get_command_status(self, *, repeatable: bool = False) -> Request:
        """Read the result of the last application command; see `commands.get_command_status`."""
        return Request("GETAPPCMDSTS", 0xC6, b"", 1, framing=V3, lengthy=not repeatable)
