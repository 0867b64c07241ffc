"""FreeMASTER frames of both versions: checksum, doubling of the start byte, LEB128 numbers, parser of responses.

Functions and one state machine, without timing and ports.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from servo_bridge.freemaster.errors import CodecError, Status

SOB: Final = 0x2B
"""Start of block, '+'. Later bytes of this value are doubled."""

MAX_ANSWER_DATA: Final = 252
"""Largest number of data bytes in a response on a serial line."""

_MAX_PAYLOAD: Final = 253  # length 254 is refused, 255 is ignored without a response
_NUMBER_MASK: Final = (1 << 64) - 1


def _crc_table() -> bytes:
    """CRC-8, polynomial x^8 + x^2 + x + 1, most significant bit first."""
    table = bytearray()
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ (0x107 if value & 0x80 else 0)
        table.append(value)
    return bytes(table)


_CRC_TABLE: Final = _crc_table()


def crc8(data: bytes) -> int:
    """CRC-8 of `data`."""
    crc = 0
    for byte in data:
        crc = _CRC_TABLE[crc ^ byte]
    return crc


def negated_sum(data: bytes) -> int:
    """Byte that makes the sum of `data` and this byte zero."""
    return -sum(data) & 0xFF


@dataclass(frozen=True)
class Framing:
    """Frame format of one version of the protocol."""

    checksum: Callable[[bytes], int]  # last byte of a frame, computed from all bytes after the start byte
    fast_from: int  # commands with codes from here on have no length byte; the length is in the code
    plain_statuses: tuple[int, ...] = ()  # success codes other than zero, without data

    def encode(self, command: int, payload: bytes = b"") -> bytes:
        """Encode a request for the line.

        Raises
        ------
        CodecError
            If the command code or the length cannot be sent.
        """
        if not 0 <= command <= 0xFF or command == SOB:
            raise CodecError(f"command code {command:#x} cannot be sent")
        if len(payload) > _MAX_PAYLOAD:
            raise CodecError(f"{len(payload)} bytes of payload; at most {_MAX_PAYLOAD} fit a frame")
        if command >= self.fast_from:
            if len(payload) != 2 * (command >> 4 & 3):
                raise CodecError(f"{len(payload)} bytes of payload do not go with the command code {command:#x}")
            body = bytes((command,)) + payload
        else:
            body = bytes((command, len(payload))) + payload
        return self._frame(body)

    def answer(self, status: int, data: bytes) -> bytes:
        """Encode a response for the line."""
        length = bytes((len(data),)) if status == Status.OK_VARIABLE else b""
        return self._frame(bytes((status,)) + length + data)

    def _frame(self, body: bytes) -> bytes:
        return b"+" + (body + bytes((self.checksum(body),))).replace(b"+", b"++")

    def intact(self, body: bytes) -> bool:
        """Whether a frame without its start byte ends with the correct checksum."""
        return self.checksum(body[:-1]) == body[-1]

    def can_start(self, status: int) -> bool:
        """Whether a byte after a start byte can be a status.

        Other bytes are noise or, on single-wire hardware, the echo of a request. Debug builds send frames with status
        A9 before their first request; these are ignored.
        """
        if status & Status.ERROR_BIT:
            return status not in (Status.DEBUG_FRAME, 0xFF)
        return status in (Status.OK, Status.OK_VARIABLE) or status in self.plain_statuses


V4: Final = Framing(crc8, 0x100)
V3: Final = Framing(negated_sum, 0xC0, (Status.RECORDER_RUNNING, Status.RECORDER_STOPPED))


def encode_uleb(value: int) -> bytes:
    """Encode unsigned LEB128 in the shortest form.

    Raises
    ------
    CodecError
        If `value` is negative.
    """
    if value < 0:
        raise CodecError(f"{value} is negative")
    out = bytearray()
    while value > 0x7F:
        out.append(0x80 | (value & 0x7F))
        value >>= 7
    out.append(value)
    return bytes(out)


def encode_sleb(value: int) -> bytes:
    """Encode signed LEB128 in the shortest form."""
    out = bytearray()
    while not -0x40 <= value < 0x40:
        out.append(0x80 | (value & 0x7F))
        value >>= 7
    out.append(value & 0x7F)
    return bytes(out)


def decode_uleb(data: bytes, start: int = 0) -> tuple[int, int]:
    """Decode unsigned LEB128; padded forms are accepted, bits beyond 64 are dropped.

    Returns
    -------
    value, end : int
        The number, and the index of the next byte.

    Raises
    ------
    CodecError
        If the data end inside the number.
    """
    value = shift = 0
    for index in range(start, len(data)):
        value |= (data[index] & 0x7F) << shift
        shift += 7
        if not data[index] & 0x80:
            return value & _NUMBER_MASK, index + 1
    raise CodecError("number is cut off")


@dataclass(frozen=True)
class Answer:
    """Intact response: status byte, and data without length and checksum."""

    status: int
    data: bytes

    @property
    def is_error(self) -> bool:
        """Whether the target refused the request."""
        return bool(self.status & Status.ERROR_BIT)


class AnswerParser:
    """Finds one response in a stream of bytes.

    Parameters
    ----------
    fixed_size : int
        Data bytes of a success response without length byte.
    framing : Framing
        Version of the protocol.
    statuses : tuple of int, optional
        Expected success codes; others are skipped. Default: all.
    """

    def __init__(self, fixed_size: int = 0, framing: Framing = V4, statuses: tuple[int, ...] | None = None) -> None:
        self._fixed_size = fixed_size
        self._framing = framing
        self._statuses = statuses
        self._pending_sob = False
        self._body: bytearray | None = None  # from the status byte on; None: searching for a start
        self.crc_errors = 0  # complete frames with a wrong checksum
        self.passed_over = 0  # intact frames that cannot be the response
        self.trailing = False  # bytes followed the response directly: the line has inserted a byte

    def feed(self, chunk: bytes) -> Answer | None:
        """Process received bytes; returns the first intact response and drops the remainder of `chunk`."""
        segments = chunk.split(b"+")
        for index, segment in enumerate(segments):
            if index:
                self._pending_sob = not self._pending_sob
                if not self._pending_sob:
                    answer = self._take(b"+")
                    if answer is not None:
                        self.trailing |= bool(segment) or index + 1 < len(segments)
                        return answer
            if not segment:
                continue
            if self._pending_sob:
                self._pending_sob = False
                self._body = bytearray() if self._framing.can_start(segment[0]) else None
            answer = self._take(segment)
            if answer is not None:
                self.trailing |= index + 1 < len(segments)
                return answer
        return None

    def _take(self, data: bytes) -> Answer | None:
        if self._body is None:
            return None
        self._body += data
        size = self._size_of_body()
        if size is None or len(self._body) < size:
            return None
        excess, body, self._body = len(self._body) - size, bytes(self._body[:size]), None
        if not self._framing.intact(body):
            self.crc_errors += 1
            return None
        if self._statuses is not None and body[0] not in self._statuses and not body[0] & Status.ERROR_BIT:
            self.passed_over += 1
            return None
        self.trailing = excess > 0
        return Answer(body[0], body[2:-1] if body[0] == Status.OK_VARIABLE else body[1:-1])

    def _size_of_body(self) -> int | None:
        """Bytes from status to checksum; None before the length byte."""
        assert self._body is not None
        status = self._body[0]
        if status & Status.ERROR_BIT or status in self._framing.plain_statuses:
            return 2
        if status & Status.VARIABLE_BIT:
            return self._body[1] + 3 if len(self._body) > 1 else None
        return self._fixed_size + 2
