from __future__ import annotations

import pytest
from fake_target import Reader, checksum, escaped
from hypothesis import assume, given
from hypothesis import strategies as st
from servo_bridge.freemaster import commands
from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.errors import CodecError
from servo_bridge.freemaster.frames import (
    V4,
    Answer,
    AnswerParser,
    crc8,
    decode_uleb,
    encode_sleb,
    encode_uleb,
)


def answer_frame(status: int, data: bytes = b"") -> bytes:
    length = bytes([len(data)]) if status == 0x40 else b""
    body = bytes([status]) + length + data
    return escaped(body + bytes([checksum(body)]))


def test_crc_check_value() -> None:
    assert crc8(b"123456789") == 0xF4


@given(st.binary())
def test_crc_agrees_with_the_bitwise_form(data: bytes) -> None:
    assert crc8(data) == checksum(data)


# Frames observed on the wire of vendor targets.
REQUESTS = [
    (commands.get_config("MTU"), "2B 20 05 00 4D 54 55 00 8B"),
    (commands.get_config("F1"), "2B 20 04 00 46 31 00 A3"),
    (commands.get_config("PV"), "2B 20 04 00 50 56 00 E2"),
    (commands.read_memory(0x20000020, 2), "2B 21 06 A0 80 80 80 02 02 EF"),
    (commands.read_memory(0x20000040, 2), "2B 21 06 C0 80 80 80 02 02 A2"),
    (commands.read_memory(0x20000070, 43), "2B 21 06 F0 80 80 80 02 2B 2B D8"),
    (commands.read_memory(0x20000072, 16), "2B 21 06 F2 80 80 80 02 10 2B 2B"),
    (commands.write_memory(0x20000020, b"\x78\x56"), "2B 23 09 00 A0 80 80 80 02 02 78 56 9C"),
    (commands.write_memory(0x20000020, b"\x2b\x2b"), "2B 23 09 00 A0 80 80 80 02 02 2B 2B 2B 2B DB"),
    (
        commands.write_memory(0x20000020, b"\xff\xff", b"\xf0\x0f"),
        "2B 23 0B 01 A0 80 80 80 02 02 FF FF F0 0F A0",
    ),
    (commands.write_memory(0x2000002A, b"\0\0"), "2B 23 09 00 AA 80 80 80 02 02 00 00 8D"),
    (commands.read_scope(8), "2B 27 01 00 40"),
    (commands.get_tsa_info(0), "2B 29 01 00 6C"),
    (commands.get_tsa_info(3), "2B 29 01 03 65"),
    (commands.get_string_length(0x0804F115), "2B 2A 04 95 E2 93 40 B0"),
    (commands.read_memory(0x0804F115, 9), "2B 21 05 95 E2 93 40 09 83"),
    (commands.send_command(0x11, b"\x01\x02\xd4"), "2B 30 04 11 01 02 D4 38"),
    (commands.get_command_status(), "2B 31 00 EC"),
    (commands.get_command_data(3, 0), "2B 32 02 03 00 6C"),
    (commands.begin_login(1), "2B 2C 01 01 AB"),
    (commands.begin_login(0), "2B 2C 01 00 AC"),
]


@pytest.mark.parametrize(("request_", "expected"), REQUESTS, ids=[r.name for r, _ in REQUESTS])
def test_requests_match_the_wire(request_: commands.Request, expected: str) -> None:
    assert request_.frame == bytes.fromhex(expected)


def test_scope_set_up_matches_the_wire() -> None:
    slots = [ScopeSlot(0x2000002A, 2), ScopeSlot(0x20000024, 4), ScopeSlot(0x20000040, 2)]
    (one_frame,) = commands.set_scope(slots)
    assert one_frame.payload == bytes.fromhex(
        "00 01 01 03 02 07 00 AA 80 80 80 02 02 02 07 01 A4 80 80 80 02 04 02 07 02 C0 80 80 80 02 02"
    )
    # The three frames of the reference set-up, one operation group each.
    assert V4.encode(0x26, one_frame.payload[:4]) == bytes.fromhex("2B 26 04 00 01 01 03 35")
    assert V4.encode(0x26, b"\0" + one_frame.payload[4:13]) == bytes.fromhex(
        "2B 26 0A 00 02 07 00 AA 80 80 80 02 02 56"
    )
    assert V4.encode(0x26, b"\0" + one_frame.payload[13:]) == bytes.fromhex(
        "2B 26 13 00 02 07 01 A4 80 80 80 02 04 02 07 02 C0 80 80 80 02 02 5B"
    )


