"""``servo-tool save --to-board`` and ``servo-tool factory``: non-volatile storage of the board."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from servo_msgs_py.board_storage import Kind, StorageRefusedError, execute_request, read_storage, success_text

from servo_bridge.wire.session_port import SessionPort

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context


def save_to_board(context: Context) -> int:
    """Store parameters and configuration in the data flash."""
    return _carry_out(context, "SAVE")


def factory(context: Context) -> int:
    """Erase the stored values in the data flash."""
    return _carry_out(context, "FACTORY")


def storage_row(context: Context) -> tuple[str, str]:
    """Row of ``servo-tool info``; empty for a board with another contract."""
    known = context.session.mismatch is None
    return "storage", read_storage(SessionPort(context.session)).text if known else ""


def _carry_out(context: Context, kind: Kind) -> int:
    if context.session.mismatch is not None:
        print(f"servo-tool: {context.session.mismatch}", file=sys.stderr)
        return 1
    try:
        storage = execute_request(SessionPort(context.session), kind)
    except StorageRefusedError as error:
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    print(success_text(kind, storage))
    return 0
