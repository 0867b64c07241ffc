"""Transfer of configuration blocks to and from a board, by any access to its variables.

A block is sent in parts through ``config.window``; the board checks each part. The checksum after the last member marks
the block as complete, and ``config.take`` applies the complete blocks of one axis or both in one slow tick.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.board_port import BoardPort, BoardWords, reached
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name

_HEAD: Final = 3  # words of the window before the members
_TAKE_TIME: Final = 1.0  # timeout for applying blocks [s]

_TEXTS: Final[Mapping[str, str]] = {
    "FORM": "malformed request; if another program also writes to the board, stop it and send again",
    "AXIS": "this axis does not exist on the board",
    "MEMBER": "this member does not exist on the board: host and board have different versions",
    "RANGE": "is outside the range that the board accepts",
    "LAYOUT": "the layout of the block on the board is different: flash the firmware of this release",
    "CHECKSUM": "the checksum of the received block is wrong; send it again",
    "UNCHECKED": "no complete block has been received since the last one was applied; send it again",
    "MOTION": "can only be changed at standstill with the outputs off: disable the axis and wait for standstill",
    "BUSY": "the board has not yet applied the previous blocks, or a measurement uses them; try again after it",
}


class BlockRefusedError(ValueError):
    """The board has refused a block or a part of one."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason  # name of the reason in the table of variables


class AppliedBlocks(NamedTuple):
    """Time at which blocks took effect, and their checksums."""

    tick: int  # first slow tick with the new blocks, PWM periods since reset
    checksums: tuple[int, ...]  # of the active blocks, by axis


def _members_per_window() -> int:
    return Catalogue.load()["config.window"].count - _HEAD


def read_block(memory: BoardWords, axis: int) -> dict[str, int]:
    """The active block.

    Raises
    ------
    BlockRefusedError
        If the board does not return it, or its checksum is wrong.
    """
    table = AxisConfigTable.load()
    _compare_layout(memory, table)
    words: list[int] = []
    while len(words) < len(table):
        _write(memory, "config.window", [axis, len(words), 0])
        window = memory.read_words("config.window")
        if window[:_HEAD] != [axis, len(words), 0]:
            raise BlockRefusedError("FORM", _TEXTS["FORM"])
        words += window[_HEAD : _HEAD + len(table) - len(words)]
    block = table.block(words)
    if table.checksum(axis, block) != memory.read_words("config.checksum")[axis]:
        raise BlockRefusedError("CHECKSUM", f"the block of {axis_name(axis)} changed during reading; read it again")
    return block


def send_block(memory: BoardWords, axis: int, block: Mapping[str, int]) -> None:
    """Write a block and its checksum, without applying it.

    Raises
    ------
    AxisConfigError
        If a member is out of range.
    BlockRefusedError
        If the board refuses.
    """
    table = AxisConfigTable.load()
    words, step = [*table.words(block), _signed(table.checksum(axis, block))], _members_per_window()
    _compare_layout(memory, table)
    for first in range(0, len(words), step):
        part = words[first : first + step]
        _write(memory, "config.window", [axis, first, len(part), *part])


def take_blocks(board: BoardPort, axes: Sequence[int]) -> AppliedBlocks:
    """Apply complete blocks, all in the same slow tick or none.

    Parameters
    ----------
    board : BoardPort
        The board.
    axes : sequence of int
        Indices of the axes.

    Raises
    ------
    BlockRefusedError
        If the board refuses.
    """
    before = board.read_words("config.answers")
    _write(board, "config.take", [sum(1 << axis for axis in axes)])
    if not reached(board, lambda: board.read_words("config.answers") != before, _TAKE_TIME):
        raise BlockRefusedError("BUSY", _TEXTS["BUSY"])
    return take_result(board)


def send_configuration(board: BoardPort, blocks: Mapping[int, Mapping[str, int]]) -> AppliedBlocks:
    """Send blocks by index of the axis, and apply all in the same slow tick.

    Raises
    ------
    AxisConfigError, BlockRefusedError
        If a block is invalid, or the board refuses it.
    """
    for axis, block in blocks.items():
        send_block(board, axis, block)
    return take_blocks(board, sorted(blocks))


def take_result(memory: BoardWords) -> AppliedBlocks:
    """Result of the last ``config.take``, after the board has processed it.

    Raises
    ------
    BlockRefusedError
        If it was refused.
    """
    _raise_refusal(memory, "the blocks")
    checksums = memory.read_words("config.checksum")
    return AppliedBlocks(memory.read_words("config.taken_tick")[0], tuple(checksums[:AXES]))


def _compare_layout(memory: BoardWords, table: AxisConfigTable) -> None:
    if memory.read_words("config.layout") != [table.layout]:
        raise BlockRefusedError("LAYOUT", _TEXTS["LAYOUT"])


def _write(memory: BoardWords, name: str, words: Sequence[int]) -> None:
    if not memory.write_words(name, words):
        _raise_refusal(memory, name)
        raise BlockRefusedError("FORM", _TEXTS["FORM"])


def _raise_refusal(memory: BoardWords, item: str) -> None:
    number = memory.read_words("config.refusal")[0]
    if number == 0:
        return
    reasons = {code: name for name, code in Catalogue.load().bits["config_refusal"].items()}
    reason = reasons.get(number, f"reason {number}")
    members = list(AxisConfigTable.load().members)
    if reason in ("RANGE", "MOTION"):
        number = memory.read_words("config.refused_member")[0]
        item = members[number] if number < len(members) else f"member {number}"
        raise BlockRefusedError(reason, f"{item} {_TEXTS[reason]}")
    raise BlockRefusedError(reason, f"{item}: {_TEXTS.get(reason, reason)}")


def _signed(word: int) -> int:
    return word - (1 << 32) if word >> 31 else word
