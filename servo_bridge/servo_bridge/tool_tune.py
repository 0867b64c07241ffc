"""``servo-tool tune``: another configuration for the axes of a board that runs, and what it has now."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from servo_msgs_py.axis_config import AxisConfigError, AxisConfigTable, Member
from servo_msgs_py.axis_config_transfer import BlockRefusedError, read_block, send_block, take_blocks
from servo_msgs_py.catalogue import AXES, axis_name, numbers
from servo_msgs_py.tuning.errors import ConfigError
from servo_msgs_py.tuning.reading import load
from servo_msgs_py.tuning.report import axis_reports
from servo_msgs_py.tuning.restore import restored, toml_text

from servo_bridge.block_session import BlockSession
from servo_bridge.tool_values import UsageError

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

__all__ = ["add_arguments", "tune"]

Block = Mapping[str, int]

_HEADING = """\
Read back from a board by `servo-tool tune --from-board`: `servo-tool tune` makes the same numbers of it.
rotor_inertia, rated_speed and rated_current are not on a board; they only serve a report. [board.brake] and
[board.regeneration] are compiled into the firmware; `make generate` needs both."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    command.add_argument("file", nargs="?", metavar="FILE.toml", help="configuration, as firmware/config/servo.toml")
    command.add_argument("--axis", type=int, choices=range(1, AXES + 1), help="only this axis (default: both)")
    way = command.add_mutually_exclusive_group()
    way.add_argument("--dry-run", action="store_true", help="only show what would change")
    way.add_argument("--diff", action="store_true", help="only compare; exit status 1 when file and board differ")
    way.add_argument("--from-board", action="store_true", help="write what the board has as such a file")
    command.add_argument("-o", "--output", metavar="FILE.toml", help="with --from-board: where to (default: print it)")


def tune(context: Context) -> int:
    """Compute a configuration, show what changes, and let the board take it."""
    args = context.args
    if args.from_board == bool(args.file) or (args.output and not args.from_board):
        raise UsageError("give a FILE.toml to send or to compare, or --from-board (with -o FILE.toml) to read one back")
    if context.session.mismatch is not None:
        print(f"servo-tool: {context.session.mismatch}", file=sys.stderr)
        return 1
    memory = BlockSession(context.session)
    try:
        return _from_board(context, memory) if args.from_board else _to_board(context, memory)
    except ConfigError as error:
        print(f"servo-tool: {args.file or 'the configuration of the board'}: {error}", file=sys.stderr)
    except (AxisConfigError, BlockRefusedError) as error:
        print(f"servo-tool: {error}", file=sys.stderr)
    return 1


def _from_board(context: Context, memory: BlockSession) -> int:
    blocks = [read_block(memory, axis) for axis in range(AXES)]
    timeouts = (_parameter(context, "param.host_timeout"), _parameter(context, "param.command_timeout"))
    text = toml_text(restored(blocks, timeouts, context.catalogue), _HEADING)
    if context.args.output:
        Path(context.args.output).write_text(text, encoding="utf-8")
        print(f"wrote {context.args.output}")
    else:
        print(text, end="")
    return 0


def _parameter(context: Context, name: str) -> float:
    return numbers(context.session.read(context.session.variables[name]))[0]


def _to_board(context: Context, memory: BlockSession) -> int:
    args = context.args
    reports = axis_reports(load(Path(args.file), context.catalogue))
    axes = range(AXES) if args.axis is None else [args.axis - 1]
    for axis in axes:
        for finding in reports[axis].findings:
            print(f"{args.file}: warning: {finding}", file=sys.stderr)
    new = {axis: reports[axis].tuned.block for axis in axes}
    old = {axis: read_block(memory, axis) for axis in axes}
    changed = [axis for axis in axes if new[axis] != old[axis]]
    if not changed:
        print(f"the board has the configuration of {args.file}; nothing changes")
        return 0
    print("\n".join(change_table({axis: (old[axis], new[axis]) for axis in changed})))
    if args.diff:
        return 1
    if args.dry_run:
        return 0
    for axis in changed:
        send_block(memory, axis, new[axis])
    taken = take_blocks(memory, changed, memory.wait)
    print(f"{' and '.join(map(axis_name, changed))} taken at tick {taken.tick}")
    return 0


def change_table(blocks: Mapping[int, tuple[Block, Block]]) -> list[str]:
    """Lines of a table of what changes, by index of the axis: old and new block."""
    rows: list[Sequence[str]] = [("AXIS", "MEMBER", "OLD", "NEW", "CHANGES")]
    for axis, (old, new) in blocks.items():
        rows += [_row(axis, member, old, new) for member in AxisConfigTable.load().changes(old, new)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _row(axis: int, member: Member, old: Block, new: Block) -> Sequence[str]:
    texts: list[Any] = [member.text(block[member.path]) for block in (old, new)]
    if texts[0] == texts[1]:
        texts = [f"{text} (raw {block[member.path]})" for text, block in zip(texts, (old, new), strict=True)]
    return (axis_name(axis), member.path, *texts, "in motion" if member.live else "at rest")
