"""Hostile input to a server built with sanitizers: it never crashes and writes only what may be written."""

from __future__ import annotations

import os
import select
import struct
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest
from firmware_compiler import CompileProgram, has_library
from freemaster_model import (
    ENTRIES,
    MEMORY_SIZE,
    SERVO,
    Layout,
    examples,
    initial_memory,
    parse_answer,
    request,
    sleb,
    uleb,
)
from freemaster_recorder import START, STOP, memory, variable
from hypothesis import given
from hypothesis import strategies as st

TIME_LIMIT = 30.0  # seconds; an answer takes microseconds
CODES = (
    0x20, 0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x2C, 0x2D, 0x2F, 0x30, 0x31, 0x32, 0x33
)  # fmt: skip
READ_ONLY = [offset for offset in range(MEMORY_SIZE) if not SERVO.writable(SERVO.variables + offset, 1)]


class Server:
    """A server in a process of its own, so that a sanitizer may end it."""

    def __init__(self, program: Path, errors: IO[bytes]) -> None:
        self._errors = errors
        options = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1"}
        self._process = subprocess.Popen(
            [str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, env=options
        )

    def close(self) -> int:
        """End the process; returns its exit code."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        code = self._process.wait(TIME_LIMIT)
        self._process.stdout.close()
        return code

    def fresh(self) -> None:
        """Begin again with a new server."""
        self._write(b"\xff\xff")

    def send(self, data: bytes) -> bytes:
        """Bytes to the server, byte by byte; returns its bytes after checking the application's memory."""
        self._write(struct.pack("<H", len(data)) + data)
        (size,) = struct.unpack("<H", self._read(2))
        sent = self._read(size)
        memory = self._read(MEMORY_SIZE)
        (violations,) = struct.unpack("<H", self._read(2))
        assert violations == 0
        before = initial_memory()
        assert [memory[i] for i in READ_ONLY] == [before[i] for i in READ_ONLY]
        return sent

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(data)
            self._process.stdin.flush()
        except BrokenPipeError:
            self._fail()

    def _read(self, size: int) -> bytes:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        data = b""
        while len(data) < size:
            ready, _, _ = select.select([pipe], [], [], TIME_LIMIT)
            assert ready, "the server hangs"
            part = os.read(pipe, size - len(data))
            if not part:
                self._fail()
            data += part
        return data

    def _fail(self) -> None:
        self._errors.seek(0)
        raise AssertionError(f"the server has died:\n{self._errors.read().decode(errors='replace')}")


@pytest.fixture(scope="module")
def server(
    compile_program: CompileProgram, freemaster_sources: Callable[[Layout], list[str | Path]]
) -> Iterator[Server]:
    if not has_library("gcc", "libasan.so") or not has_library("gcc", "libubsan.so"):
        pytest.skip("gcc has no sanitizers")
    program = compile_program(
        "freemaster_pipe",
        [*freemaster_sources(SERVO), "test/freemaster_pipe.c"],
        options=["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"],
        defines=SERVO.defines,
    )
    with tempfile.TemporaryFile() as errors:
        server = Server(program, errors)
        yield server
        assert server.close() == 0


ADDRESS = st.one_of(
    st.builds(
        lambda entry, shift: SERVO.address(entry) + shift,
        st.sampled_from([entry for entry in ENTRIES if not entry.absolute]),
        st.integers(-2, 66),
    ),
    st.sampled_from([0, 2**32 - 1, 2**31, SERVO.table, SERVO.table + 16 * len(ENTRIES) - 1]),
    st.sampled_from([SERVO.samples, SERVO.samples + 1000]),
    st.integers(SERVO.strings - 2, SERVO.strings + len(SERVO.blob) + 2),
    st.integers(0, 2**40),
)
SIZE = st.one_of(st.integers(0, 20), st.integers(0, 300), st.sampled_from([2**16, 2**31, 2**32 - 1, 2**32 + 2]))
FIELD = st.one_of(
    st.builds(uleb, ADDRESS, st.integers(0, 2)),
    st.builds(uleb, SIZE),
    st.builds(sleb, st.integers(-(2**33), 2**33)),
    st.binary(max_size=12),
    st.sampled_from([b"\x00", b"\x01", b"\x02", b"MTU\0", b"\x01\x01\x18", b"\x01\x01\x02"]),
    st.builds(
        lambda slot, address, size: b"\x02" + bytes([len(uleb(address)) + 2, slot]) + uleb(address) + bytes([size]),
        st.integers(0, 25),
        ADDRESS,
        st.sampled_from([1, 2, 3, 4, 8, 255]),
    ),
)
READING = st.builds(lambda address, size: (0x21, uleb(address) + uleb(size)), ADDRESS, SIZE)
RECORDING = st.builds(
    lambda recorder, operations: (0x24, (bytes([recorder]) + b"".join(operations))[:252]),
    st.integers(0, 2),
    st.lists(
        st.one_of(
            st.builds(memory, st.integers(0, 9), SIZE, SIZE, st.integers(0, 3)),
            st.builds(
                variable, st.integers(0, 8), ADDRESS, st.sampled_from([1, 2, 4, 8, 3]), st.integers(0, 255), FIELD
            ),
            st.builds(
                lambda entry, mode, size: memory(1) + variable(0, SERVO.address(entry), size, mode) + START,
                st.sampled_from([entry for entry in ENTRIES if not entry.absolute]),
                st.sampled_from([0, 0x11, 0x31, 0x52, 0x72]),
                st.sampled_from([1, 2, 4, 8]),
            ),
            st.sampled_from([START, STOP]),
        ),
        max_size=6,
    ),
)
WRITING = st.builds(
    lambda flags, address, size, data: (0x23, bytes([flags]) + uleb(address) + uleb(size) + data),
    st.integers(0, 1),
    ADDRESS,
    SIZE,
    st.binary(max_size=60),
)
COMMAND = st.one_of(
    st.tuples(st.sampled_from(CODES), st.lists(FIELD, max_size=6).map(lambda parts: b"".join(parts)[:252])),
    READING,
    RECORDING,
    WRITING,
    st.just((0x27, b"\x00")),
)


def damage(frames: bytes, places: list[tuple[int, int]]) -> bytes:
    """Change some bytes."""
    data = bytearray(frames)
    for place, value in places:
        data[place % len(data)] = value
    return bytes(data)


@given(data=st.binary(max_size=2000))
@examples(150)
def test_random_bytes(server: Server, data: bytes) -> None:
    server.fresh()
    server.send(data)


@given(tokens=st.lists(st.sampled_from([b"\x2b", b"\x2b\x2b", b"\x21", b"\x23", b"\x00", b"\x27", b"\xfe", b"\xff"])))
@examples(150)
def test_sequences_of_special_bytes(server: Server, tokens: list[bytes]) -> None:
    server.fresh()
    server.send(b"".join(tokens))


@given(commands=st.lists(COMMAND, min_size=1, max_size=12))
@examples(400)
def test_any_well_formed_request_gets_one_answer(server: Server, commands: list[tuple[int, bytes]]) -> None:
    server.fresh()
    for code, payload in commands:
        parse_answer(server.send(request(code, payload)))


@given(
    commands=st.lists(COMMAND, min_size=1, max_size=4),
    places=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), min_size=1, max_size=4),
)
@examples(200)
def test_damaged_requests(server: Server, commands: list[tuple[int, bytes]], places: list[tuple[int, int]]) -> None:
    server.fresh()
    server.send(damage(b"".join(request(code, payload) for code, payload in commands), places))
    # Two requests bring any receiver back: the first may be taken for the rest of a frame.
    server.send(request(0x20, b"\x01"))
    assert parse_answer(server.send(request(0x20, b"\x01"))).data == b"MTU\0" + uleb(SERVO.mtu)
