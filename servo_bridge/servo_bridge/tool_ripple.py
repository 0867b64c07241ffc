"""``servo-tool ripple``: measure the torque ripple of a homed axis; write the group of ``servo.toml``."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import TYPE_CHECKING, Final

from servo_measurement.access import MeasurementError
from servo_measurement.ripple import RippleRequest, measure
from servo_msgs_py.catalogue import AXIS_NAMES
from servo_msgs_py.output_file import write_file

from servo_bridge.tool_measurement import add_enable, measured
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

ABOUT: Final = """\
Measure the harmonics of the torque ripple (cogging) of a homed axis, and write the group [axisN.torque_ripple] of
servo.toml. The shaft turns in both directions at a constant speed. Ctrl-C stops it."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.add_argument("axis", choices=AXIS_NAMES)
    command.add_argument(
        "--speed", type=argument.positive, metavar="RAD/S", help="constant speed (default: a turn fits the recorder)"
    )
    add_enable(command)
    command.add_argument(
        "-o", "--output", type=argument.output_file, metavar="FILE.toml", help="file to write (default: print it)"
    )


def ripple(context: Context) -> int:
    """Measure, print the table, write the group; returns 1 if it could not be measured."""
    args = context.args
    request = RippleRequest(AXIS_NAMES.index(args.axis), args.speed)
    try:
        found = measured(context.session, partial(measure, request=request, enable=args.enable))
    except (MeasurementError, ValueError) as error:  # a number or a block was refused
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    if args.output:
        write_file(args.output, found.toml())
        print(found.text())
    else:
        print(f"{found.text()}\n\n{found.toml()}", end="")
    return 0
