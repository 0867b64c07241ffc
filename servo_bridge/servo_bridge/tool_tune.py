"""``servo-tool tune``: change the configuration of the axes of a running board, or read it back."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from servo_msgs_py.axis_config import AxisConfigError
from servo_msgs_py.axis_config_transfer import BlockRefusedError, take_blocks
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.output_file import write_file
from servo_tuning.board_file import text_of
from servo_tuning.errors import ConfigError
from servo_tuning.remedies import explained

from servo_bridge.tool_values import UsageError
from servo_bridge.tuning.plan import HEADING, Plan, computed, read_blocks
from servo_bridge.wire.session_port import SessionPort
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.add_argument("file", nargs="?", metavar="FILE.toml", help="configuration, as firmware/config/servo.toml")
    command.add_argument("--axis", type=int, choices=range(1, AXES + 1), help="only this axis (default: both)")
    mode = command.add_mutually_exclusive_group()
    mode.add_argument("--dry-run", action="store_true", help="print the changes, send nothing")
    mode.add_argument("--diff", action="store_true", help="compare only; exit status 1 if file and board differ")
    mode.add_argument("--from-board", action="store_true", help="write the members of the board, in SI units")
    command.add_argument(
        "-o",
        "--output",
        type=argument.output_file,
        metavar="FILE.toml",
        help="file to write with --from-board (default: print it)",
    )


def check(args: argparse.Namespace) -> None:
    """Compute the configuration of the file."""
    if args.from_board == bool(args.file) or (args.output and not args.from_board):
        raise UsageError(
            "write a FILE.toml to send or compare, or --from-board (with -o FILE.toml) to read the configuration"
        )
    if args.file:
        try:
            args.computed = computed(Path(args.file), Catalogue.load())
        except ConfigError as error:
            raise UsageError(f"{args.file}: {explained(error)}") from None


def tune(context: Context) -> int:
    """Print the changes by a configuration, and apply them on the board; or read its configuration."""
    args = context.args
    if context.session.mismatch is not None:
        print(f"servo-tool: {context.session.mismatch}", file=sys.stderr)
        return 1
    memory = SessionPort(context.session)
    try:
        return _from_board(context, memory) if args.from_board else _to_board(context, memory)
    except ConfigError as error:
        print(f"servo-tool: the configuration of the board: {explained(error)}", file=sys.stderr)
    except (AxisConfigError, BlockRefusedError) as error:
        print(f"servo-tool: {error}", file=sys.stderr)
    return 1


def _from_board(context: Context, memory: SessionPort) -> int:
    text = text_of(list(read_blocks(memory).values()), HEADING)
    if context.args.output:
        write_file(context.args.output, text)
        print(f"wrote {context.args.output}")
    else:
        print(text, end="")
    return 0


def _to_board(context: Context, memory: SessionPort) -> int:
    args = context.args
    blocks, warnings, notes = args.computed
    for note in notes:
        print(f"{args.file}: {note}", file=sys.stderr)
    axes = range(AXES) if args.axis is None else [args.axis - 1]
    for axis in axes:
        for warning in warnings[axis]:
            print(f"{args.file}: warning: {warning}", file=sys.stderr)
    plan = Plan(read_blocks(memory, axes), {axis: blocks[axis] for axis in axes})
    if not plan.axes:
        print(f"the board already has the configuration of {args.file}; no change")
        return 0
    print("\n".join(plan.table()))
    if args.diff:
        return 1
    if args.dry_run:
        return 0
    plan.send(memory)
    taken = take_blocks(memory, plan.axes)
    print(f"{plan.names} applied at tick {taken.tick}")
    return 0
