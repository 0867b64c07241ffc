"""Random input to a server built with sanitizers: no crash, and writes to writable variables only.

``freemaster_fuzz.c`` checks answers and memory. Its inputs are those of this file, of the corpus, and those that
libFuzzer generates in some seconds, if it is installed.
"""

from __future__ import annotations

import os
import select
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NoReturn

import freemaster_fuzz
import pytest
from firmware_compiler import CompileProgram, has_library
from freemaster_fuzz import CORPUS, frame
from freemaster_model import ENTRIES, SERVO, examples, parse_answer, request, sleb, uleb
from freemaster_recorder import START, STOP, memory, variable
from hypothesis import given
from hypothesis import strategies as st

TIME_LIMIT = 30.0  # seconds; an answer takes microseconds
CODES = (
    0x20, 0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x2C, 0x2D, 0x2F, 0x30, 0x31, 0x32, 0x33
)  # fmt: skip


class Server:
    """Servers in a separate process, which a sanitizer may end."""

    def __init__(self, program: Path, errors: IO[bytes]) -> None:
        self._errors = errors
        options = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1"}
        self._process = subprocess.Popen(
            [str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, env=options
        )

    def close(self) -> int:
        """End the process; returns its exit code."""
        self._process.communicate(timeout=TIME_LIMIT)
        return self._process.returncode

    def run(self, data: bytes) -> bytes:
        """Send an input of the fuzzer to a new server; return the bytes sent after the last step."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(struct.pack("<H", len(data)) + data)
            self._process.stdin.flush()
        except BrokenPipeError:
            self._fail()
        (size,) = struct.unpack("<H", self._read(2))
        return self._read(size)

    def _read(self, size: int) -> bytes:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        data = b""
        while len(data) < size:
            ready, _, _ = select.select([pipe], [], [], TIME_LIMIT)
            assert ready, "the server does not respond"
            part = os.read(pipe, size - len(data))
            if not part:
                self._fail()
            data += part
        return data

    def _fail(self) -> NoReturn:
        self._errors.seek(0)
        raise AssertionError(f"the server process has ended:\n{self._errors.read().decode(errors='replace')}")


@pytest.fixture(scope="module")
def server(compile_program: CompileProgram, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    if not has_library("gcc", "libasan.so") or not has_library("gcc", "libubsan.so"):
        pytest.skip("gcc has no sanitizers")
    program = compile_program(
        "freemaster_replay",
        freemaster_fuzz.sources(tmp_path_factory.mktemp("table")),
        options=["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"],
        defines=[*SERVO.defines, "FUZZ_REPLAY"],
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


def raw(data: bytes) -> bytes:
    """Steps that send bytes one by one, so that every contained frame is answered; each step with a sample."""
    return b"".join(bytes([0, 1, byte, 4, 2, 0, 1]) for byte in data)


SAMPLES = bytes([4, 32]) + bytes([0, 1] * 16)  # the loops run between two frames


def frames(commands: list[tuple[int, bytes]]) -> bytes:
    return b"".join(SAMPLES + frame(code, payload) for code, payload in commands)


@given(data=st.binary(max_size=2000))
@examples(150)
def test_random_bytes_break_no_rule(server: Server, data: bytes) -> None:
    server.run(b"\0" + raw(data))


@given(tokens=st.lists(st.sampled_from([b"\x2b", b"\x2b\x2b", b"\x21", b"\x23", b"\x00", b"\x27", b"\xfe", b"\xff"])))
@examples(150)
def test_sequences_of_special_bytes_break_no_rule(server: Server, tokens: list[bytes]) -> None:
    server.run(b"\0" + raw(b"".join(tokens)))


@given(commands=st.lists(COMMAND, min_size=1, max_size=12))
@examples(400)
def test_any_well_formed_request_gets_one_answer(server: Server, commands: list[tuple[int, bytes]]) -> None:
    parse_answer(server.run(b"\0" + frames(commands)))


@given(
    commands=st.lists(COMMAND, min_size=1, max_size=4),
    places=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), min_size=1, max_size=4),
)
@examples(200)
def test_the_second_request_after_damaged_ones_is_answered(
    server: Server, commands: list[tuple[int, bytes]], places: list[tuple[int, int]]
) -> None:
    damaged = damage(b"".join(request(code, payload) for code, payload in commands), places)
    # Two requests resynchronise the receiver: the first may be read as the rest of a frame.
    sent = server.run(b"\0" + raw(damaged) + frames([(0x20, b"\x01")] * 2))
    assert parse_answer(sent).data == b"MTU\0" + uleb(SERVO.mtu)


@pytest.mark.parametrize("name", sorted(path.name for path in CORPUS.iterdir()))
def test_an_input_of_the_corpus_breaks_no_rule(server: Server, name: str) -> None:
    server.run((CORPUS / name).read_bytes())


def test_fuzzer_finds_no_error(tmp_path: Path) -> None:
    try:
        target = freemaster_fuzz.build(tmp_path)
    except OSError:
        pytest.skip("clang is not installed")
    except subprocess.CalledProcessError as error:
        if "libclang_rt.fuzzer" in error.stderr:
            pytest.skip("clang has no libFuzzer (libclang-rt-dev)")
        raise
    found = tmp_path / "found"
    found.mkdir()
    command = [target, "-runs=4000", "-max_total_time=10", "-seed=1", f"-artifact_prefix={tmp_path}/"]
    result = subprocess.run(
        [*map(str, command), str(found), str(CORPUS)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr[-3000:]
