"""Configuration blocks of the real board on that of the twin: at the same tick, and again when it begins anew. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import send_block, take_blocks
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.units import SLOW_PERIODS

from servo_twin.lockstep.replica import Replica

__all__ = ["TAKE", "Blocks", "blocks_of", "bring", "repeat"]

TAKE: Final = "config.take"

Blocks = Mapping[int, tuple[int, ...]]
"""Members of a block in the order of the table, by index of the axis."""


def blocks_of(command: AppliedCommand) -> dict[int, tuple[int, ...]]:
    """Blocks that a command has brought into force.

    Raises
    ------
    AxisConfigError
        If they are none.
    """
    table, size = AxisConfigTable.load(), len(AxisConfigTable.load())
    axes = [axis for axis in range(AXES) if command.mask >> axis & 1]
    parts = {axis: command.raw[k * size : (k + 1) * size] for k, axis in enumerate(axes)}
    return {axis: tuple(table.words(table.block(words))) for axis, words in parts.items()}


def repeat(replica: Replica, command: AppliedCommand) -> None:
    """Write what a command has brought, so that it takes effect with the next slow tick."""
    table = AxisConfigTable.load()
    for axis, words in blocks_of(command).items():
        send_block(replica, axis, table.block(words))
    replica.write_words(TAKE, [command.mask])


def bring(replica: Replica, blocks: Blocks) -> None:
    """Give a board at rest these blocks.

    Raises
    ------
    BlockRefusedError
        If it does not take them.
    """
    table = AxisConfigTable.load()
    for axis, words in blocks.items():
        send_block(replica, axis, table.block(words))
    if blocks:
        take_blocks(replica, list(blocks), lambda: _tick(replica))


def _tick(replica: Replica) -> bool:
    replica.run_to(replica.tick + SLOW_PERIODS)
    return True