@pytest.mark.parametrize(
    ("wire", "size", "status", "data"),
    [
        ("2B 40 06 4D 54 55 00 F0 01 70", 0, 0x40, b"MTU\0\xf0\x01"),
        ("2B 40 04 46 31 00 02 92", 0, 0x40, b"F1\0\x02"),
        ("2B 40 08 42 41 00 80 80 80 80 02 F2", 0, 0x40, b"BA\0\x80\x80\x80\x80\x02"),
        ("2B 89 B6", 5, 0x89, b""),
        ("2B 00 34 12 D3", 2, 0x00, b"\x34\x12"),
        ("2B 00 2B 2B 2B 2B E8", 2, 0x00, b"\x2b\x2b"),
        ("2B 00 00", 0, 0x00, b""),
        ("2B 00 EF BE FE FF FF FF 2B 2B 2B 2B 9F", 8, 0x00, bytes.fromhex("EF BE FE FF FF FF 2B 2B")),
        ("2B 88 B1", 8, 0x88, b""),
        ("2B 40 08 13 80 03 E0 A1 80 80 02 15", 0, 0x40, bytes.fromhex("13 80 03 E0 A1 80 80 02")),
        ("2B 40 01 09 AC", 0, 0x40, b"\x09"),
        ("2B 00 4D 2E 76 61 72 5F 75 31 36 FF", 9, 0x00, b"M.var_u16"),
        ("2B 00 FF F3", 1, 0x00, b"\xff"),
        ("2B 40 03 FE FD 2B 2B 9E", 0, 0x40, b"\xfe\xfd\x2b"),
        ("2B 82 87", 0, 0x82, b""),
        ("2B 81 8E", 0, 0x81, b""),
    ],
)
def test_answers_from_the_wire(wire: str, size: int, status: int, data: bytes) -> None:
    assert AnswerParser(size).feed(bytes.fromhex(wire)) == Answer(status, data)


def test_padded_numbers_are_accepted() -> None:
    assert decode_uleb(bytes.fromhex("82 00")) == (2, 2)
    assert decode_uleb(bytes.fromhex("A0 80 80 80 82 00")) == (0x20000020, 6)
    assert decode_uleb(b"\xff" * 12 + b"\x01")[0] == (1 << 64) - 1


@given(st.integers(0, (1 << 64) - 1), st.binary(max_size=4))
def test_uleb_round_trip(value: int, behind: bytes) -> None:
    wire = encode_uleb(value)
    assert decode_uleb(wire + behind) == (value, len(wire))


@given(st.integers(-(1 << 63), (1 << 63) - 1))
def test_sleb_round_trip(value: int) -> None:
    assert Reader(encode_sleb(value)).sleb() == value


@pytest.mark.parametrize("cut", [b"", b"\x80", b"\xff\xff"])
def test_truncated_numbers_are_errors(cut: bytes) -> None:
    with pytest.raises(CodecError, match="cut off"):
        decode_uleb(cut)


def test_invalid_requests_are_refused() -> None:
    with pytest.raises(CodecError):
        V4.encode(0x2B)
    with pytest.raises(CodecError):
        V4.encode(0x21, bytes(254))
    with pytest.raises(CodecError):
        encode_uleb(-1)
    with pytest.raises(CodecError):
        commands.write_memory(0, b"ab", b"a")
    with pytest.raises(CodecError):
        commands.send_command(0xFF)
    with pytest.raises(CodecError):
        commands.set_scope([ScopeSlot(0, 3)])


@given(st.integers(0, 255).filter(lambda c: c != 0x2B), st.binary(max_size=253))
def test_request_is_doubled_after_the_start_only(command: int, payload: bytes) -> None:
    wire = V4.encode(command, payload)
    body = bytes([command, len(payload)]) + payload
    assert wire == escaped(body + bytes([checksum(body)]))


