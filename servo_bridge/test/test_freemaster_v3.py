"""The client with targets of protocol version 3."""

from __future__ import annotations

import contextlib

import pytest
from fake_target import NONE, RO, RW, FakeEntry
from fake_target_v3 import FakeTargetV3
from fake_transport import FakeTransport, client_on
from hypothesis import assume, given
from hypothesis import strategies as st
from servo_bridge.freemaster import commands_v3
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.commands import Request, ScopeSlot
from servo_bridge.freemaster.commands_v3 import MemoryForm
from servo_bridge.freemaster.discovery import discover
from servo_bridge.freemaster.errors import CodecError, FreemasterError, StatusError
from servo_bridge.freemaster.frames import V3, Answer, AnswerParser
from servo_bridge.freemaster.recorder import Compare, Setup, Trigger
from servo_bridge.freemaster.recorder_v3 import set_up

WIDE = MemoryForm()
RECORDED = Setup(
    (ScopeSlot(0x20000030, 4), ScopeSlot(0x20000034, 2)), 20, 5, 1,
    Trigger(ScopeSlot(0x20000034, 2), Compare.SIGNED, True, False, -100),
)  # fmt: skip

REQUESTS = [
    (commands_v3.get_info(), "2B C0 40"),
    (commands_v3.get_info_brief(), "2B C8 38"),
    (WIDE.read_memory(0x20000020, 2), "2B 04 05 02 20 00 00 20 B5"),
    (WIDE.read_memory(0x2000003C, 16), "2B 04 05 10 3C 00 00 20 8B"),
    (WIDE.write_memory(0x20000020, b"\x2b\x2b"), "2B 05 07 02 20 00 00 20 2B 2B 2B 2B 5C"),
    (
        WIDE.set_scope([ScopeSlot(0x2000002A, 2), ScopeSlot(0x20000024, 4), ScopeSlot(0x20000036, 2)]),
        "2B 0A 10 03 02 2A 00 00 20 04 24 00 00 20 02 36 00 00 20 F7",
    ),
    (WIDE.read_scope(8), "2B C5 3B"),
    (WIDE.get_tsa_info(0), "2B 12 02 00 00 EC"),
    (WIDE.send_command(0x11, b"\x01\x02\xd4"), "2B 10 04 11 01 02 D4 04"),
    (WIDE.get_command_status(), "2B C6 3A"),
    (
        set_up(WIDE, RECORDED),
        "2B 0B 1C 01 14 00 0E 00 00 00 34 00 00 20 02 01 9C FF FF FF 02 04 30 00 00 20 02 34 00 00 20 1A",
    ),
]


@pytest.mark.parametrize(("request_", "expected"), REQUESTS, ids=[r.name for r, _ in REQUESTS])
def test_requests_match_the_wire(request_: Request, expected: str) -> None:
    assert request_.frame == bytes.fromhex(expected)


@pytest.mark.parametrize(
    ("wire", "size", "status", "data"),
    [
        ("2B 00 03 00 01 02 00 2B 2B CF", 6, 0, "03 00 01 02 00 2B"),
        ("2B 00 34 12 BA", 2, 0, "34 12"),
        ("2B 00 00", 0, 0, ""),
        ("2B 00 EF BE FE FF FF FF 2B 2B 2B 2B 02", 8, 0, "EF BE FE FF FF FF 2B 2B"),
        ("2B 01 FF", 0, 1, ""),
        ("2B 02 FE", 0, 2, ""),
        ("2B 00 FE FD 2B 2B DA", 3, 0, "FE FD 2B"),
        ("2B 40 05 81 03 68 69 2B 2B 3B", 0, 0x40, "81 03 68 69 2B"),
        ("2B 81 7F", 4, 0x81, ""),
        ("2B A9 57 2B 89 77", 4, 0x89, ""),
    ],
)
def test_answers_from_the_wire(wire: str, size: int, status: int, data: str) -> None:
    assert AnswerParser(size, V3).feed(bytes.fromhex(wire)) == Answer(status, bytes.fromhex(data))


def test_commands_of_fixed_length_carry_their_length() -> None:
    with pytest.raises(CodecError, match="do not go with"):
        V3.encode(0xD3, b"\x01")


@given(st.lists(st.binary(max_size=60), max_size=12), st.integers(0, 60))
def test_parser_accepts_arbitrary_bytes(chunks: list[bytes], size: int) -> None:
    parser = AnswerParser(size, V3)
    for chunk in chunks:
        answer = parser.feed(chunk)
        assert answer is None or answer.status in (0, 1, 2, 0x40) or answer.is_error
    frame = FakeTargetV3._frame(0, bytes(size))
    assert parser.feed(frame) is not None or parser.feed(frame) is not None


@given(st.integers(0, 255), st.integers(0, 10_000), st.binary(min_size=1, max_size=30))
def test_one_changed_byte_is_never_accepted_as_the_same_kind_of_answer(byte: int, place: int, data: bytes) -> None:
    wire = bytearray(FakeTargetV3._frame(0, data))
    good = wire.count(b"+")
    wire[place % len(wire)] = byte
    # An additional or missing start byte shifts the frame; the checksum detects 255 of 256 such frames.
    assume(wire.count(b"+") == 1 == good)
    answer = AnswerParser(len(data), V3).feed(bytes(wire))
    assert answer is None or answer.status != 0 or answer.data == data


