"""Address resolution with invalid tables: nothing outside of them is read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cffi
import pytest
from c_declarations import declarations
from firmware_compiler import CompileC

VARIABLES, STRINGS, TABLE, LIVE = 0x1000, 0x0010_0000, 0x0020_0000, 0x0030_0000
RW = 3


class Tsa:
    """A table, its strings and a memory of 16 bytes."""

    def __init__(
        self,
        ffi: cffi.FFI,
        lib: Any,
        entries: Sequence[tuple[int, ...]],
        strings: bytes,
        sources: Sequence[tuple[int, int, int]] = (),
    ) -> None:
        self._ffi = ffi
        self._lib = lib
        self._entries = ffi.new("tsa_entry_t[]", list(entries))
        self._strings = ffi.new("uint8_t[]", strings)
        self._memory = ffi.new("uint8_t[16]")
        self._sources = ffi.new("tsa_source_t[]", list(sources))
        self._live = ffi.new("uint8_t[16]")
        self.table = ffi.new(
            "tsa_table_t *", (self._entries, len(entries), self._strings, len(strings), self._sources, len(sources))
        )
        self._space = ffi.new("tsa_space_t *", (self.table, self._memory, 16, self._live, 16))

    def place(self, kind: str, address: int, size: int) -> tuple[int, int] | None:
        """Offset and size to which a range resolves."""
        place = self._ffi.new("tsa_place_t *")
        allowed = getattr(self._lib, f"tsa_{kind}")(self._space, address, size, place)
        return (place.offset, place.size) if allowed else None

    def live(self, address: int, size: int) -> tuple[str, int, int] | None:
        """Memory and offset of a range in the loops, and the size of its elements."""
        cell = self._ffi.new("uint8_t *")
        at = self._lib.tsa_live(self._space, address, size, cell)
        for name, memory in (("live", self._live), ("memory", self._memory)):
            if at != self._ffi.NULL and 0 <= at - memory < 16:
                return name, at - memory, cell[0]
        assert at == self._ffi.NULL
        return None

    def string_length(self, address: int) -> int | None:
        length = self._ffi.new("uint16_t *")
        return length[0] if self._lib.tsa_string_length(self.table, address, length) else None

    def table_size(self) -> int:
        return int(self._lib.tsa_table_size(self.table))


@pytest.fixture(scope="module")
def library(compile_c: CompileC) -> tuple[cffi.FFI, Any]:
    return compile_c("tsa", ["comm/tsa.c"], declarations("comm/tsa.h"))


def test_unterminated_string_ends_with_the_blob(library: tuple[cffi.FFI, Any]) -> None:
    """The blob ends within a string; the length of the string ends there."""
    ffi, lib = library
    tsa = Tsa(ffi, lib, [(0, 2, VARIABLES, 2, RW)], b"a\0\xe1xyz")
    tsa.table.strings_size = 4
    assert tsa.string_length(STRINGS + 2) == 2
    assert tsa.place("readable", STRINGS + 2, 2) == (2, 2)
    assert tsa.place("readable", STRINGS + 2, 3) is None


def test_type_outside_of_the_strings_gives_no_access(library: tuple[cffi.FFI, Any]) -> None:
    ffi, lib = library
    tsa = Tsa(ffi, lib, [(0, 4, VARIABLES, 2, RW), (0, 0xFFFF, VARIABLES + 2, 2, RW)], b"a\0\xe1\0")
    for kind in ("readable", "writable"):
        assert tsa.place(kind, VARIABLES, 2) is None
        assert tsa.place(kind, VARIABLES + 2, 2) is None


def test_entries_at_the_ends_of_the_address_space_are_resolved(library: tuple[cffi.FFI, Any]) -> None:
    ffi, lib = library
    entries = [(0, 2, 0xFFFF_FFFE, 4, RW), (0, 2, 0, 0xFFFF, RW), (0, 2, VARIABLES - 2, 4, RW)]
    tsa = Tsa(ffi, lib, entries, b"a\0\xe1\0")
    for address, size in ((0xFFFF_FFFE, 2), (0, 1), (VARIABLES - 1, 2), (VARIABLES + 16, 1), (VARIABLES + 15, 2)):
        assert tsa.place("readable", address, size) is None
        assert tsa.place("writable", address, size) is None
    assert tsa.place("writable", VARIABLES, 16) == (0, 16), "inside the memory and inside an entry"


def test_table_larger_than_one_read_is_readable(library: tuple[cffi.FFI, Any]) -> None:
    ffi, lib = library
    tsa = Tsa(ffi, lib, [(0, 2, VARIABLES, 2, RW)] * 5000, b"a\0\xe1\0")
    assert tsa.table_size() == 80_000
    assert tsa.place("readable", TABLE + 14_465, 65_535) == (14_465, 65_535)
    assert tsa.place("readable", TABLE + 14_466, 65_535) is None, "ends beyond the table"
    assert tsa.place("readable", TABLE, 65_536) is None
    assert tsa.place("readable", TABLE, 65_536 + 16) is None, "a 16-bit size would be 16 bytes"


def test_an_empty_table_makes_nothing_readable(library: tuple[cffi.FFI, Any]) -> None:
    ffi, lib = library
    tsa = Tsa(ffi, lib, [], b"")
    assert tsa.table_size() == 0
    for address in (VARIABLES, STRINGS, TABLE):
        assert tsa.place("readable", address, 1) is None
        assert tsa.string_length(address) is None


def test_a_part_of_a_variable_comes_from_the_same_part_of_its_source(library: tuple[cffi.FFI, Any]) -> None:
    """A part of a variable is read from the same part of its source; a source beyond the memory is not used."""
    ffi, lib = library
    sources = [(VARIABLES + 4, 8, 4), (LIVE, 12, 4), (LIVE + 4, 14, 4), (LIVE + 8, 0xFFFE, 4), (0xFFFF_FFFE, 0, 4)]
    tsa = Tsa(ffi, lib, [(0, 2, VARIABLES, 8, RW)], b"a\0\xe1\0", sources)
    assert tsa.live(VARIABLES, 4) == ("memory", 0, 4)
    assert tsa.live(VARIABLES + 4, 4) == ("live", 8, 4)
    assert tsa.live(VARIABLES + 6, 2) == ("live", 10, 2)
    assert tsa.live(VARIABLES + 7, 1) == ("live", 11, 1)
    assert tsa.live(VARIABLES + 2, 4) == ("memory", 2, 2), "more than the variable with a source"
    assert tsa.live(LIVE, 4) == ("live", 12, 4)
    assert tsa.live(LIVE + 4, 2) == ("live", 14, 2)
    for address, size in (
        (LIVE + 4, 4),
        (LIVE + 8, 4),
        (LIVE + 2, 4),
        (VARIABLES + 6, 4),
        (0xFFFF_FFFE, 8),
        (STRINGS, 1),
    ):
        assert tsa.live(address, size) is None
    assert tsa.place("readable", LIVE, 4) == (12, 4)
    assert tsa.place("readable", LIVE + 4, 4) is None
    assert tsa.place("readable", VARIABLES + 4, 4) == (4, 4), "the copy"
    assert tsa.place("writable", LIVE, 4) is None
