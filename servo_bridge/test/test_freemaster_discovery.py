from __future__ import annotations

import struct

import pytest
from fake_target import CONST, ENUM, FLASH, NONE, RO, RW, STRUCT, FakeEntry, FakeTarget
from fake_transport import FakeTransport, client_on
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.freemaster.discovery import discover
from servo_bridge.freemaster.errors import DiscoveryError, StatusError
from servo_bridge.freemaster.tsa import (
    Entry,
    Number,
    TargetVariable,
    TypeKind,
    ValueType,
    parse_entries,
    parse_type,
)


def find_all(target: FakeTarget) -> dict[str, TargetVariable]:
    target.build()
    client = client_on(FakeTransport(target.feed))
    return {v.name: v for v in discover(client, client.identify())}


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("mtu", [32, 240, 254])
@pytest.mark.parametrize("safety", [True, False])
def test_every_entry_width_and_buffer_size_is_supported(width: int, mtu: int, safety: bool) -> None:
    base = 0x2000 if width == 2 else 0x2000_0000
    table = [FakeEntry(f"motor.variable_number_{k}", b"\xf1", base + 2 * k, 2, RW if k % 2 else RO) for k in range(30)]
    target = FakeTarget(mtu=mtu, field_width=width, safety=safety, tables=[table])
    if width == 2:
        target._next_string = 0x4000
        target.build(0x7000)
        client = client_on(FakeTransport(target.feed))
        found = {v.name: v for v in discover(client, client.identify())}
    else:
        found = find_all(target)
    assert list(found) == [e.name for e in table]
    assert [(v.address, v.size, v.writable) for v in found.values()] == [(e.address, 2, e.kind == RW) for e in table]


def test_all_tables_are_read() -> None:
    target = FakeTarget(tables=[[FakeEntry(f"t{t}.x", b"\xe0", 16 * t, 1, RO)] for t in range(4)])
    assert list(find_all(target)) == ["t0.x", "t1.x", "t2.x", "t3.x"]


def test_big_endian_target_is_read() -> None:
    target = FakeTarget(big_endian=True, tables=[[FakeEntry("x", b"\xf1", 0x2000_0000, 4, RW)]])
    found = find_all(target)["x"]
    assert found.decode(b"\xff\xfe\x01\x00") == [-2, 256]
    assert found.encode([-2, 256]) == b"\xff\xfe\x01\x00"


def test_shared_strings_are_read_once() -> None:
    table = [FakeEntry(f"v{k}", b"\xf4:15.16", 0x1000 + 4 * k, 4, RO) for k in range(20)]
    target = FakeTarget(tables=[table])
    find_all(target)
    assert [command for command, _ in target.requests].count(0x2A) == 21


def test_members_of_structures_are_found() -> None:
    point = [
        FakeEntry("point_t", STRUCT, 0, 6, NONE),
        FakeEntry("x", b"\xf1", 0, 2, NONE),
        FakeEntry("y", b"\xf2", 2, 4, NONE),
    ]
    box = [
        FakeEntry("box_t", STRUCT, 0, 12, NONE),
        FakeEntry("a", b"point_t", 0, 6, NONE),
        FakeEntry("b", b"point_t", 6, 6, NONE),
    ]
    found = find_all(FakeTarget(tables=[[FakeEntry("box", b"box_t", 0x1000, 12, RW), *box], point]))
    assert list(found) == ["box", "box.a", "box.a.x", "box.a.y", "box.b", "box.b.x", "box.b.y"]
    assert found["box.b.y"].address == 0x1008
    assert found["box.b.y"].writable
    assert found["box"].type.kind is TypeKind.RAW
    assert found["box"].members == ("box.a", "box.b")


def test_recursive_structure_terminates() -> None:
    loop = [FakeEntry("t", STRUCT, 0, 4, NONE), FakeEntry("again", b"t", 0, 4, NONE)]
    assert list(find_all(FakeTarget(tables=[[*loop, FakeEntry("v", b"t", 0x1000, 4, RO)]]))) == ["v", "v.again"]