def connected(target: FakeTargetV3) -> Client:
    client = client_on(FakeTransport(target.feed))
    client.identify()
    target.requests.clear()
    return client


def a_target(**options: object) -> FakeTargetV3:
    rows = [
        FakeEntry("point_t", None, 0, 6, 0),
        FakeEntry("x", b"\xf1", 0, 2, 2),
        FakeEntry("y", b"\xf2", 2, 4, 2),
        FakeEntry("speed", b"\xf5", 0x1000, 2, RO),
        FakeEntry("place", b"point_t", 0x1010, 6, RW),
        FakeEntry("curve", b"\xf1", 0x1020, 200, RW),
    ]
    target = FakeTargetV3(tables=[rows[3:], rows[:3]], **options)  # type: ignore[arg-type]
    target._next_string = 0x4000
    target.build(0x7000)
    return target


@pytest.mark.parametrize("brief", [False, True])
@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize(("wide", "narrow"), [(True, False), (False, True), (True, True)])
def test_a_target_is_identified_read_and_written(brief: bool, big_endian: bool, wide: bool, narrow: bool) -> None:
    target = a_target(
        brief=brief, big_endian=big_endian, wide=wide, narrow=narrow, field_width=4 if wide else 2, mtu=43
    )
    client = client_on(FakeTransport(target.feed))
    info = client.identify()
    assert (info.protocol, info.version, info.mtu, info.big_endian) == (3, "2.0", 43, big_endian)
    assert info.description == ("" if brief else "oracle v3 board")
    assert client.get_config("NM") is None
    found = {v.name: v for v in discover(client, info)}
    assert list(found) == ["speed", "place", "place.x", "place.y", "curve"]
    assert [found[n].writable for n in ("speed", "place.y")] == [False, True]
    assert found["place.y"].address == 0x1012
    data = bytes(range(20, 220))
    target.poke(0x1020, data)
    assert client.read_memory(0x1020, 200) == data
    client.write_memory(0x1012, found["place.y"].encode([-2]))
    client.write_memory(0x1010, b"\x0f\x2b")
    assert target.peek(0x1010, 6) == b"\x0f\x2b" + (-2).to_bytes(4, target.order, signed=True)
    with pytest.raises(StatusError, match="access denied"):
        client.write_memory(0x1000, b"ab")
    request = client.set_scope([ScopeSlot(0x1012, 4), ScopeSlot(0x1010, 2)])
    assert client.exchange(request).data == target.peek(0x1012, 4) + b"\x0f\x2b"


def test_description_and_limits_of_the_reference_target_are_read() -> None:
    answer = bytes.fromhex(
        "2B 00 03 00 01 02 00 3C 00 02 E8 83 6F 72 61 63 6C 65 20 76 33 20 62 6F 61 72 64" + "00" * 10 + "EA"
    )
    feed = lambda request: {b"+\xc0\x40": answer, b"+\x20\x04": b"+\x82\x7e"}.get(request[:3], b"+\x81\x7f")  # noqa: E731
    client = client_on(FakeTransport(feed))
    info = client.identify()
    assert (info.mtu, info.description, info.recorders) == (60, "oracle v3 board", 1)
    limits = client.recorder().limits()
    assert (limits.memory, limits.period_ns) == (512, 1_000_000)


def test_application_commands_return_the_answer_of_the_board() -> None:
    target = FakeTargetV3(commands={0x11: lambda arguments: 0x42 if arguments == b"\x01\x02\xd4" else 0})
    client = connected(target)
    assert client.run_command(0x11, b"\x01\x02\xd4") == 0x42


def test_functions_missing_in_version_3_are_refused() -> None:
    client = connected(a_target())
    with pytest.raises(FreemasterError, match="no passwords"):
        client.log_in("secret")
    with pytest.raises(CodecError, match="do not fit"):
        client.set_scope([ScopeSlot(0x1010, 2)] * 20)
    with pytest.raises(FreemasterError, match="no recorder 0; recorders: none"):
        client.recorder(0)
    with pytest.raises(CodecError, match="does not fit"):
        client.read_memory(1 << 32, 1)


@given(st.binary(max_size=80))
def test_garbage_after_the_identification_gives_a_specific_error(garbage: bytes) -> None:
    client = client_on(FakeTransport(lambda r: b"+\x82\x7e" if r[1] == 0x20 else garbage), retries=1)
    with contextlib.suppress(FreemasterError):
        client.identify()
    with contextlib.suppress(FreemasterError):
        client.read_memory(0, 4)


def test_members_of_old_tables_are_no_variables() -> None:
    target = FakeTargetV3(tables=[[FakeEntry("lost", b"\xf1", 0, 2, 2), FakeEntry("v", b"\xf1", 0x1000, 2, NONE)]])
    target.build()
    client = client_on(FakeTransport(target.feed))
    assert discover(client, client.identify()) == []
