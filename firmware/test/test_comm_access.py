"""Target-side addressing: read and write access, and the notifications of the application."""

from __future__ import annotations

import pytest
from freemaster_board import Board
from freemaster_model import ENTRIES, LIVE_SIZE, SERVO, Answer, examples, uleb
from hypothesis import given
from hypothesis import strategies as st

READ, READ_BA, WRITE, TSA_INFO, STRING_LENGTH = 0x21, 0x22, 0x23, 0x29, 0x2A
DENIED = Answer(0x89)


def at(offset: int) -> bytes:
    """Address field of an offset in the memory."""
    return uleb(SERVO.variables + offset)


def write(offset: int, data: bytes, mask: bytes | None = None) -> bytes:
    """Payload of a WRITEMEM request."""
    flags = b"\x00" if mask is None else b"\x01"
    return flags + at(offset) + uleb(len(data)) + data + (mask or b"")


def test_table_read_out_gives_every_entry(servo: Board) -> None:
    """In the order of a client: table list, entries, string lengths, strings."""
    info = servo.ask(TSA_INFO, b"\x00").data
    assert info == b"\x13" + uleb(16 * len(ENTRIES)) + uleb(SERVO.table)
    assert servo.ask(TSA_INFO, b"\x01") == Answer(0x40, b"\x13\x00\x00")
    assert servo.ask(TSA_INFO, uleb(0x8000)) == Answer(0x40, b"\x13\x00\x00")

    table = b"".join(servo.ask(READ, uleb(SERVO.table + 16 * i) + b"\x10").data for i in range(len(ENTRIES)))
    assert table == SERVO.wire_table()
    assert servo.ask(READ, uleb(SERVO.table + 5) + b"\x0a").data == table[5:15], "any part of it"

    for i, entry in enumerate(ENTRIES):
        for field, text in enumerate((entry.name.encode(), entry.type)):
            pointer = table[16 * i + 4 * field : 16 * i + 4 * field + 4]
            address = int.from_bytes(pointer, "little")
            assert servo.ask(STRING_LENGTH, uleb(address)) == Answer(0x40, uleb(len(text)))
            assert servo.ask(READ, uleb(address) + uleb(len(text))) == Answer(0, text)
            assert servo.ask(READ, uleb(address) + uleb(len(text) + 1)) == DENIED, "without the terminating 00"


@pytest.mark.parametrize("code", [TSA_INFO, STRING_LENGTH])
@pytest.mark.parametrize("payload", [b"", b"\x80", b"\x80\x80"])
def test_discovery_requests_with_missing_fields_are_refused(servo: Board, code: int, payload: bytes) -> None:
    assert servo.ask(code, payload) == Answer(0x86)


def test_string_length_inside_and_outside_of_the_strings(servo: Board) -> None:
    assert servo.ask(STRING_LENGTH, uleb(SERVO.strings + 2)).data == uleb(len(ENTRIES[0].name) - 2)
    assert servo.ask(STRING_LENGTH, uleb(SERVO.strings + len(ENTRIES[0].name))).data == b"\x00"
    for address in (SERVO.strings - 1, SERVO.strings + len(SERVO.blob), SERVO.variables, 0, 2**32 - 1):
        assert servo.ask(STRING_LENGTH, uleb(address)) == DENIED


@pytest.mark.parametrize("size", [0, 2**32 - 1, 2**31, 0xFFFF_F000, 2**16, 2**16 + 2])
def test_sizes_beyond_the_address_range_are_refused(servo: Board, size: int) -> None:
    expected = Answer(0) if size == 0 else DENIED
    assert servo.ask(READ, at(0x20) + uleb(size)) == expected
    assert servo.ask(WRITE, b"\x00" + at(0x20) + uleb(size) + bytes(16)) == expected
    assert servo.events().count(("written", 0x20, 0)) == 0


def test_padded_addresses_and_dropped_bits(servo: Board) -> None:
    expected = Answer(0, servo.memory()[0x20:0x22])
    assert servo.ask(READ, uleb(SERVO.variables + 0x20, padding=3) + uleb(2, padding=1)) == expected
    assert servo.ask(READ, uleb(SERVO.variables + 0x20 + 2**34) + b"\x02") == expected


@pytest.mark.parametrize(
    ("mask", "expected", "reported"),
    [
        (b"\xff" * 8, b"\x11" * 8, (0x58, 8)),
        (b"\xff" * 4 + b"\x00" * 4, b"\x11" * 4 + b"\xa0" * 4, (0x58, 4)),
        (b"\x00" * 4 + b"\xff" * 4, b"\xa0" * 4 + b"\x11" * 4, (0x5C, 4)),
        (b"\x00\x0f" + b"\x00" * 5 + b"\xf0", b"\xa0\xa1" + b"\xa0" * 5 + b"\x10", (0x59, 7)),
        (b"\x00" * 8, b"\xa0" * 8, None),
    ],
)
def test_masked_write_reports_the_written_range(
    servo: Board, mask: bytes, expected: bytes, reported: tuple[int, int] | None
) -> None:
    """The other element of an array must not count as freshly written."""
    servo.poke(0x58, b"\xa0" * 8)
    assert servo.ask(WRITE, write(0x58, b"\x11" * 8, mask)) == Answer(0)
    assert servo.memory()[0x58:0x60] == expected
    events = servo.events()
    assert [event[1:] for event in events if event[0] == "written"] == ([] if reported is None else [reported])


