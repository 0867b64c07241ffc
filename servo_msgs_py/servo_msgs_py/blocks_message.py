"""The configuration blocks of both axes of a board as a message of `topics.TUNING`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from std_msgs.msg import Int64MultiArray, MultiArrayDimension

from servo_msgs_py.axis_config import AxisConfigError, AxisConfigTable
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.topics import TUNING


def blocks_message(blocks: Sequence[Mapping[str, int]]) -> Int64MultiArray:
    """Message of the blocks, raw numbers by member; no blocks: the configuration is not known.

    The first number is the layout of the blocks (`AxisConfigTable.layout`); the members follow in the order of the
    table.
    """
    table = AxisConfigTable.load()
    message = Int64MultiArray()
    if blocks:
        size = len(table)
        message.data = [table.layout, *(word for block in blocks for word in table.words(block))]
        message.layout.data_offset = 1
        message.layout.dim = [
            MultiArrayDimension(label="axis", size=len(blocks), stride=len(blocks) * size),
            MultiArrayDimension(label="member", size=size, stride=size),
        ]
    return message


def blocks_from_message(message: Int64MultiArray) -> dict[int, tuple[int, ...]]:
    """Members of the blocks in the order of the table, by index of the axis; empty: the configuration is not known.

    Raises
    ------
    AxisConfigError
        If the blocks have another layout, or a member is out of range.
    """
    if not len(message.data):
        return {}
    table = AxisConfigTable.load()
    layout, *words = message.data.tolist()
    size = len(table)
    if layout != table.layout or len(words) != AXES * size:
        raise AxisConfigError(f"{TUNING}: the blocks belong to another version; use the same version everywhere")
    parts = [words[axis * size : (axis + 1) * size] for axis in range(AXES)]
    return {axis: tuple(table.words(table.block(part))) for axis, part in enumerate(parts)}
