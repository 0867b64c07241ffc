"""``servo-tool autotune``: choose and confirm the bandwidths of an axis for its load; the shaft moves."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from servo_measurement.autotune import Autotuned
from servo_measurement.autotune import autotune as tune
from servo_measurement.autotune_command import ABOUT, add_options, configuration, finish, request_of
from servo_msgs_py.catalogue import AXIS_NAMES

from servo_bridge.tool_measurement import measured
from servo_bridge.tool_values import UsageError

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.description = ABOUT
    command.add_argument("axis", choices=AXIS_NAMES)
    add_options(command)
    command.add_argument("--json", action="store_true", help="print one JSON object instead of the tables")


def check(args: argparse.Namespace) -> None:
    """Read the configuration."""
    try:
        args.base = configuration(args)
    except ValueError as error:
        raise UsageError(str(error)) from None


def autotune(context: Context) -> int:
    """Tune the axis; returns 1 if nothing was tuned or confirmed."""
    args = context.args
    request = request_of(args, AXIS_NAMES.index(args.axis))

    def work(keep: Callable[[Autotuned], None]) -> Autotuned:
        return measured(context.session, partial(tune, request=request, base=args.base, keep=keep))

    return finish("servo-tool", args, work)
