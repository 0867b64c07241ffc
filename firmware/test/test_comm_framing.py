"""Receiver and transmitter: start byte, doubling, checksum, sizes, behaviour between requests."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from freemaster_board import Board
from freemaster_model import ENTRIES, TINY, Answer, Layout, answer, crc8, double, examples, parse_answer, request, uleb
from hypothesis import given
from hypothesis import strategies as st

MTU_REQUEST = request(0x20, b"\x01")


def mtu_answer(board: Board) -> bytes:
    return answer(0x40, b"MTU\0" + uleb(board.layout.mtu))


def large(board: Board) -> int:
    """Address of the largest variable."""
    return board.layout.address(next(entry for entry in ENTRIES if entry.name == "M.large"))


def test_noise_before_a_frame_is_ignored(servo: Board) -> None:
    assert servo.send(b"\x00\xff\x21\x02" + MTU_REQUEST) == mtu_answer(servo)


def test_double_start_byte_discards_the_frame_without_an_answer(servo: Board) -> None:
    assert servo.send(b"\x2b" + MTU_REQUEST) == b""
    assert servo.send(b"\x2b\x2b" + MTU_REQUEST) == mtu_answer(servo)


def test_new_start_aborts_an_unfinished_frame(servo: Board) -> None:
    for cut in range(2, len(MTU_REQUEST)):
        assert servo.send(MTU_REQUEST[:cut] + MTU_REQUEST) == mtu_answer(servo)
    assert servo.statistics().aborted == len(MTU_REQUEST) - 2


def test_gap_inside_a_frame_is_tolerated(servo: Board) -> None:
    for byte in MTU_REQUEST[:-1]:
        assert servo.send(bytes([byte])) == b""
        assert servo.poll() == b""
    assert servo.send(MTU_REQUEST[-1:]) == mtu_answer(servo)


def test_a_wrong_checksum_is_answered_with_its_error(servo: Board) -> None:
    damaged = MTU_REQUEST[:-1] + bytes([MTU_REQUEST[-1] ^ 1])
    assert servo.send(damaged) == bytes.fromhex("2B 82 87")
    assert servo.send(MTU_REQUEST) == mtu_answer(servo)
    assert (servo.statistics().bad_crc, servo.statistics().requests) == (1, 1)


@pytest.mark.parametrize("board_name", ["sheet", "servo"])
def test_the_largest_request_fits_and_a_longer_one_is_refused(board_name: str, request: pytest.FixtureRequest) -> None:
    board: Board = request.getfixturevalue(board_name)
    largest = board.layout.mtu - 2
    fits = bytes([0x20, largest]) + b"\x01" + bytes(largest - 1)
    assert board.send(double(fits + bytes([crc8(fits)]))) == mtu_answer(board)
    longer = bytes([0x20, largest + 1]) + b"\x01" + bytes(largest)
    assert board.send(double(longer + bytes([crc8(longer)]))) == bytes.fromhex("2B 83 80")
    assert board.send(double(longer + b"\x55")) == bytes.fromhex("2B 83 80"), "reported even with a wrong checksum"
    assert board.statistics().too_long == 2


def test_length_fe_is_answered_and_ff_is_not(servo: Board) -> None:
    assert servo.send(double(bytes([0x20, 0xFE]) + bytes(254) + b"\x00")) == bytes.fromhex("2B 83 80")
    assert servo.statistics().aborted == 0
    assert servo.send(double(bytes([0x20, 0xFF]) + bytes(300))) == b""
    assert servo.statistics().aborted == 1
    assert servo.send(MTU_REQUEST) == mtu_answer(servo)


def test_empty_payload_is_a_complete_frame(servo: Board) -> None:
    assert servo.send(request(0x31)) == answer(0, b"\xff")
    assert servo.statistics().aborted == 0


@pytest.mark.parametrize(("board_name", "good", "bad"), [("sheet", 240, (241,)), ("servo", 252, (253, 254, 255))])
def test_the_largest_answer_fits_and_a_longer_one_is_refused(
    board_name: str, good: int, bad: tuple[int, ...], request: pytest.FixtureRequest
) -> None:
    board: Board = request.getfixturevalue(board_name)
    assert board.ask(0x21, uleb(large(board)) + uleb(good)).data == board.memory()[0x100 : 0x100 + good]
    for size in bad:
        assert board.ask(0x21, uleb(large(board)) + uleb(size)) == Answer(0x84)


def double_read(address: int, size: int) -> bytes:
    """READMEM request."""
    return request(0x21, uleb(address) + uleb(size))


def test_the_smallest_buffer_answers_short_requests(new_board: Callable[[Layout], Board]) -> None:
    board = new_board(TINY)
    assert board.ask(0x21, uleb(large(board)) + uleb(32)).data == board.memory()[0x100 : 0x100 + 32]
    assert board.ask(0x21, uleb(large(board)) + uleb(33)) == Answer(0x84)
    assert board.send(request(0x20, b"\x01" + bytes(29))) == mtu_answer(board)
    assert board.send(request(0x20, b"\x01" + bytes(30))) == answer(0x83)
    assert board.ask(0x26, b"\x00\x01\x01\x05").status == 0
    for slot in range(5):
        operand = bytes([slot]) + uleb(large(board)) + b"\x08"
        assert board.ask(0x26, bytes([0, 2, len(operand)]) + operand).status == 0
    assert board.ask(0x27, b"\x00") == Answer(0x84), "five slots of eight bytes"
    assert board.ask(0x20, b"\x00DS\0") == Answer(0x84), "a description of 34 characters"
    assert board.violations() == 0


def test_every_field_may_contain_2b(servo: Board) -> None:
    """Length, payload and checksum of 2B, in both directions."""
    address = large(servo)
    assert servo.ask(0x23, b"\x00" + uleb(address) + uleb(38) + b"\x2b" * 38).status == 0
    length_is_2b = request(0x23, b"\x00" + uleb(address) + uleb(39) + b"\x2b" * 39)
    assert length_is_2b[2:4] == b"\x2b\x2b"
    assert servo.send(length_is_2b) == answer(0)
    assert servo.memory()[0x100 : 0x100 + 39] == b"\x2b" * 39
    seen = set()
    for value in range(256):
        wire = servo.send(request(0x23, b"\x00" + uleb(address) + b"\x01" + bytes([value])))
        assert wire == answer(0)
        wire = servo.send(double_read(address, 1))
        assert wire == answer(0, bytes([value]))
        seen.add(crc8(bytes([0, value])))
    assert 0x2B in seen


def test_slow_transmitter_gets_every_byte_once(servo: Board) -> None:
    servo.poke(0x100, b"\x2b\x00" * 20)
    servo.set_put_room(1)
    servo.feed(double_read(large(servo), 40))
    expected = answer(0, b"\x2b\x00" * 20)
    assert [servo.poll() for _ in expected] == [bytes([byte]) for byte in expected]
    assert servo.poll() == b""


def test_requests_are_discarded_while_an_answer_is_pending(servo: Board) -> None:
    servo.set_put_room(2)
    sent = servo.send(MTU_REQUEST + MTU_REQUEST)
    for _ in range(8):
        sent += servo.send(MTU_REQUEST[:2])
    assert sent == mtu_answer(servo)
    assert servo.statistics().requests == 1
    assert servo.statistics().bytes_lost >= len(MTU_REQUEST)
    servo.set_put_room(512)
    assert servo.send(MTU_REQUEST) == mtu_answer(servo)


def test_statistics_count_refused_requests(servo: Board) -> None:
    assert servo.ask(0x21, uleb(0) + uleb(1)) == Answer(0x89)
    servo.ask(0x20, b"\x01")
    assert (servo.statistics().requests, servo.statistics().refused) == (2, 1)


@given(data=st.binary(min_size=1, max_size=120), chunks=st.lists(st.integers(1, 7), max_size=40))
@examples(150)
def test_any_bytes_are_transferred_in_both_directions(shared_servo: Board, data: bytes, chunks: list[int]) -> None:
    """Data written in parts of any size are read back unchanged in spite of doubled bytes."""
    board = shared_servo
    wire = request(0x23, b"\x00" + uleb(large(board)) + uleb(len(data)) + data)
    sent = b""
    for size in chunks:
        sent += board.send(wire[:size])
        wire = wire[size:]
    assert sent + board.send(wire) == answer(0)
    assert parse_answer(board.send(double_read(large(board), len(data)))).data == data
