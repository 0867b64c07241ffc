"""Changes of a board by a configuration file, and a configuration file from a board."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from servo_msgs_py.axis_config import AxisConfigTable, Member
from servo_msgs_py.axis_config_transfer import read_block, send_block
from servo_msgs_py.board_port import BoardWords
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.table_text import aligned
from servo_tuning.board_file import blocks_of
from servo_tuning.reading import parse, read_table
from servo_tuning.report import axis_reports
from servo_tuning.schema import BOARD_GROUPS

Block = Mapping[str, int]

HEADING: Final = """\
Configuration of a board, in SI units; written by `servo-tool tune --from-board`, sent by `servo-tool tune FILE`."""
"""First line of a file of the blocks of a board."""


class Computed(NamedTuple):
    """Result of the tuning code for a file."""

    blocks: Sequence[Block]  # members by path, per axis
    warnings: Sequence[Sequence[str]]  # texts, per axis
    notes: Sequence[str] = ()  # groups of the file that are not part of the blocks


def computed(path: Path, catalogue: Catalogue) -> Computed:
    """Blocks of a configuration file, or of a file of the blocks of a board.

    Raises
    ------
    ConfigError
        If the configuration cannot work.
    OSError
        If the file cannot be read.
    """
    table = read_table(path)
    if (blocks := blocks_of(table)) is not None:
        return Computed(blocks, [()] * len(blocks))
    reports = axis_reports(parse(table, catalogue))
    groups = [group for group in BOARD_GROUPS if group in table["board"]]
    notes = [
        f"[board.{group}] is compiled into the firmware and not sent; build the firmware with it" for group in groups
    ]
    warnings = [list(map(str, report.findings)) for report in reports]
    return Computed([report.tuned.block for report in reports], warnings, notes)


def read_blocks(memory: BoardWords, axes: Collection[int] = range(AXES)) -> dict[int, Block]:
    """Read the present blocks of a board, by index of the axis."""
    return {axis: read_block(memory, axis) for axis in axes}


class Plan:
    """Differences between the blocks of the board and the new blocks.

    Parameters
    ----------
    old, new : mapping
        Blocks by index of the axis; of the same axes.
    """

    def __init__(self, old: Mapping[int, Block], new: Mapping[int, Block]) -> None:
        self.changes = {axis: (old[axis], new[axis]) for axis in sorted(new) if old[axis] != new[axis]}
        """Old and new block of each changed axis."""

    @property
    def axes(self) -> list[int]:
        """Indices of the changed axes."""
        return list(self.changes)

    @property
    def names(self) -> str:
        """Names of the changed axes, for messages."""
        return " and ".join(map(axis_name, self.changes))

    def send(self, memory: BoardWords) -> None:
        """Write the new blocks to the board, where they are stored until they are applied."""
        for axis, (_, new) in self.changes.items():
            send_block(memory, axis, new)

    def checksums(self) -> dict[int, int]:
        """Checksums of the new blocks, by index of the axis."""
        table = AxisConfigTable.load()
        return {axis: table.checksum(axis, new) for axis, (_, new) in self.changes.items()}

    def table(self) -> list[str]:
        """Lines of a table of the changes."""
        rows: list[Sequence[str]] = [("AXIS", "MEMBER", "OLD", "NEW", "CHANGES")]
        for axis, (old, new) in self.changes.items():
            rows += [_row(axis, member, old, new) for member in AxisConfigTable.load().changes(old, new)]
        return aligned(rows)


def _row(axis: int, member: Member, old: Block, new: Block) -> Sequence[str]:
    texts: list[Any] = [member.shown(block[member.name]) for block in (old, new)]
    if texts[0] == texts[1]:
        texts = [f"{text} (raw {block[member.name]})" for text, block in zip(texts, (old, new), strict=True)]
    return (axis_name(axis), member.name, *texts, "in motion" if member.live else "at rest")
