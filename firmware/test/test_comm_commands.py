"""GETCONFIG, the scope, and application commands."""

from __future__ import annotations

import pytest
from freemaster_board import Board
from freemaster_model import SERVO, Answer, sleb, uleb

CONFIG, SET_SCOPE, READ_SCOPE, SEND, STATUS, DATA = 0x20, 0x26, 0x27, 0x30, 0x31, 0x32
OK = Answer(0)

KEYS = {
    "MTU": uleb(254),
    "VS": b"4.0\0",
    "NM": b"servo\0",
    "DS": b"two axes in memory, nothing turns\0",
    "BD": b"2026-01-01\0",
    "F1": b"\x02",
    "BA": uleb(SERVO.variables),
    "RC": b"\x02",
    "SC": b"\x01",
    "PV": b"\x04",
    "PC": b"\x01",
}


# ---- configuration -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("index", "key"), list(enumerate(KEYS, start=1)))
def test_configuration_by_key_and_by_index(servo: Board, index: int, key: str) -> None:
    expected = Answer(0x40, key.encode() + b"\0" + KEYS[key])
    assert servo.ask(CONFIG, b"\x00" + key.encode() + b"\0") == expected
    assert servo.ask(CONFIG, uleb(index)) == expected
    assert servo.ask(CONFIG, uleb(index, padding=2)) == expected


def test_configuration_key_is_cut_to_three_characters(servo: Board) -> None:
    assert servo.ask(CONFIG, b"\x00MTUX\0") == Answer(0x40, b"MTU\0" + uleb(254))


@pytest.mark.parametrize("key", [b"", b"mtu", b"MT", b"P", b"VSX", b"Z" * 200])
def test_an_unknown_key_is_refused(servo: Board, key: bytes) -> None:
    assert servo.ask(CONFIG, b"\x00" + key + b"\0") == Answer(0x89)


@pytest.mark.parametrize("index", [-1, -64, 12, 13, 255, 256 + 1, 65536 + 1, 2**31 - 1, -(2**31)])
def test_indices_outside_of_the_list_are_refused(servo: Board, index: int) -> None:
    assert servo.ask(CONFIG, sleb(index)) == Answer(0x89)


@pytest.mark.parametrize("payload", [b"", b"\x80", b"\x00", b"\x00MTU", b"\x00M"])
def test_incomplete_configuration_requests_are_refused(servo: Board, payload: bytes) -> None:
    servo.ask(CONFIG, b"\x00MTU\0")  # remaining bytes of an older message must not complete it
    assert servo.ask(CONFIG, payload) == Answer(0x86)


# ---- scope ---------------------------------------------------------------------------------------------------------


def slots(count: int) -> bytes:
    """Operation that resets the scope."""
    return bytes([1, 1, count])


def slot(index: int, offset: int, size: int) -> bytes:
    """Operation that sets a slot."""
    operand = bytes([index]) + uleb(SERVO.variables + offset) + bytes([size])
    return bytes([2, len(operand)]) + operand


def test_scope_of_28_slots_in_one_answer(servo: Board) -> None:
    assert servo.ask(SET_SCOPE, b"\x00" + slots(28)) == OK
    for i in range(28):
        assert servo.ask(SET_SCOPE, b"\x00" + slot(i, 0x100 + 8 * i, 8)) == OK
    servo.events()
    memory = servo.memory()
    assert servo.ask(READ_SCOPE, b"\x00") == Answer(0, memory[0x100 : 0x100 + 224])
    assert servo.events() == [("lock", 0, 0), ("unlock", 0, 0)], "all slots are read under one lock"


def test_scope_delivers_new_values(servo: Board) -> None:
    assert servo.ask(SET_SCOPE, b"\x00" + slots(2) + slot(0, 0x20, 2) + slot(1, 0x42, 1)) == OK
    for value in (b"\x01\x02", b"\x2b\x2b"):
        servo.poke(0x20, value)
        assert servo.ask(READ_SCOPE, b"\x00").data == value + servo.memory()[0x42:0x43]


