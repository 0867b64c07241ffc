"""Descriptions of boards and their names."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from pathlib import Path

import pytest
from servo_msgs_py.board_description import (
    DEFAULT_BOARD,
    RANGES,
    BoardDescription,
    OtherBoardError,
    board_of,
    check_board,
    known_boards,
)
from servo_msgs_py.text_file import read_toml, toml_text

from servo_msgs_py import units


@pytest.mark.parametrize("name", known_boards())
def test_every_description_is_complete(name: str) -> None:
    board = BoardDescription.load(name)
    assert board.name == name
    assert all(full_scale > 0.0 for full_scale in board.ranges.values())


@pytest.mark.parametrize("entry", [*(field.name for field in fields(BoardDescription)[1:]), *RANGES])
@pytest.mark.parametrize("value", [None, "x"])
def test_an_entry_that_is_missing_or_no_number_is_named(tmp_path: Path, entry: str, value: str | None) -> None:
    table = asdict(BoardDescription.load(DEFAULT_BOARD))
    del table["name"]
    group = table["ranges"] if entry in RANGES else table
    del group[entry]
    group |= {} if value is None else {entry: value}
    file = tmp_path / "mine.toml"
    file.write_text(toml_text(table), encoding="utf-8")
    with pytest.raises(OtherBoardError, match=f"mine.toml: .*{entry}") as refusal:
        BoardDescription.load(str(file))
    assert str(refusal.value).count("mine") == 1


@pytest.mark.parametrize("entry", [*(field.name for field in fields(BoardDescription)[1:-1]), *RANGES])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_number_that_no_board_has_is_refused(entry: str, value: float) -> None:
    table = asdict(BoardDescription.load(DEFAULT_BOARD))
    del table["name"]
    (table["ranges"] if entry in RANGES else table)[entry] = value
    with pytest.raises(ValueError, match=str(value).split(".")[0]):
        BoardDescription.parse("mine", table)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("folder.toml", "it is no file"),
        ("absent.toml", "No such file"),
        ("link.toml", "Too many levels"),
        (f"{'a' * 300}.toml", "File name too long"),
        ("binary.toml", "save it as UTF-8"),
        ("empty.toml", "missing or unknown"),
        ("half.toml", "correct the TOML"),
    ],
)
def test_a_file_that_is_no_description_is_refused(tmp_path: Path, name: str, reason: str) -> None:
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "link.toml").symlink_to("link.toml")
    (tmp_path / "binary.toml").write_bytes(b"\0\xff\xfe\0")
    (tmp_path / "empty.toml").touch()
    (tmp_path / "half.toml").write_text("shunts = [")
    with pytest.raises(OtherBoardError, match=reason):
        BoardDescription.load(str(tmp_path / name))


def test_the_variables_use_the_known_ranges() -> None:
    scales = read_toml(Path(units.__file__).with_name("variables.toml"))["scales"].values()
    assert {scale["range"] for scale in scales if "range" in scale} == set(RANGES)


def test_an_unknown_board_is_refused_with_its_name_and_the_known_ones() -> None:
    with pytest.raises(OtherBoardError, match=f"board 'mine': No such file .*; known are .*{DEFAULT_BOARD}"):
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