def test_a_mask_of_zeros_writes_nothing(servo: Board) -> None:
    """Also when more zeros follow."""
    before = servo.memory()
    assert servo.ask(WRITE, write(0x58, b"\x11" * 8, bytes(8)) + bytes(8)) == Answer(0)
    assert servo.write(SERVO.variables + 0x58, b"\x11" * 8, bytes(16)) == 0
    assert servo.memory() == before
    assert servo.events() == []


@pytest.mark.parametrize("mask", [None, b"\x00\xff" + b"\x00" * 6])
def test_a_write_refused_by_the_application_changes_nothing(servo: Board, mask: bytes | None) -> None:
    before = servo.memory()
    servo.set_refusing(True)
    assert servo.ask(WRITE, write(0x58, b"\x11" * 8, mask)) == Answer(0x97)
    assert servo.write(SERVO.variables + 0x58, b"\x11" * 8, mask) == 0x97
    assert servo.memory() == before
    assert servo.events() == [("lock", 0, 0), ("unlock", 0, 0)] * 2
    assert servo.ask(WRITE, write(0x58, b"\x11" * 8, bytes(8))) == Answer(0), "the application is not called"
    assert servo.ask(WRITE, write(0x2A, b"\x11")) == DENIED, "the table is checked first"
    assert servo.events() == []
    servo.set_refusing(False)
    assert servo.ask(WRITE, write(0x58, b"\x11" * 8, mask)) == Answer(0)


def test_other_flags_of_a_write_are_ignored(servo: Board) -> None:
    assert servo.ask(WRITE, b"\xfe" + write(0x20, b"\x01\x02")[1:]) == Answer(0)
    assert servo.memory()[0x20:0x22] == b"\x01\x02"


@pytest.mark.parametrize("mask", [None, b"\xff" * 8])
def test_write_with_missing_bytes_changes_nothing(servo: Board, mask: bytes | None) -> None:
    complete = write(0x58, b"\x11" * 8, mask)
    before = servo.memory()
    for cut in range(1, len(complete) + 1):
        assert servo.ask(WRITE, complete[:-cut]) == Answer(0x86)
    assert servo.memory() == before
    assert servo.events() == []
    assert servo.ask(WRITE, complete + b"more").status == 0, "bytes after the fields are ignored"


def test_read_with_missing_fields_is_refused(servo: Board) -> None:
    for code in (READ, READ_BA):
        for payload in (b"", b"\x80", b"\x80\x80\x80", at(0x20), at(0x20) + b"\x82"):
            assert servo.ask(code, payload) == Answer(0x86)


def test_reading_locks_the_server_once(servo: Board) -> None:
    servo.ask(READ, at(0x54) + b"\x10")
    assert servo.events() == [("lock", 0, 0), ("unlock", 0, 0)]


def test_direct_access_follows_the_same_rules(servo: Board) -> None:
    memory = servo.memory()
    base = SERVO.variables
    assert servo.read(base + 0x100, 300) == (0, memory[0x100 : 0x100 + 300]), "not limited by a frame"
    assert servo.read(SERVO.table, 16 * len(ENTRIES)) == (0, SERVO.wire_table())
    assert servo.read(SERVO.strings, 9) == (0, b"M.var_u16")
    assert servo.read(base + 0x42, 2)[0] == 0x89
    assert servo.write(base + 0x2A, b"\x00\x00") == 0x89
    assert servo.write(base + 0x20, b"\x99\x88") == 0
    assert servo.write(base + 0x58, b"\x77" * 8, b"\x00" * 4 + b"\xff" * 4) == 0
    after = servo.memory()
    assert (after[0x20:0x22], after[0x58:0x60]) == (b"\x99\x88", memory[0x58:0x5C] + b"\x77" * 4)
    assert [event for event in servo.events() if event[0] == "written"] == [("written", 0x20, 2), ("written", 0x5C, 4)]


EDGES = sorted(
    {SERVO.address(entry) + edge for entry in ENTRIES for edge in (0, entry.size)}
    | {SERVO.variables, SERVO.strings, SERVO.strings + len(SERVO.blob), SERVO.table, SERVO.table + 16 * len(ENTRIES)}
)
ADDRESS = st.one_of(
    st.builds(lambda edge, shift: max(0, edge + shift), st.sampled_from(EDGES), st.integers(-4, 4)),
    st.builds(lambda at: SERVO.strings + at, st.integers(0, len(SERVO.blob))),
    st.integers(0, 2**32 - 1),
)


@given(
    address=ADDRESS, size=st.one_of(st.integers(0, 20), st.integers(0, 320)), data=st.binary(min_size=20, max_size=20)
)
@examples(600)
def test_access_rules_against_the_model(shared_servo: Board, address: int, size: int, data: bytes) -> None:
    board = shared_servo
    before = board.memory()
    board.events()

    read = board.ask(READ, uleb(address) + uleb(size))
    if not SERVO.readable(address, size):
        assert read == DENIED
    elif size > SERVO.data_max:
        assert read == Answer(0x84)
    else:
        assert read == Answer(0, SERVO.content(before, bytes(LIVE_SIZE), address, size))

    data = data[:size]
    status = board.ask(WRITE, b"\x00" + uleb(address) + uleb(len(data)) + data).status
    offset = address - SERVO.variables
    if SERVO.writable(address, len(data)):
        assert (status, board.memory()) == (0, before[:offset] + data + before[offset + len(data) :])
    else:
        assert (status, board.memory()) == (0x89, before)