def test_slots_never_set_give_no_bytes(servo: Board) -> None:
    assert servo.ask(SET_SCOPE, b"\x00" + slots(3) + slot(1, 0x20, 2)) == OK
    assert servo.ask(READ_SCOPE, b"\x00") == Answer(0, servo.memory()[0x20:0x22])
    assert servo.ask(SET_SCOPE, b"\x00" + slots(3)) == OK
    assert servo.ask(READ_SCOPE, b"\x00") == OK, "a reset clears the slots"
    assert servo.ask(SET_SCOPE, b"\x00" + slots(0)) == OK
    assert servo.ask(READ_SCOPE, b"\x00") == Answer(0x88)


@pytest.mark.parametrize(
    ("operations", "status"),
    [
        (b"", 0x00),
        (b"\x01", 0x00),  # a single extra byte is ignored
        (slots(29), 0x86),
        (b"\x01\x00", 0x86),
        (b"\x01\x03\x01\xff\xff", 0x00),  # bytes after the count are ignored
        (slot(2, 0x20, 2), 0x85),
        (slot(2, 0x20, 3), 0x85),  # the slot is checked before the size
        (b"\x02\x01\x07", 0x85),
        (slot(0, 0x20, 3), 0x86),
        (slot(0, 0x20, 0), 0x86),
        (b"\x02\x05" + slot(0, 0x20, 2)[2:] + b"\x00", 0x86),  # longer than its fields
        (b"\x02\x03\x00\xa0\x20", 0x86),  # no size
        (b"\x02\x02\x00\xa0", 0x86),  # an address that does not end
        (b"\x02\x00", 0x86),
        (slot(0, 0x42, 2), 0x89),
        (slot(0, 0xE0, 2), 0x89),
        (b"\x03\x00", 0x81),
        (b"\x02\x07\x00", 0x86),  # longer than the payload
        (b"\x02\x04\x00\x20\x02", 0x86),
    ],
)
def test_a_scope_operation_gets_its_status(servo: Board, operations: bytes, status: int) -> None:
    servo.ask(SET_SCOPE, b"\x00" + slots(2) + slot(0, 0x24, 4))
    assert servo.ask(SET_SCOPE, b"\x00" + operations).status == status
    if status != 0:
        assert servo.ask(READ_SCOPE, b"\x00").data == servo.memory()[0x24:0x28], "an error leaves the setup"


def test_operations_before_an_error_stay_done(servo: Board) -> None:
    operations = slots(2) + slot(0, 0x20, 2) + slot(7, 0x24, 4) + slot(1, 0x24, 4)
    assert servo.ask(SET_SCOPE, b"\x00" + operations) == Answer(0x85)
    assert servo.ask(READ_SCOPE, b"\x00").data == servo.memory()[0x20:0x22]


@pytest.mark.parametrize(("payload", "status"), [(b"", 0x86), (b"\x01", 0x94), (b"\xff\x01\x01\x01", 0x94)])
def test_only_scope_0_exists(servo: Board, payload: bytes, status: int) -> None:
    assert servo.ask(SET_SCOPE, payload) == Answer(status)
    assert servo.ask(READ_SCOPE, payload) == Answer(status)


# ---- application commands ------------------------------------------------------------------------------------------


def test_command_runs_once_inside_the_first_status_request(servo: Board) -> None:
    assert servo.ask(STATUS) == Answer(0, b"\xff")
    assert servo.ask(SEND, b"\x11\x01\x02") == OK
    assert servo.events() == []
    assert servo.ask(SEND, b"\x11\x01\x02") == Answer(0x87), "a repeated request does not run it twice"
    assert servo.ask(DATA, b"\x01\x00") == Answer(0x87)
    assert servo.ask(STATUS) == Answer(0, b"\x42")
    assert servo.events() == [("command", 0x11, 2)]
    assert servo.ask(STATUS) == Answer(0, b"\x42"), "the result stays readable"
    assert servo.events() == []


