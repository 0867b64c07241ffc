"""Transfers the configuration blocks of the real board to the twin's board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import send_block, send_configuration
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.lockstep.replica import Replica

TAKE: Final = "config.take"

Blocks = Mapping[int, tuple[int, ...]]
"""Members of a block in the order of the table, by index of the axis."""


def blocks_of(command: AppliedCommand) -> dict[int, tuple[int, ...]]:
    """Blocks that a command has activated.

    Raises
    ------
    AxisConfigError
        If the contents are invalid.
    """
    table, size = AxisConfigTable.load(), len(AxisConfigTable.load())
    axes = [axis for axis in range(AXES) if command.mask >> axis & 1]
    parts = {axis: command.raw[k * size : (k + 1) * size] for k, axis in enumerate(axes)}
    return {axis: tuple(table.words(table.block(words))) for axis, words in parts.items()}


def checksums_of(blocks: Blocks) -> dict[int, int]:
    """Checksum of each block, as in ``config.checksum`` of a board."""
    table = AxisConfigTable.load()
    return {axis: table.checksum(axis, table.block(words)) for axis, words in blocks.items()}


def position_resolution(words: Sequence[int]) -> int:
    """Position counts per count of the encoder of a block, at least 1."""
    per_count = AxisConfigTable.load().block(words)["encoder.angle_per_count"]  # 2^32 is a turn
    return max(round(COUNTS_PER_TURN * per_count / 2**32), 1)


def repeat_blocks(replica: Replica, command: AppliedCommand) -> None:
    """Write the blocks of a command; effective with the next slow tick."""
    table = AxisConfigTable.load()
    for axis, words in blocks_of(command).items():
        send_block(replica, axis, table.block(words))
    replica.write_words(TAKE, [command.mask])


def write_blocks(replica: Replica, blocks: Blocks) -> None:
    """Write these blocks to a board at standstill, if it has others.

    Raises
    ------
    BlockRefusedError
        If the board refuses them.
    """
    table, in_force = AxisConfigTable.load(), replica.read_words("config.checksum")
    others = [axis for axis, checksum in checksums_of(blocks).items() if checksum != in_force[axis]]
    if others:
        send_configuration(replica, {axis: table.block(blocks[axis]) for axis in others})
