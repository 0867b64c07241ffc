"""The data flash of the MC56F84789 port: commands to the controller and their results."""

from __future__ import annotations

import pytest
from firmware_compiler import CompileC
from port_board import FakeBoard

STAT, ADDRESS, COMMAND, LOW, HIGH = 0xE3C0, 0xE3C2, 0xE3C3, 0xE3C4, 0xE3C5
CCIF, RDCOLERR, ACCERR, FPVIOL, MGSTAT0 = 0x80, 0x40, 0x20, 0x10, 0x01
DONE, BUSY, FAILED = range(3)
FIRST = 0xB800  # the last four sectors of 512 words of 16 bits


@pytest.fixture
def board(compile_c: CompileC) -> FakeBoard:
    board = FakeBoard(compile_c)
    board[STAT] = CCIF
    board.forget()
    return board


def test_a_word_is_read_low_half_first(board: FakeBoard) -> None:
    for word in (0, 1, 1023):
        board[FIRST + 2 * word], board[FIRST + 2 * word + 1] = 0x5678 + word, 0x1234
        assert board.lib.hal_flash_read(board.hal, word) == 0x1234_5678 + word
    assert not board.writes


@pytest.mark.parametrize("sector", range(4))
def test_an_erase_names_the_first_byte_of_its_sector(board: FakeBoard, sector: int) -> None:
    """Bit 23 of the address selects the data flash."""
    board.lib.hal_flash_erase(board.hal, sector)
    byte = (28 + sector) * 1024
    assert board.writes == [(STAT, RDCOLERR | ACCERR | FPVIOL), (COMMAND, 0x0980), (ADDRESS, byte), (STAT, CCIF)]


@pytest.mark.parametrize("word", [0, 1, 255, 256, 1023])
def test_a_word_is_programmed_at_its_byte(board: FakeBoard, word: int) -> None:
    board.lib.hal_flash_program(board.hal, word, 0x89AB_CDEF)
    assert sorted(board.writes[:2]) == [(LOW, 0xCDEF), (HIGH, 0x89AB)]
    byte = 2 * (FIRST - 0x8000) + 4 * word
    assert board.writes[2:] == [(STAT, RDCOLERR | ACCERR | FPVIOL), (COMMAND, 0x0680), (ADDRESS, byte), (STAT, CCIF)]


@pytest.mark.parametrize(
    ("status", "result"),
    [
        (CCIF, DONE),
        (0, BUSY),
        (RDCOLERR, BUSY),
        (CCIF | RDCOLERR, FAILED),
        (CCIF | ACCERR, FAILED),
        (CCIF | FPVIOL, FAILED),
        (CCIF | MGSTAT0, FAILED),
        (0x0200 | CCIF, DONE),
    ],
)
def test_status_flags_give_the_result_of_a_command(board: FakeBoard, status: int, result: int) -> None:
    board[STAT] = status
    assert board.lib.hal_flash_result(board.hal) == result


def test_a_controller_that_is_never_ready_counts_as_absent(board: FakeBoard) -> None:
    assert board.lib.hal_flash_present(board.hal)
    board[STAT] = 0
    assert not board.lib.hal_flash_present(board.hal)
