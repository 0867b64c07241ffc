"""CRC-8 and LEB128 against independent implementations."""

from __future__ import annotations

import random
from typing import Any

import cffi
import pytest
from c_declarations import declarations
from firmware_compiler import CompileC
from freemaster_model import crc8, examples, sleb, uleb
from hypothesis import given
from hypothesis import strategies as st

U32 = st.one_of(st.integers(0, 2**32 - 1), st.sampled_from([0, 127, 128, 2**14, 2**28 - 1, 2**28, 2**31, 2**32 - 1]))
I32 = st.one_of(st.integers(-(2**31), 2**31 - 1), st.sampled_from([-1, -64, -65, 63, 64, -(2**31), 2**31 - 1]))


class Numbers:
    """Python interface of the two C modules."""

    def __init__(self, ffi: cffi.FFI, lib: Any) -> None:
        self._ffi = ffi
        self._lib = lib

    def crc(self, data: bytes) -> int:
        crc = 0
        for byte in data:
            crc = self._lib.crc8_add(crc, byte)
        return crc

    def get(self, data: bytes, kind: str) -> tuple[int, int]:
        """Number of used bytes and value; only `data` may be read."""
        value = self._ffi.new("uint32_t *" if kind == "unsigned" else "int32_t *", 12345)
        used = getattr(self._lib, f"leb128_get_{kind}")(data, len(data), value)
        return int(used), int(value[0])

    def put(self, value: int) -> bytes:
        buffer = self._ffi.new("uint8_t[]", 5)
        return bytes(self._ffi.buffer(buffer, self._lib.leb128_put_unsigned(buffer, value)))


@pytest.fixture(scope="module")
def numbers(compile_c: CompileC) -> Numbers:
    return Numbers(
        *compile_c("numbers", ["comm/crc8.c", "comm/leb128.c"], declarations("comm/crc8.h", "comm/leb128.h"))
    )


def test_crc_check_value(numbers: Numbers) -> None:
    assert numbers.crc(b"123456789") == 0xF4


def test_crc_equals_bitwise_form(numbers: Numbers) -> None:
    data = random.Random(1).randbytes(4096)
    assert numbers.crc(data) == crc8(data)
    assert [numbers.crc(bytes([i])) for i in range(256)] == [crc8(bytes([i])) for i in range(256)]


@given(value=U32)
@examples(100)
def test_unsigned_round_trip(numbers: Numbers, value: int) -> None:
    data = numbers.put(value)
    assert data == uleb(value)
    assert numbers.get(data, "unsigned") == (len(data), value)


@given(value=U32, padding=st.integers(0, 300), tail=st.binary(max_size=3))
@examples(200)
def test_padded_forms_are_read_and_following_bytes_ignored(
    numbers: Numbers, value: int, padding: int, tail: bytes
) -> None:
    data = uleb(value, padding)
    assert numbers.get(data + tail, "unsigned") == (len(data), value)


@given(value=I32, tail=st.binary(max_size=3))
@examples(100)
def test_any_signed_value_is_read(numbers: Numbers, value: int, tail: bytes) -> None:
    data = sleb(value)
    assert numbers.get(data + tail, "signed") == (len(data), value)


@given(value=st.integers(2**32, 2**70))
@examples(100)
def test_bits_that_do_not_fit_are_dropped(numbers: Numbers, value: int) -> None:
    data = uleb(value)
    assert numbers.get(data, "unsigned") == (len(data), value & 0xFFFF_FFFF)


@given(value=U32, cut=st.integers(1, 5))
@examples(100)
def test_a_number_that_does_not_end_is_none(numbers: Numbers, value: int, cut: int) -> None:
    data = uleb(value)[:-cut]
    assert numbers.get(data, "unsigned")[0] == 0
    assert numbers.get(data, "signed")[0] == 0