def split(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({c % (len(data) + 1) for c in cuts})
    return [data[a:b] for a, b in zip([0, *places], [*places, len(data)], strict=True)]


def parse(parser: AnswerParser, chunks: list[bytes]) -> Answer | None:
    for chunk in chunks:
        answer = parser.feed(chunk)
        if answer is not None:
            return answer
    return None


@given(st.binary(max_size=252), st.lists(st.integers(0, 600), max_size=8))
def test_fixed_answer_is_parsed_in_any_pieces(data: bytes, cuts: list[int]) -> None:
    assert parse(AnswerParser(len(data)), split(answer_frame(0, data), cuts)) == Answer(0, data)


@given(st.binary(max_size=252), st.lists(st.integers(0, 600), max_size=8))
def test_variable_answer_is_parsed_in_any_pieces(data: bytes, cuts: list[int]) -> None:
    assert parse(AnswerParser(), split(answer_frame(0x40, data), cuts)) == Answer(0x40, data)


@given(st.binary(max_size=40).filter(lambda n: b"+" not in n), st.binary(max_size=20))
def test_leading_noise_without_start_byte_is_ignored(noise: bytes, data: bytes) -> None:
    assert AnswerParser(len(data)).feed(noise + answer_frame(0, data)) == Answer(0, data)


def test_a_new_start_aborts_an_unfinished_frame() -> None:
    assert AnswerParser(2).feed(b"+\x00\x34" + answer_frame(0, b"\x34\x12")) == Answer(0, b"\x34\x12")


def test_echo_and_debug_frames_are_no_answers() -> None:
    echo = commands.read_memory(0x2B2B, 2).frame
    assert AnswerParser(2).feed(echo + b"+\xa9\x56" * 3 + answer_frame(0, b"ab")) == Answer(0, b"ab")


def test_answer_of_another_kind_is_skipped() -> None:
    parser = AnswerParser(2, statuses=(0,))
    assert parser.feed(answer_frame(0x40, b"late") + answer_frame(0, b"ab")) == Answer(0, b"ab")
    assert (parser.passed_over, parser.trailing) == (1, False)
    assert AnswerParser(2, statuses=(0,)).feed(answer_frame(0x89)) == Answer(0x89, b"")


@pytest.mark.parametrize("extra", [b"x", b"+", b"++", b"+\x00"])
def test_bytes_after_an_answer_are_counted(extra: bytes) -> None:
    for data in (b"ab", b"a+"):
        parser = AnswerParser(2)
        assert parser.feed(answer_frame(0, data) + extra) == Answer(0, data)
        assert parser.trailing


def test_damage_is_counted_and_the_next_frame_is_parsed() -> None:
    parser = AnswerParser(2)
    broken = bytearray(answer_frame(0, b"ab"))
    broken[2] ^= 0x01
    assert parser.feed(bytes(broken)) is None
    assert parser.crc_errors == 1
    assert parser.feed(answer_frame(0, b"ab")) == Answer(0, b"ab")


@given(st.lists(st.binary(max_size=60), max_size=12), st.integers(0, 252))
def test_parser_accepts_arbitrary_bytes(chunks: list[bytes], size: int) -> None:
    parser = AnswerParser(size)
    for chunk in chunks:
        answer = parser.feed(chunk)
        assert answer is None or answer.is_error or len(answer.data) <= 255
    # An incomplete escaped byte may hide one start byte at most.
    frame = answer_frame(0, bytes(size))
    assert parser.feed(frame) is not None or parser.feed(frame) is not None


@given(st.integers(0, 7), st.integers(0, 10_000), st.binary(min_size=1, max_size=30))
def test_one_flipped_bit_is_never_accepted_as_the_same_kind_of_answer(bit: int, place: int, data: bytes) -> None:
    wire = bytearray(answer_frame(0, data))
    wire[place % len(wire)] ^= 1 << bit
    # An additional or missing start byte shifts the frame; the checksum detects 255 of 256 such frames.
    assume(wire.count(b"+") == 1 == answer_frame(0, data).count(b"+"))
    answer = AnswerParser(len(data)).feed(bytes(wire))
    assert answer is None or answer.status != 0 or answer.data == data
