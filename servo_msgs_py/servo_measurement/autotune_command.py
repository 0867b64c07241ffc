"""What the commands that tune an axis share, with a board on a serial line and with a virtual one."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from servo_msgs_py.figure import check_picture
from servo_msgs_py.quantity import Quantity
from servo_tuning.board_file import blocks_of
from servo_tuning.errors import ConfigError, Table
from servo_tuning.reading import SERVO_TOML, read_table
from servo_tuning.remedies import explained, refusal_of, tried
from servo_tuning.robust import PHASE_MIN, PHASE_OPTION, PHASES_MIN

from servo_measurement.access import MeasurementError
from servo_measurement.autotune import TOLERANCE_OPTION, Autotuned, AutotuneRequest
from servo_measurement.autotune_report import CONFIG, PICTURE, as_dict, draw, text, write_configuration
from servo_measurement.options import add_range
from servo_measurement.position_move import TOLERANCE
from servo_msgs_py import argument

ABOUT: Final = """\
Choose the bandwidths of an axis for its load: measure inertia and spring of the load, choose the highest bandwidths
that keep phase and gain margin also if the resonance changes by 20 %, try them, and confirm them by the measured open
speed loop and a move. The shaft moves. Only confirmed values stay on the board, until its reset (servo-tool save
--to-board stores them), and in servo.toml of --out; otherwise exit status 1 and the reason. Ctrl-C stops the shaft."""

_OUT: Final = "out/autotune"


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options."""
    command.add_argument(
        "--config", type=Path, metavar="FILE", help="servo.toml of the board (default: the one of the checkout)"
    )
    command.add_argument(
        "--speed", type=argument.positive, metavar="RAD/S", help="speed of the measurements (default: as of bode)"
    )
    add_range(command)
    command.add_argument(
        PHASE_OPTION,
        type=_phase,
        default=PHASE_MIN,
        metavar="DEGREES",
        help="phase margin of speed and position loop (default: %(default)g)",
    )
    command.add_argument(
        TOLERANCE_OPTION,
        type=argument.positive,
        default=TOLERANCE,
        metavar="RAD",
        help="largest distance to the target after a move (default: %(default)s)",
    )
    command.add_argument(
        "--out",
        type=argument.output_folder,
        default=_OUT,
        metavar="FOLDER",
        help="servo.toml and a picture of before and after (default: %(default)s)",
    )


def request_of(args: argparse.Namespace, axis: int) -> AutotuneRequest:
    """The specification; `axis`: index."""
    return AutotuneRequest(axis, args.speed, args.range, args.phase_margin, args.tolerance)


def configuration(args: argparse.Namespace) -> Table:
    """The parsed file of ``--config``.

    Raises
    ------
    ValueError
        If it cannot be used; the text has the file.
    PictureError
        If no picture can be drawn.
    """
    check_picture(args.out / PICTURE)
    path = args.config or SERVO_TOML
    if not path.is_file():
        raise ValueError(f"no such file: {path}; write --config with the servo.toml of this board")
    try:
        table = read_table(path)
        if blocks_of(table) is not None:
            raise ConfigError("has the members of a board, without motor and load: write --config with a servo.toml")
        if (problem := refusal_of(table)) is not None:
            raise ConfigError(tried(problem, table))
    except (ConfigError, OSError) as error:
        raise ValueError(f"{path}: {error}") from None
    return table


def finish(program: str, args: argparse.Namespace, tune: Callable[[Callable[[Autotuned], None]], Autotuned]) -> int:
    """Tune, write the files and print the result; returns 1 if nothing was tuned or confirmed.

    `tune` is `autotune` with its argument `keep`: the file is complete before the board has its configuration.
    """
    try:
        found = tune(lambda result: write_configuration(result, args.out))
    except ConfigError as error:
        print(f"{program}: {explained(error)}", file=sys.stderr)
        return 1
    except (MeasurementError, ValueError) as error:  # a number or a block was refused
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    draw(found, args.out / PICTURE)
    print(json.dumps(as_dict(found), allow_nan=False) if args.json else text(found))
    for problem in found.problems:
        print(f"{program}: not confirmed, the board has its configuration from before: {problem}", file=sys.stderr)
    if not found.problems and not args.json:
        print(f"confirmed; {args.out / CONFIG}")
    return 1 if found.problems else 0


def _phase(text: str) -> float:
    return argument.finite(text, Quantity(minimum=min(PHASES_MIN), maximum=60.0))
