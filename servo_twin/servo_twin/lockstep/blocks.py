"""Configuration blocks of the real board on that of the twin: at the same tick, and again when it begins anew. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import send_block, take_blocks
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.tuning.configuration import Configuration
from servo_msgs_py.tuning.reading import loads
from servo_msgs_py.tuning.tuned import tuned
from servo_msgs_py.units import SLOW_PERIODS

from servo_twin.lockstep.replica import Replica

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


def blocks_of_file(text: str, catalogue: Catalogue) -> dict[int, tuple[int, ...]]:
    """Blocks that the tuning code makes of a configuration file, given as its text.

    Raises
    ------
    ConfigError
        If the configuration cannot work.
    """
    return blocks_of_configuration(loads(text, catalogue))


def blocks_of_configuration(configuration: Configuration) -> dict[int, tuple[int, ...]]:
    """Blocks that the tuning code makes of a configuration; a `ConfigError` says why it cannot work."""
    table = AxisConfigTable.load()
    return {k: tuple(table.words(tuned(axis, configuration).block)) for k, axis in enumerate(configuration.axes)}


def checksums_of(blocks: Blocks) -> dict[int, int]:
    """Checksum of each block, as the board has it in ``config.checksum``."""
    table = AxisConfigTable.load()
    return {axis: table.checksum(axis, table.block(words)) for axis, words in blocks.items()}


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
    table, in_force = AxisConfigTable.load(), replica.read_words("config.checksum")
    others = [axis for axis, checksum in checksums_of(blocks).items() if checksum != in_force[axis]]
    for axis in others:
        send_block(replica, axis, table.block(blocks[axis]))
    if others:
        take_blocks(replica, others, lambda: _tick(replica))


def _tick(replica: Replica) -> bool:
    replica.run_to(replica.tick + SLOW_PERIODS)
    return True
