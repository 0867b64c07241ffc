"""``servo-tool resonance``: measure motor and load on a spring; write the group of ``servo.toml``."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from typing import TYPE_CHECKING, Final

from servo_measurement.access import MeasurementError
from servo_measurement.resonance import BANDWIDTH, ResonanceRequest, measure
from servo_msgs_py.catalogue import AXIS_NAMES
from servo_msgs_py.output_file import write_file
from servo_msgs_py.runtime.program import complain

from servo_bridge.tool_measurement import add_loop_options, measured
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

ABOUT: Final = """\
Measure inertia, stiffness and damping of a load behind a spring (a belt, a coupling, a long shaft), and write the group
[axisN.load] of servo.toml, with which tune checks the loops. The shaft turns in both directions at a constant speed,
with a part of the bandwidths of speed and position control, so that it does not oscillate. Ctrl-C stops it."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.add_argument("axis", choices=AXIS_NAMES)
    command.add_argument(
        "--speed", type=argument.positive, metavar="RAD/S", help="constant speed (default: as of bode)"
    )
    add_loop_options(command, None, f"for a bandwidth of {BANDWIDTH:g} Hz")
    command.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    command.add_argument(
        "-o", "--output", type=argument.output_file, metavar="FILE.toml", help="file to write (default: print it)"
    )


def resonance(context: Context) -> int:
    """Measure, print the table, write the group; returns 1 if it could not be measured."""
    args = context.args
    request = ResonanceRequest(AXIS_NAMES.index(args.axis), args.speed, args.range, args.gain)
    try:
        found = measured(context.session, partial(measure, request=request, enable=args.enable))
    except (MeasurementError, ValueError) as error:  # a number or a block was refused
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    print(json.dumps(found.as_dict(), allow_nan=False) if args.json else found.text())
    if args.output and found.toml():
        write_file(args.output, found.toml())
    elif args.output:
        complain(f"servo-tool: {args.output} is not written: there is no load behind a spring")
    elif found.toml() and not args.json:
        print(f"\n{found.toml()}", end="")
    return 0
