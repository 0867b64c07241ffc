"""A board whose configuration has passwords requires a login on its serial line."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import pytest
from servo_bridge.freemaster.frames import V4, encode_uleb
from servo_msgs_py.text_file import read_toml
from servo_tuning.reading import SERVO_TOML
from servo_twin.board import Board
from servo_twin.servo_config import ServoConfig

PASSWORDS = {"command": b"drive", "tune": b"gains"}
NEEDED, OK = 0x91, 0x00
QUICK_STOP, CLEAR_FAULTS, KEEP_ALIVE = 1, 2, 4  # application commands
DONE, LEVEL = 0, 2


@pytest.fixture(scope="module")
def configuration() -> ServoConfig:
    table: dict[str, Any] = read_toml(SERVO_TOML)
    table["board"]["passwords"] = {level: f"sha1:{hashlib.sha1(text).hexdigest()}" for level, text in PASSWORDS.items()}
    return ServoConfig.of_table(table)


@pytest.fixture
def board(configuration: ServoConfig) -> Iterator[Board]:
    with Board(seed=1, level="ideal", servo=configuration) as board:
        board.run(0.01)
        yield board


def ask(board: Board, code: int, payload: bytes) -> bytes:
    """Status and data of the answer."""
    board.serial_in(V4.encode(code, payload))
    board.run(0.05)
    return board.serial_out()[1:-1].replace(b"\x2b\x2b", b"\x2b")


def write(board: Board, name: str, data: bytes) -> int:
    """Status of writing a variable."""
    return ask(board, 0x23, b"\x00" + encode_uleb(board.address(name)) + bytes([len(data)]) + data)[0]


def log_in(board: Board, level: int, password: bytes) -> bytes:
    salt = ask(board, 0x2C, bytes([level]))[3:19]
    return ask(board, 0x2D, bytes([level]) + hashlib.sha1(salt + hashlib.sha1(password).digest() + salt).digest())


def command_result(board: Board, code: int) -> int:
    """Result of an application command."""
    assert ask(board, 0x30, bytes([code]))[0] == OK
    return ask(board, 0x31, b"")[1]


def test_commands_and_parameters_need_their_password(board: Board) -> None:
    command = ("cmd.speed", bytes(8))
    parameter = ("param.host_timeout", b"\x00\x08")
    save = ("storage.request", b"\x01\x00\x07\x00")
    assert (write(board, *command), write(board, *parameter)) == (NEEDED, NEEDED)
    assert log_in(board, 2, b"drive") == b"\x00\x02"
    assert (write(board, *command), write(board, *parameter), write(board, *save)) == (OK, NEEDED, NEEDED)
    assert log_in(board, 3, b"gains") == b"\x00\x03"
    assert (write(board, *command), write(board, *parameter)) == (OK, OK)
    assert write(board, *save) == OK
    assert board.read_words("param.host_timeout") == [2048]
    assert command_result(board, CLEAR_FAULTS) == DONE
    assert log_in(board, 3, b"guess") == b"\x92"
    assert (command_result(board, CLEAR_FAULTS), command_result(board, KEEP_ALIVE)) == (LEVEL, LEVEL)
    assert command_result(board, QUICK_STOP) == DONE, "every client may stop an axis"
    assert (write(board, *command), write(board, *parameter)) == (NEEDED, NEEDED)