def test_result_data_are_read_in_parts(servo: Board) -> None:
    servo.ask(SEND, b"\x11" + bytes(range(32)))
    servo.ask(STATUS)
    result = bytes(255 - i for i in range(32))
    assert servo.ask(DATA, b"\x20\x00") == Answer(0x40, result)
    assert servo.ask(DATA, b"\x02\x1e") == Answer(0x40, result[30:])
    for payload in (b"\x00\x00", b"\x21\x00", b"\x02\x1f", b"\x01\x20", b"\x01" + uleb(2**32 - 1)):
        assert servo.ask(DATA, payload) == Answer(0x86)
    assert servo.ask(DATA, uleb(254) + b"\x00") == Answer(0x86)
    assert servo.ask(DATA, uleb(255) + b"\x00") == Answer(0x84)
    assert servo.ask(DATA, uleb(2**32 - 1) + b"\x01") == Answer(0x84)
    for payload in (b"", b"\x01", b"\x81\x80"):
        assert servo.ask(DATA, payload) == Answer(0x86)


def test_result_data_of_an_older_command_are_discarded(servo: Board) -> None:
    servo.ask(SEND, b"\x11\x01\x02\x03")
    servo.ask(STATUS)
    servo.ask(SEND, b"\x05")
    assert servo.ask(STATUS) == Answer(0, b"\x05")
    assert servo.ask(DATA, b"\x01\x00") == Answer(0x86)


def test_no_data_before_the_first_command(servo: Board) -> None:
    assert servo.ask(DATA, b"\x01\x00") == Answer(0x86)


def test_missing_or_too_many_arguments_are_refused(servo: Board) -> None:
    assert servo.ask(SEND) == Answer(0x86)
    assert servo.ask(SEND, b"\x11" + bytes(33)) == Answer(0x85)
    assert servo.ask(STATUS) == Answer(0, b"\xff"), "refused commands are not pending"
    assert servo.ask(SEND, b"\x11" + bytes(32)) == OK


def test_reserved_result_codes_are_not_passed_on(servo: Board) -> None:
    assert servo.ask(SEND, b"\xff") == Answer(0x81), "would look like a pending command"
    for code, result in ((0xF7, 0xF7), (0xF8, 0xF7), (0xFD, 0xF7)):
        assert servo.ask(SEND, bytes([code])) == OK
        assert servo.ask(STATUS) == Answer(0, bytes([result])), "reserved results are not sent"


LATER = b"\xfe"
"""A command that the application of the harness finishes only on request."""


def test_command_can_be_finished_later(servo: Board) -> None:
    servo.ask(SEND, b"\x11\x01")
    servo.ask(STATUS)
    servo.finish(0x21)
    assert servo.ask(STATUS) == Answer(0, b"\x42"), "no command is pending"
    assert servo.ask(SEND, LATER + b"\x07") == OK
    servo.finish(0x21, b"early")
    for _ in range(3):
        assert servo.ask(STATUS) == Answer(0, b"\xfe"), "finishing does not start a command"
        assert servo.ask(SEND, b"\x11") == servo.ask(DATA, b"\x01\x00") == Answer(0x87)
    assert [event for event in servo.events() if event[0] == "command"] == [("command", 0x11, 1), ("command", 0xFE, 1)]
    servo.finish(0x21, b"done")
    servo.finish(0x22, b"twice")
    assert servo.ask(STATUS) == Answer(0, b"\x21")
    assert servo.ask(DATA, b"\x04\x00") == Answer(0x40, b"done")
    assert servo.ask(DATA, b"\x05\x00") == Answer(0x86)
    assert servo.ask(SEND, b"\x11") == OK
    assert servo.ask(STATUS) == Answer(0, b"\x42")


@pytest.mark.parametrize(("code", "result", "answered"), [(0xFE, b"", 0xF7), (0xFF, b"", 0xF7), (0, bytes(40), 0)])
def test_result_codes_of_a_later_finish_are_checked(servo: Board, code: int, result: bytes, answered: int) -> None:
    servo.ask(SEND, LATER)
    servo.ask(STATUS)
    servo.finish(code, result)
    assert servo.ask(STATUS) == Answer(0, bytes([answered]))
    size = min(len(result), 32)
    assert servo.ask(DATA, bytes([size + 1, 0])) == Answer(0x86)
    assert servo.ask(SEND, b"\x05") == OK
