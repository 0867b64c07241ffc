"""Options that several commands share."""

from __future__ import annotations

import argparse
import math

from servo_msgs_py import argument


def add_range(command: argparse.ArgumentParser) -> None:
    """Option of a command that turns the shaft; `math.inf` by default."""
    command.add_argument(
        "--range",
        type=argument.positive,
        default=math.inf,
        metavar="RAD",
        help="largest angle of the shaft in each direction",
    )
