"""Bounded reading and writing: no access outside of the buffer, no partial fields."""

from __future__ import annotations

from typing import Any

import cffi
import pytest
from c_declarations import declarations
from firmware_compiler import CompileC
from freemaster_model import uleb

ROOM = 8


class Payload:
    """The C module with one reader and one writer."""

    def __init__(self, ffi: cffi.FFI, lib: Any, data: bytes) -> None:
        self.ffi = ffi
        self.lib = lib
        self._input = ffi.new("uint8_t[]", data or b"\0")
        self._output = ffi.new("uint8_t[]", b"\xee" * (ROOM + 4))
        self.reader = ffi.new("payload_reader_t *", {"data": self._input, "remaining": len(data)})
        self.writer = ffi.new("payload_writer_t *", {"data": self._output, "room": ROOM})

    def written(self) -> bytes:
        """Content of the writer; bytes beyond its space must be unchanged."""
        output = bytes(self.ffi.buffer(self._output))
        assert output[ROOM:].startswith(b"\xee" * 4)
        return output[: self.writer.size]


@pytest.fixture
def payload(compile_c: CompileC, request: pytest.FixtureRequest) -> Payload:
    """A payload of the bytes given by the test."""
    ffi, lib = compile_c("payload", ["comm/payload.c", "comm/leb128.c"], declarations("comm/payload.h"))
    return Payload(ffi, lib, getattr(request, "param", b""))


@pytest.mark.parametrize("payload", [b"\x07" + uleb(1000) + b"\x7e" + b"abc"], indirect=True)
def test_fields_are_read_in_order(payload: Payload) -> None:
    lib, reader = payload.lib, payload.reader
    assert lib.payload_get_u8(reader) == 7
    assert lib.payload_get_unsigned(reader) == 1000
    assert lib.payload_get_signed(reader) == -2
    assert payload.ffi.buffer(lib.payload_take(reader, 3), 3)[:] == b"abc"
    assert (reader.remaining, reader.missing) == (0, False)
    assert lib.payload_take(reader, 0) != payload.ffi.NULL, "zero bytes are always available"


@pytest.mark.parametrize("payload", [b"\x80\x80"], indirect=True)
@pytest.mark.parametrize("field", ["payload_get_unsigned", "payload_get_signed"])
def test_unterminated_number_is_an_error(payload: Payload, field: str) -> None:
    assert getattr(payload.lib, field)(payload.reader) == 0
    assert (payload.reader.remaining, payload.reader.missing) == (0, True)
    assert payload.lib.payload_get_u8(payload.reader) == 0, "nothing is read after a missing field"


@pytest.mark.parametrize("payload", [b"ab"], indirect=True)
@pytest.mark.parametrize("size", [3, 2**16, 2**16 + 1, 2**32 - 1])
def test_reading_beyond_the_payload_is_an_error(payload: Payload, size: int) -> None:
    assert payload.lib.payload_take(payload.reader, size) == payload.ffi.NULL
    assert payload.reader.missing


def test_a_full_writer_stays_full(payload: Payload) -> None:
    lib, writer = payload.lib, payload.writer
    lib.payload_put_unsigned(writer, 2**32 - 1)
    lib.payload_put_u8(writer, 9)
    assert lib.payload_reserve(writer, 3) == payload.ffi.NULL
    assert writer.full
    lib.payload_put_u8(writer, 9)
    assert payload.written() == uleb(2**32 - 1) + b"\x09"


@pytest.mark.parametrize("size", [ROOM + 1, 2**16, 2**16 + 1, 2**32 - 1])
def test_space_of_the_writer_is_limited(payload: Payload, size: int) -> None:
    assert payload.lib.payload_reserve(payload.writer, size) == payload.ffi.NULL
    assert payload.writer.full


def test_whole_space_of_the_writer_can_be_used(payload: Payload) -> None:
    assert payload.lib.payload_reserve(payload.writer, ROOM) != payload.ffi.NULL
    assert (payload.writer.size, payload.writer.full) == (ROOM, False)


@pytest.mark.parametrize(("text", "full"), [(b"", False), (b"7 chars", False), (b"8 charss", True), (b"x" * 300, True)])
def test_strings_are_written_with_their_terminator(payload: Payload, text: bytes, full: bool) -> None:
    payload.lib.payload_put_string(payload.writer, text)
    assert payload.writer.full == full
    assert payload.written() == (text + b"\0")[:ROOM]
