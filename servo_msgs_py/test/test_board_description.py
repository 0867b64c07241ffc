"""Descriptions of boards and their names."""

from __future__ import annotations

import pytest
from servo_msgs_py.board_description import (
    DEFAULT_BOARD,
    BoardDescription,
    OtherBoardError,
    board_of,
    check_board,
    known_boards,
)


@pytest.mark.parametrize("name", known_boards())
def test_every_description_is_complete(name: str) -> None:
    board = BoardDescription.load(name)
    assert board.name == name
    assert all(full_scale > 0.0 for full_scale in board.ranges.values())


def test_an_unknown_board_is_refused_with_its_name_and_the_known_ones() -> None:
    with pytest.raises(OtherBoardError, match=f"board 'mine'; known are .*{DEFAULT_BOARD}"):
        BoardDescription.load("mine")
    own = BoardDescription.load()
    with pytest.raises(OtherBoardError, match=f"'mine' is not the board '{own.name}' .*; known are .*{own.name}"):
        check_board("mine", own)
    check_board(own.name, own)


@pytest.mark.parametrize(
    ("reported", "board"),
    [("servo/mine", "mine"), ("servo", DEFAULT_BOARD), ("servo/", DEFAULT_BOARD), ("pump/mine", None), ("", None)],
)
def test_a_firmware_reports_its_board(reported: str, board: str | None) -> None:
    assert board_of(reported) == board
