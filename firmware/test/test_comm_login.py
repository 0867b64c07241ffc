"""Passwords: access levels for reading, writing and tuning, and the proof of a password by a client."""

from __future__ import annotations

import hashlib
from typing import Any

import cffi
import pytest
from c_declarations import declarations
from firmware_compiler import CompileC
from freemaster_board import Board
from freemaster_model import SERVO, Answer, answer, examples, request, uleb
from hypothesis import given
from hypothesis import strategies as st

READ, READ_BA, WRITE, AUTH1, AUTH2 = 0x21, 0x22, 0x23, 0x2C, 0x2D
NEEDED, WRONG, DENIED, BAD_SIZE, UNKNOWN = Answer(0x91), Answer(0x92), Answer(0x89), Answer(0x86), Answer(0x81)
OK = Answer(0)
SETS = [
    [b"v", None, None],
    [None, b"c", None],
    [None, None, b"t"],
    [b"v", b"c", None],
    [b"v", None, b"t"],
    [None, b"c", b"t"],
    [b"v", b"c", b"t"],
    [b"same", b"c", b"same"],
]
COMMANDED, TUNED, READ_ONLY = 0x20, 0x100, 0x2A  # offsets in the memory of the harness


def key_for(salt: bytes, password: bytes) -> bytes:
    """Key that proves the password."""
    return hashlib.sha1(salt + hashlib.sha1(password).digest() + salt).digest()


def challenge(board: Board, level: int) -> bytes:
    """Salt for a level that needs a password."""
    reply = board.ask(AUTH1, bytes([level]))
    assert (reply.status, reply.data[0], len(reply.data)) == (0x40, 1, 17)
    return reply.data[1:]


def log_in(board: Board, level: int, password: bytes) -> Answer:
    return board.ask(AUTH2, bytes([level]) + key_for(challenge(board, level), password))


def may(board: Board) -> int:
    """Present access level of the client."""
    at = [uleb(SERVO.variables + offset) + b"\x01" for offset in (COMMANDED, COMMANDED, TUNED)]
    answers = [board.ask(READ, at[0]), *(board.ask(WRITE, b"\x00" + place + b"\x05") for place in at[1:])]
    allowed = [reply.status == 0 for reply in answers]
    assert allowed == sorted(allowed, reverse=True)
    assert all(reply.status == 0 or reply == NEEDED for reply in answers)
    assert sum(allowed) == board.level()
    return sum(allowed)


def test_without_passwords_every_access_is_permitted(servo: Board) -> None:
    assert may(servo) == 3
    assert servo.ask(AUTH1, b"\x01") == UNKNOWN
    assert servo.ask(AUTH2, bytes(21)) == UNKNOWN
    assert servo.ask(AUTH1) == UNKNOWN


def test_exchange_byte_by_byte(servo: Board) -> None:
    servo.set_passwords(b"secret", None, None)
    first = servo.send(bytes.fromhex("2B 2C 01 01 AB"))
    assert first[:4] == bytes.fromhex("2B 40 11 01")
    key = key_for(first[4:].replace(b"\x2b\x2b", b"\x2b")[:16], b"secret")
    assert servo.send(request(AUTH2, b"\x01" + key)) == bytes.fromhex("2B 00 01 07")
    assert servo.send(request(AUTH2, b"\x01" + bytes(20))) == bytes.fromhex("2B 92 F7")
    assert servo.send(bytes.fromhex("2B 2C 01 00 AC")) == bytes.fromhex("2B 40 01 00 93")
    assert servo.send(request(READ, uleb(SERVO.variables + COMMANDED) + b"\x02")) == bytes.fromhex("2B 91 FE")
    assert servo.send(bytes.fromhex("2B 20 04 00 46 31 00 A3")) == answer(0x40, b"F1\x00\x12")


@pytest.mark.parametrize("passwords", SETS)
def test_level_reached_with_each_password(servo: Board, passwords: list[bytes | None]) -> None:
    servo.set_passwords(*passwords)
    guarded = next(level for level in (1, 2, 3) if passwords[level - 1] is not None)
    assert servo.ask(0x20, b"\x00F1\0").data == b"F1\0" + bytes([0x02 | guarded << 4])
    assert may(servo) == guarded - 1
    for level in range(guarded, 4):
        for password in {text for text in passwords if text is not None}:
            best = max(k for k in range(1, 4) if needed(passwords, k) == password)
            assert log_in(servo, level, password) == Answer(0, bytes([min(best, level)]))
            assert may(servo) == min(best, level)
            assert log_in(servo, level, b"wrong") == WRONG
            assert may(servo) == guarded - 1, "the earlier level is lost"


def needed(passwords: list[bytes | None], level: int) -> bytes | None:
    """Password of the level, or of the next lower level."""
    return next((text for text in reversed(passwords[:level]) if text is not None), None)


def test_levels_that_need_no_password_are_set_at_once(servo: Board) -> None:
    servo.set_passwords(None, None, b"t")
    for level in (0, 1, 2):
        assert servo.ask(AUTH1, bytes([level])) == Answer(0x40, b"\x00")
        assert may(servo) == level
    assert len(challenge(servo, 3)) == 16
    assert len(challenge(servo, 200)) == 16, "a level that does not exist needs the highest password"
    assert log_in(servo, 200, b"t") == Answer(0, b"\x03")


