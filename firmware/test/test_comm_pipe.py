"""The console: text of the board for the client, byte-exact and complete on a line with lost frames."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from freemaster_board import Board
from freemaster_model import TINY, Answer, Layout, examples
from hypothesis import given
from hypothesis import strategies as st

PIPE, GET_PIPE = 0x28, 0x2F
CLOSED = Answer(0x8C)
QUEUE = 96


def even(ack: int = 0, data: bytes = b"", port: int = 1) -> bytes:
    return bytes([port, ack]) + data


def odd(ack: int = 0, data: bytes = b"") -> bytes:
    return even(ack, data, 0x81)


def test_exchange_byte_by_byte(servo: Board) -> None:
    """With the example frames of the protocol, without the echo."""
    assert servo.send(bytes.fromhex("2B 28 02 01 00 BD")) == bytes.fromhex("2B 40 02 01 00 58")
    servo.print(b"hello")
    assert servo.send(bytes.fromhex("2B 28 07 81 00 68 65 6C 6C 6F 72")) == bytes.fromhex(
        "2B 40 07 81 05 68 65 6C 6C 6F 29"
    )
    assert servo.send(bytes.fromhex("2B 28 02 01 05 A6")) == bytes.fromhex("2B 40 02 01 00 58")
    assert servo.send(bytes.fromhex("2B 28 02 09 00 15")) == bytes.fromhex("2B 8C AD")


def test_repeated_request_acknowledges_and_accepts_nothing(servo: Board) -> None:
    servo.print(b"one ")
    first = Answer(0x40, b"\x01\x03one ")
    assert servo.ask(PIPE, even(0, b"abc")) == first
    servo.print(b"two")
    assert servo.ask(PIPE, even(4, b"other")) == Answer(0x40, b"\x01\x03one two"), "not as new"
    assert servo.ask(PIPE, odd(4)) == Answer(0x40, b"\x81\x00two")
    assert servo.ask(PIPE, odd(3)) == Answer(0x40, b"\x81\x00two"), "the same again"
    assert servo.ask(PIPE, even(3)) == Answer(0x40, b"\x01\x00")


def test_client_can_start_with_any_toggle(servo: Board) -> None:
    """The client sends an empty frame with any toggle and continues with the other toggle."""
    servo.ask(PIPE, even())
    servo.print(b"text")
    assert servo.ask(PIPE, even()) == Answer(0x40, b"\x01\x00text")
    assert servo.ask(PIPE, odd(4, b"x")) == Answer(0x40, b"\x81\x01")


def test_queue_is_filled_with_whole_texts(servo: Board) -> None:
    servo.print(b"a" * 60)
    servo.print(b"b" * 37)
    servo.print(b"c" * 36)
    text = b"a" * 60 + b"c" * 36
    assert servo.ask(PIPE, even()).data[2:] == text
    assert servo.ask(PIPE, odd(255)).data[2:] == b"", "a length above the available text returns all of it"
    servo.print(b"d" * (QUEUE + 1))
    assert servo.ask(PIPE, even()).data[2:] == b""


@pytest.mark.parametrize("payload", [b"", b"\x01", b"\x00\x00", b"\x80\x00", b"\x02\x00", b"\xff\x00"])
def test_missing_pipe_is_reported(servo: Board, payload: bytes) -> None:
    assert servo.ask(PIPE, payload) == CLOSED


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (b"\x00\x00\x82", Answer(0x40, b"\x01\x00\x01")),
        (b"\x01\x01\x82", Answer(0x40, b"\x01\x00\x01")),
        (b"\x01\x01", Answer(0x40, b"\x01\x00\x01")),
        (b"\x00\x00\x81", Answer(0x40, b"log")),
        (b"\x03\x01\x81", Answer(0x40, b"log")),
        (b"\x01\x02\x82", CLOSED),
        (b"\x01\x00\x82", CLOSED),
        (b"\x00\x01\x82", Answer(0x94)),
        (b"\x00", CLOSED),
        (b"", CLOSED),
    ],
)
def test_properties_of_the_pipes_are_reported(servo: Board, payload: bytes, expected: Answer) -> None:
    assert servo.ask(GET_PIPE, payload) == expected


def test_text_is_sent_in_parts_that_fit_the_frame(new_board: Callable[[Layout], Board]) -> None:
    board = new_board(TINY)
    text = bytes(range(0x30, 0x30 + 70))
    board.print(text)
    maximum = TINY.mtu - 3
    assert board.ask(PIPE, even()).data == b"\x01\x00" + text[:maximum]
    assert board.ask(PIPE, odd(maximum)).data == b"\x81\x00" + text[maximum : 2 * maximum]
    assert board.ask(PIPE, even(maximum)).data == b"\x01\x00" + text[2 * maximum :]


@given(seed=st.integers(0, 2**32 - 1))
@examples(60)
def test_no_text_is_lost_or_repeated_with_lost_answers(shared_servo: Board, seed: int) -> None:
    board, source = shared_servo, random.Random(seed)
    board.set_passwords(None, None, None)  # restarts
    printed, fetched = b"", b""
    port, received = 1, 0
    for turn in range(40):
        text = bytes(source.choices(b"+abc", k=source.randrange(20))) if turn < 30 else b""
        if len(printed) - len(fetched) + len(text) <= QUEUE - received:
            board.print(text)
            printed += text
        reply = board.ask(PIPE, bytes([port, received]))
        while source.random() < 0.4:  # its answer is lost: the same again
            reply = board.ask(PIPE, bytes([port, received]))
        received = len(reply.data) - 2
        fetched += reply.data[2:]
        port ^= 0x80
    assert fetched == printed
