"""How configuration blocks come to a board and from it, over any way to its variables. Pure.

A block goes in parts through ``config.window``, each checked by the board. ``config.header`` with the checksum of the
whole makes it ready, and ``config.take`` takes the ready blocks of one axis or of both with the same slow tick.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name

_HEAD: Final = 3  # words of the window before the members

_TEXTS: Final[Mapping[str, str]] = {
    "FORM": "malformed request; if another program also writes to the board, stop it and send again",
    "AXIS": "the board has no such axis",
    "MEMBER": "the board has no such member: host and board are of different versions",
    "RANGE": "is outside what the board takes",
    "LAYOUT": "the board has another layout of the block: flash the firmware of this release",
    "LENGTH": "the board has another number of members: flash the firmware of this release",
    "CHECKSUM": "the board has got other numbers than were sent; send them again",
    "UNCHECKED": "no complete block has been received since the last one was taken; send it again",
    "MOTION": "may only change while the axis is at rest with its outputs off: disable it and wait for standstill",
    "BUSY": "the board has not yet taken the previous blocks; try again",
}


class BlockRefusedError(ValueError):
    """The board has not taken a block or a part of one."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason  # name of the reason in the contract


class BlockMemory(Protocol):
    """Raw integers of a board's variables."""

    def read_words(self, name: str) -> list[int]:
        """All elements of a variable."""

    def write_words(self, name: str, words: Sequence[int]) -> bool:
        """The first elements of a variable, in one write; False if the board finds them out of range."""


class Taken(NamedTuple):
    """When blocks have taken effect."""

    tick: int  # PWM periods since reset, of the first slow tick with the new blocks
    checksums: tuple[int, ...]  # of the blocks in force now, by axis


def _together() -> int:
    return Catalogue.load()["config.window"].count - _HEAD


def read_block(memory: BlockMemory, axis: int) -> dict[str, int]:
    """The block in force.

    Raises
    ------
    BlockRefusedError
        If the board does not show it, or something else than its checksum says.
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
        raise BlockRefusedError(
            "CHECKSUM", f"the block of {axis_name(axis)} has changed while it was read; read it again"
        )
    return block


def send_block(memory: BlockMemory, axis: int, block: Mapping[str, int]) -> None:
    """Write a block and its header; nothing takes effect yet.

    Raises
    ------
    AxisConfigError
        If the board could not take it.
    BlockRefusedError
        If the board refuses.
    """
    table = AxisConfigTable.load()
    words, step = table.words(block), _together()
    checksum = table.checksum(axis, block)
    _compare_layout(memory, table)
    for first in range(0, len(words), step):
        part = words[first : first + step]
        _write(memory, "config.window", [axis, first, len(part), *part])
    _write(memory, "config.header", [axis, _signed(table.layout), len(table), _signed(checksum)])


def take_blocks(memory: BlockMemory, axes: Sequence[int], wait: Callable[[], bool]) -> Taken:
    """Let blocks that were sent take effect, all with the same slow tick or none.

    Parameters
    ----------
    memory : BlockMemory
        The board.
    axes : sequence of int
        Indices of the axes.
    wait : callable
        Lets a slow tick pass; False when the board has had its time.

    Raises
    ------
    BlockRefusedError
        If it refuses.
    """
    before = memory.read_words("config.answers")
    _write(memory, "config.take", [sum(1 << axis for axis in axes)])
    while memory.read_words("config.answers") == before:
        if not wait():
            raise BlockRefusedError("BUSY", _TEXTS["BUSY"])
    return take_result(memory)


def take_result(memory: BlockMemory) -> Taken:
    """What has become of the last ``config.take`` when the board has dealt with it.

    Raises
    ------
    BlockRefusedError
        If it was refused.
    """
    _raise_refusal(memory, "the blocks")
    checksums = memory.read_words("config.checksum")
    return Taken(memory.read_words("config.taken_tick")[0], tuple(checksums[:AXES]))


def _compare_layout(memory: BlockMemory, table: AxisConfigTable) -> None:
    if memory.read_words("config.layout") != [table.layout]:
        raise BlockRefusedError("LAYOUT", _TEXTS["LAYOUT"])


def _write(memory: BlockMemory, name: str, words: Sequence[int]) -> None:
    if not memory.write_words(name, words):
        _raise_refusal(memory, name)
        raise BlockRefusedError("FORM", _TEXTS["FORM"])


def _raise_refusal(memory: BlockMemory, what: str) -> None:
    number = memory.read_words("config.refusal")[0]
    if number == 0:
        return
    reasons = {code: name for name, code in Catalogue.load().bits["config_refusal"].items()}
    reason = reasons.get(number, f"reason {number}")
    members = list(AxisConfigTable.load().members)
    if reason in ("RANGE", "MOTION"):
        number = memory.read_words("config.refused_member")[0]
        what = members[number] if number < len(members) else f"member {number}"
        raise BlockRefusedError(reason, f"{what} {_TEXTS[reason]}")
    raise BlockRefusedError(reason, f"{what}: {_TEXTS.get(reason, reason)}")


def _signed(word: int) -> int:
    return word - (1 << 32) if word >> 31 else word
