"""Python interface of the C harness: a FreeMASTER server with a serial line that the test controls."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from typing import Any

import cffi
from c_declarations import declarations
from freemaster_model import MEMORY_SIZE, Answer, Layout, parse_answer, request

LINE = 4096
EVENTS = 64

CDEF = declarations("freemaster_harness.h")

EVENT_NAMES = ("lock", "unlock", "written", "command")


@dataclass(frozen=True)
class Statistics:
    """Counters of the server."""

    requests: int
    refused: int
    bad_crc: int
    too_long: int
    aborted: int
    bytes_lost: int


class Board:
    """A server with its application."""

    def __init__(self, ffi: cffi.FFI, lib: Any, layout: Layout) -> None:
        self._ffi = ffi
        self._lib = lib
        self._harness = ffi.gc(lib.harness_new(), lib.harness_free)
        self.layout = layout

    def feed(self, data: bytes) -> None:
        """Send bytes to the server."""
        self._lib.harness_feed(self._harness, data, len(data))

    def poll(self) -> bytes:
        """Run the server once; return the bytes that it sent."""
        self._lib.harness_poll(self._harness)
        buffer = self._ffi.new("uint8_t[]", LINE)
        return bytes(self._ffi.buffer(buffer, self._lib.harness_take(self._harness, buffer)))

    def send(self, wire: bytes) -> bytes:
        """Send bytes, run the server once, return the bytes that it sent."""
        self.feed(wire)
        return self.poll()

    def ask(self, code: int, payload: bytes = b"") -> Answer:
        """Send a well-formed request and return its parsed answer."""
        return parse_answer(self.send(request(code, payload)))

    def set_put_room(self, size: int) -> None:
        """Set the number of bytes that the transmitter accepts per poll."""
        self._lib.harness_set_put_room(self._harness, size)

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """freemaster_read: status and data."""
        guard = b"\xee" * 8
        data = self._ffi.new("uint8_t[]", bytes(size) + guard)
        status = self._lib.harness_read(self._harness, address, data, size)
        assert bytes(self._ffi.buffer(data))[size:].startswith(guard), "wrote beyond the buffer"
        return int(status), bytes(self._ffi.buffer(data, size))

    def write(self, address: int, data: bytes, mask: bytes | None = None) -> int:
        """freemaster_write: status."""
        mask_or_null = self._ffi.NULL if mask is None else mask
        return int(self._lib.harness_write(self._harness, address, data, mask_or_null, len(data)))

    def set_refusing(self, refusing: bool) -> None:
        """Set whether the application refuses all writes."""
        self._lib.harness_set_refusing(self._harness, refusing)

    def memory(self) -> bytes:
        """Memory of the application."""
        buffer = self._ffi.new("uint8_t[]", MEMORY_SIZE)
        self._lib.harness_memory(self._harness, buffer)
        return bytes(self._ffi.buffer(buffer))

    def poke(self, offset: int, data: bytes) -> None:
        """Change the memory of the application."""
        self._lib.harness_poke(self._harness, offset, data, len(data))

    def poke_live(self, offset: int, data: bytes) -> None:
        """Change the memory of a control loop."""
        self._lib.harness_poke_live(self._harness, offset, data, len(data))

    def sample(self, recorder: int, times: int = 1) -> None:
        """Run the loop of a recorder."""
        for _ in range(times):
            self._lib.harness_sample(self._harness, recorder)

    def events(self) -> list[tuple[str, int, int]]:
        """Calls of the application since the last call of this method."""
        triples = self._ffi.new("uint16_t[]", 3 * EVENTS)
        count = self._lib.harness_events(self._harness, triples)
        return [(EVENT_NAMES[triples[3 * i]], triples[3 * i + 1], triples[3 * i + 2]) for i in range(count)]

    def set_passwords(self, *passwords: bytes | None) -> None:
        """Reset the server with passwords for the levels 1, 2, 3."""
        hashes = [self._ffi.NULL if text is None else hashlib.sha1(text).digest() for text in passwords]
        self._lib.harness_set_passwords(self._harness, *hashes)

    def finish(self, code: int, result: bytes = b"") -> None:
        """Complete a pending command in the application."""
        self._lib.harness_finish(self._harness, code, result, len(result))

    def print(self, text: bytes) -> None:
        """Print a text of the application on the console of the client."""
        self._lib.harness_print(self._harness, text, len(text))

    def level(self) -> int:
        """Present access level of the client."""
        return int(self._lib.harness_level(self._harness))

    def violations(self) -> int:
        """Number of calls of the application that violated its rules."""
        return int(self._lib.harness_violations(self._harness))

    def statistics(self) -> Statistics:
        """Counters of the server."""
        values = self._ffi.new("uint32_t[]", len(fields(Statistics)))
        self._lib.harness_statistics(self._harness, values)
        return Statistics(*values)