def test_elements_of_an_array_of_structures_are_found() -> None:
    point = [
        FakeEntry("point_t", STRUCT, 0, 6, NONE),
        FakeEntry("x", b"\xf1", 0, 2, NONE),
        FakeEntry("y", b"\xf1", 2, 4, NONE),
    ]
    line = [FakeEntry("line_t", STRUCT, 0, 12, NONE), FakeEntry("ends", b"point_t", 0, 12, NONE)]
    rows = [FakeEntry("line", b"line_t", 0x1000, 12, RW), *point, *line]
    found = find_all(FakeTarget(big_endian=True, tables=[rows, point]))  # the type is described twice
    assert list(found) == [
        "line", "line.ends", "line.ends[0]", "line.ends[0].x", "line.ends[0].y",
        "line.ends[1]", "line.ends[1].x", "line.ends[1].y",
    ]  # fmt: skip
    assert found["line.ends"].members == ("line.ends[0]", "line.ends[1]")
    assert (found["line.ends[1].y"].address, found["line.ends[1].y"].count) == (0x1008, 2)


def test_expansion_of_structures_is_limited() -> None:
    rows = []
    for depth in range(4):
        rows += [
            FakeEntry(f"t{depth}", STRUCT, 0, 100**depth, NONE),
            FakeEntry("m", f"t{depth - 1}".encode() if depth else b"\xe0", 0, 100**depth, NONE),
        ]
    found = find_all(FakeTarget(safety=False, tables=[[*rows, FakeEntry("v", b"t3", 0, 100**3 * 100, RO)]]))
    assert 0 < len(found) < 100_000


def test_constants_after_an_enumeration_are_its_labels() -> None:
    rows = [
        FakeEntry("state_t", ENUM, 0, 2, NONE),
        FakeEntry("OFF", CONST, 0, 0, NONE),
        FakeEntry("BROKEN", CONST, 0xFFFF_FFFF, 0, NONE),
    ]
    found = find_all(FakeTarget(tables=[[*rows, FakeEntry("state", b"state_t", 0x1000, 2, RO)]]))["state"]
    assert found.type.name == "state_t"
    assert found.decode(b"\xff\xff") == 0xFFFF
    assert found.type.label(0xFFFF) == "BROKEN"
    assert found.type.label(0) == "OFF"
    assert found.type.label(7) is None


def test_entries_that_are_no_variables_are_omitted() -> None:
    rows = [
        FakeEntry("path", b"\xed:DIR", 0, 0, RW),
        FakeEntry("file.htm", b"\xec:MEMFILE", 0x5000, 100, RW),
        FakeEntry("http://x", b"\xec:HREF", 0x6000, 9, RW),
        FakeEntry("flash", b"\xed:U:FW", 0x1234, 7, NONE),
        FakeEntry("", b"\xe0", 0x1000, 1, RO),
        FakeEntry("nothing", b"\xe0", 0x1000, 0, RO),
        FakeEntry("x", b"\xe0", 0x1000, 1, FLASH),
    ]
    found = find_all(FakeTarget(tables=[rows]))
    assert list(found) == ["x"]
    assert not found["x"].writable


def test_variables_of_unknown_type_are_read_by_their_size() -> None:
    rows = [
        FakeEntry("untyped", None, 0x1000, 4, RO),
        FakeEntry("block", None, 0x1010, 100, RO),
        FakeEntry("strange", b"no_such_t", 0x1100, 6, RW),
        FakeEntry("odd", b"\xf2", 0x1200, 3, RW),
        FakeEntry("bad fraction", b"\xf4:oops", 0x1300, 2, RW),
    ]
    found = find_all(FakeTarget(tables=[rows], safety=False))
    assert found["untyped"].decode(b"\x01\0\0\x80") == 0x80000001
    assert found["block"].decode(bytes(100)) == bytes(100)
    assert found["strange"].type.name == "no_such_t"
    assert found["odd"].decode(b"abc") == b"abc"
    assert found["bad fraction"].count == 1
    with pytest.raises(ValueError, match="is read-only"):
        found["strange"].encode([1])


def test_unreadable_text_does_not_end_discovery() -> None:
    target = FakeTarget(
        tables=[[FakeEntry("seen", b"\xe0", 0x1000, 1, RO), FakeEntry("hidden", b"\xe1", 0x1002, 2, RO)]]
    )
    target.build()
    place = target._strings.pop(b"hidden")
    client = client_on(FakeTransport(target.feed))
    assert [v.name for v in discover(client, client.identify())] == ["seen", f"0x{place:X}"]


def test_a_target_without_tables_is_an_error() -> None:
    with pytest.raises(DiscoveryError, match="no table of variables"):
        find_all(FakeTarget(tables=[]))
    refusing = FakeTarget()
    feed = lambda data: b"+\x81\x8e" if data[1] == 0x29 else refusing.feed(data)  # noqa: E731
    client = client_on(FakeTransport(feed))
    with pytest.raises(DiscoveryError):
        discover(client, client.identify())


