"""Command line of ``servo-command``; this module imports little, so that help and completion are quick."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Final

from servo_msgs_py.board_parameters import Assignment, find, parse
from servo_msgs_py.catalogue import Catalogue, Variable
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.value_text import parse_assignment

from servo_msgs_py import argument, topics

QUANTITIES: Final = {"position": "rad", "velocity": "rad/s", "effort": "N m"}
"""Units of the set-points."""

PATH_VERBS: Final = ("move", "follow", "sine")

_METHODS: Final = [name.replace("_", "-") for name in topics.HOME_METHODS if name != "here"]


def _target(unit: str) -> Callable[[str], tuple[str, float]]:
    """Parser of a joint with a value in a unit."""

    def target(text: str) -> tuple[str, float]:
        try:
            joint, value = parse_assignment(text, "JOINT=VALUE, for example axis1=1.57")
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        return joint, argument.finite(value, Quantity(unit=unit))

    return target


def _assignment(text: str) -> Assignment:
    try:
        return parse(text, Catalogue.load())
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _waypoints(text: str) -> object:
    from servo_bridge.trajectory.errors import TrajectoryError
    from servo_bridge.trajectory.files import read_waypoints

    try:
        return read_waypoints(text)
    except TrajectoryError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parameter(text: str) -> tuple[Variable, int | None]:
    try:
        return find(text, Catalogue.load())
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def command_parser() -> argparse.ArgumentParser:
    """Command line of ``servo-command``."""
    parser = argument.Parser(prog="servo-command", description="Send one command to the servo over ROS.")
    parser.add_argument(
        "--namespace", type=argument.namespace, default="/servo", help="namespace of the bridge (default: %(default)s)"
    )
    parser.add_argument(
        "--wait", type=argument.not_negative, default=10.0, metavar="S", help="time to wait (default: %(default)s)"
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    for verb, text in (
        ("enable", "enable the axes in use (rotor search, then position hold)"),
        ("disable", "stop with a ramp, then switch the outputs off"),
        (
            topics.QUICK_STOP,
            "stop as param.on_quick_stop says, by default at the acceleration limit, and hold; enable to continue",
        ),
        (topics.CLEAR_FAULTS, "clear the faults whose cause is gone"),
    ):
        verbs.add_parser(verb, help=text)
    state = verbs.add_parser("state", help="print state, positions, speeds, faults with remedy, active limits")
    state.add_argument(
        "--check",
        action="store_true",
        help="exit status 1, with the reason, unless the board is connected, without a fault and ready for set-points",
    )
    homer = verbs.add_parser("home", help="home a joint to a hard stop or a home switch (the joint moves)")
    homer.add_argument("joint", metavar="JOINT")
    homer.add_argument(
        "--method",
        required=True,
        metavar="METHOD",
        choices=_METHODS,
        help=", ".join(_METHODS),
    )
    homer.add_argument(
        "--position",
        type=argument.finite,
        metavar="RAD",
        help="position of the joint at the reference; stored in parameter home_positions of the bridge (default)",
    )
    zero = verbs.add_parser("zero", help="set the present position of a joint")
    zero.add_argument("joint", metavar="JOINT")
    zero.add_argument("position", nargs="?", type=argument.finite, default=0.0, metavar="RAD", help="default: 0")
    setter = verbs.add_parser("set", help="set parameters of the board; the bridge repeats this after a reconnection")
    setter.add_argument(
        "assignments",
        nargs="+",
        type=_assignment,
        metavar="NAME=VALUE",
        help="such as 'param.features[0]=ANTI_WINDUP+POSITION_LIMITS' or param.i_q_limit=1.0,1.5",
    )
    getter = verbs.add_parser("get", help="print parameters of the board")
    getter.add_argument("names", nargs="*", type=_parameter, metavar="NAME", help="default: all")
    for quantity, unit in QUANTITIES.items():
        wait = "; waits until they are reached" if quantity == "position" else ""
        verb_parser = verbs.add_parser(quantity, help=f"set-points [{unit}] of one or both joints{wait}")
        verb_parser.add_argument("targets", nargs="+", type=_target(unit), metavar="JOINT=VALUE", help=f"[{unit}]")
        if quantity == "position":
            verb_parser.set_defaults(duration=0.0)
        else:
            verb_parser.add_argument(
                "--for",
                dest="duration",
                type=argument.not_negative,
                default=1.0,
                metavar="S",
                help="time for which they are repeated (default: 1)",
            )
    _add_path_verbs(verbs)
    return parser


def _add_path_verbs(verbs: argparse._SubParsersAction[argument.Parser]) -> None:
    """Add the path commands to the parser."""
    mover = verbs.add_parser("move", help="move to positions [rad] in a given time, or as fast as the limits allow")
    mover.add_argument("targets", nargs="+", type=_target("rad"), metavar="JOINT=VALUE", help="[rad]")
    mover.add_argument("--time", type=argument.positive, metavar="S", help="default: the shortest within the limits")
    follower = verbs.add_parser(
        "follow", help="follow a path from a .csv (time, joints, <joint>_velocity) or .json file"
    )
    follower.add_argument("waypoints", type=_waypoints, metavar="FILE")
    waver = verbs.add_parser("sine", help="follow a sine about the present position, with fade-in and fade-out")
    waver.add_argument("joint", metavar="JOINT")
    waver.add_argument("--amplitude", type=argument.positive, required=True, metavar="RAD")
    waver.add_argument("--frequency", type=argument.positive, required=True, metavar="HZ")
    waver.add_argument("--for", dest="duration", type=argument.positive, default=5.0, metavar="S", help="default: 5")
    for parser in (mover, follower, waver):
        parser.add_argument(
            "--dry-run",
            action="store_true",
            help="only print speed, acceleration and current of the path, with the limits",
        )