def test_password_comes_before_the_table_and_the_table_before_tuning(servo: Board) -> None:
    servo.set_passwords(b"v", b"c", b"t")
    nowhere, constant = uleb(5) + b"\x01", uleb(SERVO.variables + READ_ONLY) + b"\x01"
    assert servo.ask(READ, nowhere) == servo.ask(READ_BA, b"\x7c\x02") == servo.ask(WRITE, b"\x00" + nowhere) == NEEDED
    log_in(servo, 1, b"v")
    assert servo.ask(READ, nowhere) == servo.ask(READ_BA, b"\x7c\x02") == DENIED
    assert servo.ask(WRITE, b"\x00" + constant + b"\x05") == NEEDED
    log_in(servo, 2, b"c")
    assert servo.ask(WRITE, b"\x00" + constant + b"\x05") == DENIED
    assert servo.ask(WRITE, b"\x00" + uleb(SERVO.variables + TUNED) + b"\x01\x05") == NEEDED
    assert [event[0] for event in servo.events()].count("written") == 0


def test_some_commands_need_no_password(servo: Board) -> None:
    """As on vendor targets: identification, table list, scope, application commands."""
    servo.set_passwords(b"v", None, None)
    slot = b"\x00\x01\x01\x01\x02\x05\x00" + uleb(SERVO.variables + COMMANDED) + b"\x02"
    slot = slot[:5] + bytes([len(slot) - 6]) + slot[6:]
    assert servo.ask(0x29, b"\x00").status == servo.ask(0x2A, uleb(SERVO.strings)).status == 0x40
    assert servo.ask(0x26, slot) == OK
    assert servo.ask(0x27, b"\x00").data == servo.memory()[COMMANDED : COMMANDED + 2]
    assert servo.ask(0x30, b"\x05") == OK
    assert servo.ask(READ, uleb(SERVO.table) + b"\x10") == NEEDED
    assert servo.read(SERVO.variables + COMMANDED, 2)[0] == 0, "not by the serial line"
    assert servo.write(SERVO.variables + TUNED, b"\x01") == 0


def test_salt_is_valid_for_one_challenge(servo: Board) -> None:
    servo.set_passwords(b"v", None, None)
    assert servo.ask(AUTH2, b"\x01" + key_for(bytes(16), b"v")) == WRONG, "no challenge yet"
    proof = b"\x01" + key_for(challenge(servo, 1), b"v")
    assert servo.ask(AUTH2, proof) == servo.ask(AUTH2, proof) == Answer(0, b"\x01"), "a repeated request"
    servo.ask(AUTH1, b"\x00")
    assert servo.ask(AUTH2, proof) == WRONG, "logged out"
    salts = [challenge(servo, 1) for _ in range(50)]
    assert len(set(salts)) == len(salts)
    assert servo.ask(AUTH2, proof) == WRONG, "a key of an older salt"


def test_an_incomplete_login_is_refused(servo: Board) -> None:
    servo.set_passwords(b"v", None, None)
    assert servo.ask(AUTH1) == BAD_SIZE
    key = key_for(challenge(servo, 1), b"v")
    for cut in range(1, 22):
        assert servo.ask(AUTH2, (b"\x01" + key)[:-cut]) == BAD_SIZE
    assert servo.ask(AUTH2, b"\x01" + key + b"more") == Answer(0, b"\x01")


ACTION = st.tuples(st.integers(0, 4), st.sampled_from([b"v", b"c", b"t", b"same", b"x", None]))


@given(passwords=st.sampled_from(SETS), actions=st.lists(ACTION, max_size=12))
@examples(150)
def test_any_sequence_agrees_with_the_model(
    shared_servo: Board, passwords: list[bytes | None], actions: list[tuple[int, bytes | None]]
) -> None:
    board = shared_servo
    board.set_passwords(*passwords)
    start = next(k for k in (1, 2, 3) if passwords[k - 1] is not None) - 1
    level, salt = start, None
    for requested, password in actions:
        if password is None:
            reply = board.ask(AUTH1, bytes([requested]))
            open_ = requested <= start
            salt = None if open_ else reply.data[1:]
            level = requested if open_ else level
            assert (reply.data == b"\x00") is open_
        else:
            reply = board.ask(AUTH2, bytes([requested]) + key_for(salt or bytes(16), password))
            known = [k for k in (1, 2, 3) if needed(passwords, k) == password and salt is not None]
            if requested == 0:
                assert reply == Answer(0, b"\x00")
            else:
                level = min(max(known), requested) if known else start
                assert reply == (Answer(0, bytes([level])) if known else WRONG)
        assert board.level() == level


@pytest.fixture(scope="module")
def digest(compile_c: CompileC) -> tuple[cffi.FFI, Any]:
    return compile_c("sha1", ["comm/sha1.c"], declarations("comm/sha1.h"))


@pytest.mark.parametrize("size", range(56))
def test_sha1_agrees_with_hashlib(digest: tuple[cffi.FFI, Any], size: int) -> None:
    ffi, lib = digest
    message = hashlib.sha256(bytes([size])).digest() * 2
    result = ffi.new("uint8_t[20]")
    lib.sha1(message, size, result)
    assert bytes(ffi.buffer(result)) == hashlib.sha1(message[:size]).digest()