def test_a_table_of_impossible_size_is_an_error() -> None:
    target = FakeTarget()
    target._table_ranges = [(0x1000, 1 << 30)]
    client = client_on(FakeTransport(target.feed))
    with pytest.raises(DiscoveryError, match="not plausible"):
        discover(client, client.identify())


def test_required_password_is_reported() -> None:
    with pytest.raises(StatusError, match="password needed"):
        find_all(FakeTarget(passwords={1: "x"}, tables=[[FakeEntry("x", b"\xe0", 0x1000, 1, RO)]]))


# ---- type strings ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "data", "value"),
    [
        (b"\xe0", b"\xff", 255),
        (b"\xe1", b"\xfe\xff", 65534),
        (b"\xe2", b"\xff\xff\xff\xff", 0xFFFFFFFF),
        (b"\xe3", b"\xff" * 8, 2**64 - 1),
        (b"\xf0", b"\xff", -1),
        (b"\xf1", b"\xfe\xff", -2),
        (b"\xf2", b"\0\0\0\x80", -(2**31)),
        (b"\xf3", b"\xff" * 8, -1),
        (b"\xe5", b"\0\xc0", 1.5),
        (b"\xe6", b"\0\0\0\xc0", 1.5),
        (b"\xe7", bytes(7) + b"\xc0", 1.5),
        (b"\xf5", b"\0\xc0", -0.5),
        (b"\xf6", b"\0\0\0\xc0", -0.5),
        (b"\xf7", bytes(7) + b"\xc0", -0.5),
        (b"\xf4:15.16", struct.pack("<i", -98304), -1.5),
        (b"\xe4:1.31", b"\0\0\0\xc0", 1.5),
        (b"\xf4:0.7", b"\xc0", -0.5),
        (b"\xf4:8.8", struct.pack("<i", 384), 1.5),
        (b"\xf4:3.12", b"\0\x18", 1.5),
        (b"\xfa", struct.pack("<f", -2.5), -2.5),
        (b"\xfb", struct.pack("<d", 1e300), 1e300),
    ],
)
def test_every_base_type_is_decoded_and_encoded(text: bytes, data: bytes, value: Number) -> None:
    found = parse_type(text, len(data))
    assert found is not None
    assert found.size == len(data)
    assert found.decode(data) == value
    assert found.encode(value) == data


def test_an_array_is_encoded_element_by_element() -> None:
    variable = TargetVariable("x", 0, 8, parse_type(b"\xf4:15.16", 8) or pytest.fail("no type"), True)
    assert variable.count == 2
    assert variable.decode(variable.encode([1.5, -2.25])) == [1.5, -2.25]
    with pytest.raises(ValueError, match="1 values given, 2 expected"):
        variable.encode([1.0])


@given(st.binary(max_size=12), st.integers(0, 300))
def test_any_type_string_is_accepted(text: bytes, size: int) -> None:
    found = parse_type(text, size)
    assert found is None or (size % found.size == 0 and found.kind is not TypeKind.RAW)


ENTRIES = st.builds(
    Entry, st.text(max_size=6), st.one_of(st.binary(max_size=6), st.sampled_from([STRUCT, ENUM, CONST, b"a"])),
    st.integers(0, 2**32 - 1), st.integers(0, 255),
)  # fmt: skip


@given(st.lists(ENTRIES, max_size=12))
def test_any_table_is_accepted(entries: list[Entry]) -> None:
    for variable in parse_entries(entries):
        assert variable.name
        assert variable.size > 0
        decoded = variable.decode(bytes(variable.size))
        assert decoded is not None


@pytest.mark.parametrize(
    ("type_", "value", "text"),
    [
        (ValueType(TypeKind.UNSIGNED, 1, "u8"), 256, "does not fit"),
        (ValueType(TypeKind.UNSIGNED, 1, "u8"), -1, "does not fit"),
        (ValueType(TypeKind.SIGNED, 2, "i16"), 1.5, "not an integer"),
        (ValueType(TypeKind.SIGNED, 2, "q0.15", 15), 1.0, "does not fit"),
        (ValueType(TypeKind.FLOAT, 4, "float"), 1e300, "does not fit"),
        (ValueType(TypeKind.FLOAT, 4, "float"), float("nan"), "not a finite"),
        (ValueType(TypeKind.SIGNED, 2, "i16"), float("inf"), "not a finite"),
    ],
)
def test_values_out_of_range_are_refused(type_: ValueType, value: Number, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        type_.encode(value)
