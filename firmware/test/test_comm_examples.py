"""Frames recorded from vendor targets, sent to the server in order."""

from __future__ import annotations

import pytest
from freemaster_board import Board
from freemaster_model import ENTRIES, parse_answer, request, uleb


def dialogue(board: Board, text: str) -> None:
    """Send requests of lines ``request -> answer`` (hexadecimal) and compare the answers."""
    for line in filter(None, map(str.strip, text.splitlines())):
        sent, _, expected = line.partition("->")
        received = board.send(bytes.fromhex(sent))
        assert received == bytes.fromhex(expected), f"{line}: {received.hex(' ')}"


def test_configuration_dialogue_matches_the_recorded_frames(sheet: Board) -> None:
    dialogue(
        sheet,
        """
        2B 20 05 00 4D 54 55 00 8B -> 2B 40 06 4D 54 55 00 F0 01 70
        2B 20 01 01 51             -> 2B 40 06 4D 54 55 00 F0 01 70
        2B 20 04 00 46 31 00 A3    -> 2B 40 04 46 31 00 02 92
        2B 20 04 00 42 41 00 AA    -> 2B 40 08 42 41 00 80 80 80 80 02 F2
        2B 20 04 00 50 56 00 E2    -> 2B 40 04 50 56 00 04 40
        2B 20 04 00 5A 5A 00 99    -> 2B 89 B6
        """,
    )


def test_read_dialogue_matches_the_recorded_frames(sheet: Board) -> None:
    dialogue(
        sheet,
        """
        2B 21 06 A0 80 80 80 02 02 EF -> 2B 00 34 12 D3
        2B 21 06 C0 80 80 80 02 02 A2 -> 2B 00 2B 2B 2B 2B E8
        2B 22 02 20 02 94             -> 2B 00 34 12 D3
        2B 22 02 7C 02 64             -> 2B 89 B6
        """,
    )
    memory = sheet.memory()
    size_is_2b = parse_answer(sheet.send(bytes.fromhex("2B 21 06 F0 80 80 80 02 2B 2B D8")))
    assert (size_is_2b.status, size_is_2b.data) == (0, memory[0x70 : 0x70 + 43])
    crc_is_2b = parse_answer(sheet.send(bytes.fromhex("2B 21 06 F2 80 80 80 02 10 2B 2B")))
    assert (crc_is_2b.status, crc_is_2b.data) == (0, memory[0x72 : 0x72 + 16])
    adjacent = parse_answer(sheet.send(bytes.fromhex("2B 21 06 D4 80 80 80 02 10 E6")))
    assert (adjacent.status, adjacent.data) == (0, memory[0x54 : 0x54 + 16])


def test_write_dialogue_matches_the_recorded_frames(sheet: Board) -> None:
    dialogue(sheet, "2B 23 09 00 A0 80 80 80 02 02 78 56 9C -> 2B 00 00")
    assert sheet.memory()[0x20:0x22] == b"\x78\x56"
    dialogue(sheet, "2B 23 09 00 A0 80 80 80 02 02 2B 2B 2B 2B DB -> 2B 00 00")
    assert sheet.memory()[0x20:0x22] == b"\x2b\x2b"
    dialogue(sheet, "2B 23 0B 01 A0 80 80 80 02 02 FF FF F0 0F A0 -> 2B 00 00")
    assert sheet.memory()[0x20:0x22] == b"\xfb\x2f"
    before = sheet.memory()
    dialogue(sheet, "2B 23 09 00 AA 80 80 80 02 02 00 00 8D -> 2B 89 B6")
    assert sheet.memory() == before


def test_scope_dialogue_matches_the_recorded_frames(sheet: Board) -> None:
    dialogue(
        sheet,
        """
        2B 27 01 00 40          -> 2B 88 B1
        2B 26 04 00 01 01 03 35 -> 2B 00 00
        2B 26 0A 00 02 07 00 AA 80 80 80 02 02 56 -> 2B 00 00
        2B 26 13 00 02 07 01 A4 80 80 80 02 04 02 07 02 C0 80 80 80 02 02 5B -> 2B 00 00
        2B 27 01 00 40          -> 2B 00 EF BE FE FF FF FF 2B 2B 2B 2B 9F
        """,
    )


def test_table_dialogue_matches_the_recorded_frames(sheet: Board) -> None:
    """The example's table has 24 entries."""
    info = parse_answer(sheet.send(bytes.fromhex("2B 29 01 00 6C")))
    assert info.data == bytes.fromhex("13 80 03 E0 A1 80 80 02").replace(uleb(16 * 24), uleb(16 * len(ENTRIES)))
    dialogue(
        sheet,
        """
        2B 2A 04 95 E2 93 40 B0    -> 2B 40 01 09 AC
        2B 21 05 95 E2 93 40 09 83 -> 2B 00 4D 2E 76 61 72 5F 75 31 36 FF
        """,
    )
    entry = sheet.ask(0x21, bytes.fromhex("E0 A1 80 80 02 10"))
    assert entry.data == bytes.fromhex("15 F1 04 08  1F F1 04 08  20 00 00 20  0B 00 00 00")


def test_command_dialogue_matches_the_recorded_frames(sheet: Board) -> None:
    dialogue(
        sheet,
        """
        2B 31 00 EC             -> 2B 00 FF F3
        2B 30 04 11 01 02 D4 38 -> 2B 00 00
        2B 31 00 EC             -> 2B 00 42 C9
        2B 32 02 03 00 6C       -> 2B 40 03 FE FD 2B 2B 9E
        """,
    )


@pytest.mark.parametrize(
    "frame",
    [
        "2B 2C 01 01 AB",  # AUTH1
        "2B 33 03 01 00 01 A6",  # FEATLOCK
    ],
)
def test_unsupported_features_are_refused(sheet: Board, frame: str) -> None:
    dialogue(sheet, f"{frame} -> 2B 81 8E")


def test_requests_of_protocol_v3_are_unknown_commands(sheet: Board) -> None:
    dialogue(
        sheet,
        """
        2B 04 05 02 20 00 00 20 B5 -> 2B 82 87
        2B C0 40                   ->
        2B 20 01 01 51             -> 2B 40 06 4D 54 55 00 F0 01 70
        """,
    )


def test_every_code_without_a_command_is_unknown(servo: Board) -> None:
    known = {*range(0x20, 0x2B), 0x2F, 0x30, 0x31, 0x32}
    for code in set(range(256)) - known - {0x2B}:
        assert servo.send(request(code)) == bytes.fromhex("2B 81 8E"), hex(code)
