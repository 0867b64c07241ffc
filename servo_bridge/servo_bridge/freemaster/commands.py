"""FreeMASTER v4 commands: encoding of requests and decoding of responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from servo_bridge.freemaster.errors import CodecError
from servo_bridge.freemaster.frames import MAX_ANSWER_DATA, V4, Framing, decode_uleb, encode_uleb

SCOPE_SIZES: Final = (1, 2, 4, 8)
"""Sizes of a scope slot [bytes]."""

COMMAND_RUNNING: Final = 0xFE
COMMAND_IDLE: Final = 0xFF

NO_PASSWORD: Final = 0
SHA1_PASSWORD: Final = 1
"""Password algorithms of a target."""

_OP_SCOPE_RESET: Final = 0x01
_OP_SCOPE_SLOT: Final = 0x02


class Command:
    """Command codes of version 4."""

    GETCONFIG: Final = 0x20
    READMEM: Final = 0x21
    WRITEMEM: Final = 0x23
    SETREC: Final = 0x24
    GETREC: Final = 0x25
    SETSCOPE: Final = 0x26
    READSCOPE: Final = 0x27
    PIPE: Final = 0x28
    GETTSAINFO: Final = 0x29
    GETSTRLEN: Final = 0x2A
    AUTH1: Final = 0x2C
    AUTH2: Final = 0x2D
    SENDAPPCMD: Final = 0x30
    GETAPPCMDSTS: Final = 0x31
    GETAPPCMDDATA: Final = 0x32


@dataclass(frozen=True)
class Request:
    """One request."""

    name: str  # for error messages
    command: int  # command code
    payload: bytes  # payload before doubling
    answer_size: int | None  # data bytes of the response; None: the response has a length byte
    idempotent: bool = True  # may be repeated after a lost response
    framing: Framing = V4  # version of the protocol
    statuses: tuple[int, ...] = ()  # additional success codes, without data
    lengthy: bool = False
    """Wait for the response with the full timeout: the target may need time, or a repeated request would be executed
    twice."""
    frame: bytes = field(init=False)  # the bytes on the line

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame", self.framing.encode(self.command, self.payload))

    @property
    def patient(self) -> bool:
        """Whether the response needs the full timeout."""
        return self.lengthy or not self.idempotent

    @property
    def answer_limit(self) -> int:
        """Length on the line of the longest possible response [bytes]: every byte but the first doubled."""
        data = MAX_ANSWER_DATA + 1 if self.answer_size is None else self.answer_size
        return 2 * (data + 2) + 1


@dataclass(frozen=True)
class ScopeSlot:
    """Variable of the scope."""

    address: int
    size: int


@dataclass(frozen=True)
class TsaTable:
    """Location of a table of variables; address 0 ends the list of tables."""

    version: int  # format of the entries: 2 or 3
    field_size: int  # bytes of each of the four fields of an entry
    size: int  # bytes of the table
    address: int  # of its first byte


def get_config(key: str) -> Request:
    """Read a configuration value by its name of up to three characters."""
    return Request(f"GETCONFIG {key}", Command.GETCONFIG, b"\x00" + key.encode("ascii") + b"\x00", None)


def parse_config(key: str, data: bytes) -> bytes:
    """Extract the value after the repeated key.

    Raises
    ------
    CodecError
        If the response is for another key.
    """
    prefix = key.encode("ascii") + b"\x00"
    if not data.startswith(prefix):
        raise CodecError(f"response to GETCONFIG {key} is for {data[:4]!r}")
    return data[len(prefix) :]


def read_memory(address: int, size: int) -> Request:
    """Read `size` bytes."""
    payload = encode_uleb(address) + encode_uleb(size)
    return Request(f"READMEM {size} bytes at 0x{address:X}", Command.READMEM, payload, size)


def write_memory(address: int, data: bytes, mask: bytes | None = None, *, lengthy: bool = False) -> Request:
    """Write bytes; with a mask only the bits set in it."""
    if mask is not None and len(mask) != len(data):
        raise CodecError(f"mask of {len(mask)} bytes for {len(data)} bytes of data")
    payload = bytes((mask is not None,)) + encode_uleb(address) + encode_uleb(len(data)) + data + (mask or b"")
    return Request(f"WRITEMEM {len(data)} bytes at 0x{address:X}", Command.WRITEMEM, payload, 0, lengthy=lengthy)


def set_scope(slots: Sequence[ScopeSlot], *, scope: int = 0, payload_limit: int = MAX_ANSWER_DATA) -> list[Request]:
    """Set up the scope in as few frames as possible.

    Parameters
    ----------
    slots : sequence of ScopeSlot
        Variables in the order in which the answers will carry them; empty switches the scope off.
    scope : int
        Variables in the order of the response; empty: scope off.
    payload_limit : int
        Largest payload of the target [bytes].

    Raises
    ------
    CodecError
        If the size of a slot is not supported.
    """
    head = bytes((scope,))
    payloads = [head + bytes((_OP_SCOPE_RESET, 1, len(slots)))]
    for index, slot in enumerate(slots):
        if slot.size not in SCOPE_SIZES:
            raise CodecError(f"{slot.size} bytes do not fit a scope slot; permitted are 1, 2, 4 or 8")
        body = bytes((index,)) + encode_uleb(slot.address) + bytes((slot.size,))
        operation = bytes((_OP_SCOPE_SLOT, len(body))) + body
        if len(payloads[-1]) + len(operation) > payload_limit:
            payloads.append(head)
        payloads[-1] += operation
    return [Request(f"SETSCOPE {len(slots)} slots", Command.SETSCOPE, payload, 0, lengthy=True) for payload in payloads]


def read_scope(size: int, *, scope: int = 0) -> Request:
    """Read all slots, `size` bytes in total."""
    return Request("READSCOPE", Command.READSCOPE, bytes((scope,)), size)


def get_tsa_info(index: int) -> Request:
    """Read the location of table `index`."""
    return Request(f"GETTSAINFO {index}", Command.GETTSAINFO, encode_uleb(index), None)


def parse_tsa_info(data: bytes) -> TsaTable:
    """Decode the location of a table.

    Raises
    ------
    CodecError
        If the response is cut off, or has an undefined width of the entries.
    """
    if not data:
        raise CodecError("empty response to GETTSAINFO")
    size, end = decode_uleb(data, 1)
    address, _ = decode_uleb(data, end)
    width = data[0] >> 4 & 3
    if width == 3 and address:
        raise CodecError(f"table flags {data[0]:02X} have no valid width of the entries")
    return TsaTable(data[0] & 0x0F, 2 << width, size, address)


def get_string_length(address: int) -> Request:
    """Read the length of the text at `address`."""
    return Request(f"GETSTRLEN 0x{address:X}", Command.GETSTRLEN, encode_uleb(address), None)


def parse_size(data: bytes) -> int:
    """Decode a response with one number."""
    return decode_uleb(data)[0]


def send_command(code: int, arguments: bytes = b"", *, repeatable: bool = False) -> Request:
    """Start an application command; `repeatable`: it is quick, and harmless if executed twice."""
    if not 0 <= code < COMMAND_IDLE:
        raise CodecError(f"application command {code} is not 0 .. 254")
    return Request(f"SENDAPPCMD {code}", Command.SENDAPPCMD, bytes((code,)) + arguments, 0, idempotent=repeatable)


def get_command_status(*, repeatable: bool = False) -> Request:
    """Read the result of the last application command, which some targets execute only now; see `send_command`."""
    return Request("GETAPPCMDSTS", Command.GETAPPCMDSTS, b"", 1, lengthy=not repeatable)


def get_command_data(size: int, offset: int = 0) -> Request:
    """Read result data of the last application command."""
    return Request("GETAPPCMDDATA", Command.GETAPPCMDDATA, encode_uleb(size) + encode_uleb(offset), None)


def exchange_pipe(payload: bytes) -> Request:
    """Exchange bytes with a pipe; because of the toggle bit in the payload a repetition is harmless."""
    return Request(f"PIPE {payload[0] & 0x7F}", Command.PIPE, payload, None)


def begin_login(level: int) -> Request:
    """Read the salt for a login to a level; the target generates a new one each time."""
    return Request(f"AUTH1 level {level}", Command.AUTH1, bytes((level,)), None, idempotent=False)


def finish_login(level: int, key: bytes) -> Request:
    """Send the password key; the response is the granted level."""
    return Request(f"AUTH2 level {level}", Command.AUTH2, bytes((level,)) + key, 1, idempotent=False)
