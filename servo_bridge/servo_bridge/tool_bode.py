"""``servo-tool bode``: measure the open loop of a controller on the running axis; compare it with the prediction."""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from servo_measurement.access import MeasurementError
from servo_measurement.bode import Bode, measure
from servo_measurement.bode_plan import LOOPS, BodeRequest
from servo_measurement.bode_report import COLUMNS, as_dict, draw, rows, text
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.output_file import write_file
from servo_msgs_py.quantity import Quantity

from servo_bridge.bode_recording import write_recording
from servo_bridge.tool_measurement import add_loop_options, measured
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

_AXES: Final = [axis_name(axis) for axis in range(AXES)]

ABOUT: Final = """\
Measure the open loop of a controller on the running axis with a swept sine that the board adds to a set-point, and
compare it with the prediction of the tuning code. The shaft moves: the speed loop and the position loop are measured at
a constant speed in alternating directions (--speed 0: about the present position); a current loop is measured while a
current holds the rotor, and the axis must be disabled before. Ctrl-C ends the signal and stops the shaft."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.add_argument("axis", choices=_AXES)
    command.add_argument("loop", choices=list(LOOPS), help="current: loop of i_q; current_d: loop of i_d")
    command.add_argument(
        "--amplitude",
        type=argument.positive,
        metavar="A",
        help="amplitude of the test signal [A]; of the position loop: [rad/s]",
    )
    command.add_argument("--from", dest="f_min", type=argument.positive, metavar="HZ", help="lowest frequency")
    command.add_argument("--to", dest="f_max", type=argument.positive, metavar="HZ", help="highest frequency")
    command.add_argument("--speed", type=argument.finite, metavar="RAD/S", help="constant speed during the measurement")
    command.add_argument("--repeat", type=_repeats, default=4, metavar="N", help="sweeps per band (default: 4)")
    add_loop_options(command, 1.0, "1")
    command.add_argument(
        "--out",
        type=argument.output_folder,
        metavar="DIR",
        help="write curves (.csv) and a plot (.png) to this directory",
    )
    command.add_argument(
        "--rrd", type=argument.output_file, metavar="FILE", help="write a recording for the rerun viewer"
    )
    command.add_argument("--json", action="store_true", help="print one JSON object")


def bode(context: Context) -> int:
    """Measure, write the files, print the figures; returns 1 if the crossover is not confirmed."""
    args = context.args
    request = BodeRequest(
        _AXES.index(args.axis),
        args.loop,
        args.amplitude,
        args.f_min,
        args.f_max,
        args.speed,
        args.range,
        args.repeat,
        args.gain,
    )
    try:
        result = measured(context.session, partial(measure, request=request, enable=args.enable))
        if args.out is not None:
            write_files(result, args.out)
        if args.rrd is not None:
            write_recording(result, args.rrd)
        print(json.dumps(as_dict(result), allow_nan=False) if args.json else text(result).rstrip("\n"))
    except (MeasurementError, ValueError) as error:  # a number or a block was refused
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    return 0 if result.confirmed else 1


def write_files(result: Bode, folder: Path) -> str:
    """Write curves (.csv) and plot (.png); returns their name without extension."""
    stem = f"bode_{axis_name(result.settings.axis)}_{result.settings.loop.name}"
    table = io.StringIO()
    writer = csv.writer(table)
    writer.writerow(COLUMNS)
    writer.writerows([[f"{value:.8g}" for value in row] for row in rows(result).tolist()])
    write_file(folder / f"{stem}.csv", table.getvalue())
    draw(result, folder / f"{stem}.png")
    return stem


def _repeats(text: str) -> int:
    return argument.whole(text, Quantity(minimum=2.0, maximum=100.0, whole=True))
