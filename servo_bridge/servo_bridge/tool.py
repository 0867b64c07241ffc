"""``servo-tool``: read and change a board from the command line. Needs no ROS.

Exit status: 0 done; 1 the board refused or was not found (`diff`: or differs), or a disk is full; 2 wrong arguments, or
a file that cannot be read; of signals see `servo_msgs_py.runtime.program`.
"""

from __future__ import annotations

import argparse
import getpass
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.figure import PictureError
from servo_msgs_py.output_file import write_file
from servo_msgs_py.rerun_file import RecordingError
from servo_msgs_py.runtime.program import program

from servo_bridge import (
    tool_autotune,
    tool_bode,
    tool_commands,
    tool_commission,
    tool_faults,
    tool_identify,
    tool_record,
    tool_resonance,
    tool_ripple,
    tool_scope,
    tool_storage,
    tool_tune,
)
from servo_bridge.bursts.request import BurstRequest
from servo_bridge.desktop_project import desktop_project
from servo_bridge.freemaster.client import PASSWORD_VARIABLE, Client, password_of_environment
from servo_bridge.freemaster.errors import FreemasterError, OutOfRangeError, RecorderError
from servo_bridge.freemaster.line import Line
from servo_bridge.parameter_file import ParameterFileError
from servo_bridge.tool_values import UnknownVariableError, UsageError
from servo_bridge.wire.link_state import status_of
from servo_bridge.wire.serial_port import SerialPort
from servo_bridge.wire.session import connect
from servo_msgs_py import argument

_STARTUP_RETRIES = 5
_PROJECT = "project"


def _port(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("empty; write a device path or a pyserial URL")
    return text


def _password(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("empty")
    return text


def _project_file(text: str) -> Path:
    if Path(text).suffix != ".pmpx":
        raise argparse.ArgumentTypeError(f"{text} does not end in .pmpx")
    return argument.output_file(text)


def _nothing(_: argparse.Namespace) -> None:
    """Check of a command that has nothing to check without a board."""


def _ask_password() -> str | None:
    """Read the password from the terminal; None without a terminal or input."""
    if not sys.stdin.isatty():
        return None
    try:
        return getpass.getpass("password of the board: ") or None
    except EOFError:
        return None


def _parser() -> argparse.ArgumentParser:
    common = argument.Parser(add_help=False)
    common.add_argument(
        "--port",
        type=_port,
        default=argparse.SUPPRESS,
        help="device or pyserial URL (default: $SERVO_PORT or /dev/ttyUSB0)",
    )
    common.add_argument(
        "--baud", type=argument.count, default=argparse.SUPPRESS, help="line speed (default: $SERVO_BAUD or 115200)"
    )
    common.add_argument(
        "--password",
        type=_password,
        default=argparse.SUPPRESS,
        metavar="TEXT",
        help=f"password, for boards that require one (default: ${PASSWORD_VARIABLE}, else asked at the terminal)",
    )
    parser = argument.Parser(
        prog="servo-tool",
        description="Read and change a servo board, or any FreeMASTER target (version 3 or 4), over its serial line. "
        "Values of servo boards are in SI units.",
        epilog="exit status: 0 done, 1 the board refused or was not found (diff: or differs), 2 wrong arguments or a "
        "file that cannot be read",
        parents=[common],
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, run: tool_commands.CommandFunction, text: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text, parents=[common])
        command.set_defaults(run=run, check=_nothing)
        return command

    add("info", tool_commands.info, "print the identification of the board")
    command = add("vars", tool_commands.list_variables, "list the variables of the board")
    command.add_argument("pattern", nargs="?", default="*", help="only names that match, such as 'axis1.*'")
    command = add("get", tool_commands.get, "read variables")
    command.add_argument("names", nargs="+", metavar="NAME", help="variable, or element such as cmd.position[1]")
    _add_raw(command)
    command.add_argument("--json", action="store_true", help="print one JSON object")
    command = add("set", tool_commands.set_variable, "write a variable and read it back")
    command.add_argument("name", metavar="NAME", help="variable, or element such as cmd.position[1]")
    command.add_argument(
        "value", metavar="VALUE", help="number or name, flags joined by +; commas between the elements of an array"
    )
    command.add_argument("--element", type=int, metavar="K", help="write only element K, counted from 0")
    _add_raw(command)
    command = add("watch", tool_commands.watch, "print variables periodically until Ctrl-C")
    command.add_argument("names", nargs="+", metavar="NAME")
    command.add_argument("--rate", type=argument.positive, default=5.0, help="lines per second (default: 5)")
    command.add_argument("--count", type=argument.count, help="end after this many lines")
    command = add(
        "record",
        tool_record.record,
        "write variables to a file: at the rate of the line, or as a burst at the rate of the control loops",
    )
    command.set_defaults(check=tool_record.check)
    command.add_argument("names", nargs="+", metavar="NAME")
    command.add_argument(
        "-o",
        "--output",
        required=True,
        action="append",
        type=argument.output_file,
        metavar="FILE",
        help=".csv; for a burst also .png, .svg, .pdf, .npz or .rrd, and several files",
    )
    command.add_argument("--duration", type=argument.positive, help="seconds (default: until Ctrl-C)")
    command.add_argument("--rate", type=argument.positive, help="rows, or points of a burst, per second (default: all)")
    tool_record.add_options(command)
    command = add("log", tool_commands.log, "print the event log of the board (a pipe), with ticks")
    command.add_argument("--pipe", type=argument.count, default=1, metavar="N", help="number of the pipe (default: 1)")
    command.add_argument("--follow", "-f", action="store_true", help="continue until Ctrl-C")
    command = add(
        "scope",
        tool_scope.scope,
        "show telemetry and repeated bursts of the board's recorder live in the rerun viewer",
    )
    command.set_defaults(check=BurstRequest.of)
    command.add_argument("names", nargs="+", metavar="NAME", help="variable of the bursts")
    tool_scope.add_options(command)
    command = add("snapshot", tool_faults.snapshot, "print the record of the first fault of each axis")
    command.add_argument("axis", nargs="?", choices=("1", "2"), help="only this axis (default: both)")
    command.add_argument("--json", action="store_true", help="print a JSON array, one object per axis with a fault")
    command.add_argument(
        "--plot", type=argument.picture, metavar="FILE", help="draw the snapshot, as .png, .svg or .pdf"
    )
    command = commands.add_parser(
        _PROJECT,
        help="write a project for NXP's desktop tool: all variables with units, SI scales and limits; without a board",
        description="Write a project for NXP's desktop tool FreeMASTER 3. No board is needed.",
        parents=[common],
    )
    command.add_argument("file", type=_project_file, metavar="FILE.pmpx")
    command = add("identify", tool_identify.identify, "identify the motor of an axis; the shaft moves")
    command.set_defaults(check=tool_identify.check)
    tool_identify.add_arguments(command)
    command = add("commission", tool_commission.commission, "commission an axis step by step; the shaft moves")
    command.description = tool_commission.ABOUT
    command.set_defaults(check=tool_commission.check)
    tool_commission.add_arguments(command)
    command = add("tune", tool_tune.tune, "change gains and motor data of a running board, or read them back")
    command.set_defaults(check=tool_tune.check)
    tool_tune.add_arguments(command)
    command = add("bode", tool_bode.bode, "measure the open loop of a controller on the running axis")
    command.description = tool_bode.ABOUT
    tool_bode.add_arguments(command)
    command = add("ripple", tool_ripple.ripple, "measure the torque ripple of a homed axis; the shaft moves")
    command.description = tool_ripple.ABOUT
    tool_ripple.add_arguments(command)
    command = add("resonance", tool_resonance.resonance, "measure a load behind a spring; the shaft moves")
    command.description = tool_resonance.ABOUT
    tool_resonance.add_arguments(command)
    command = add("autotune", tool_autotune.autotune, "choose and confirm the bandwidths for a load; the shaft moves")
    command.set_defaults(check=tool_autotune.check)
    tool_autotune.add_arguments(command)
    for name, run, text in (
        (
            "save",
            tool_commands.save,
            "save the parameters of the board to a file, or parameters and configuration on the board",
        ),
        ("load", tool_commands.load, "write the parameters of a file to the board"),
        ("diff", tool_commands.diff, "compare a file with the board; exit status 1 if they differ"),
    ):
        command = add(name, run, text)
        command.set_defaults(check=tool_commands.check_save if name == "save" else tool_commands.check_file)
        optional = "?" if name == "save" else None
        command.add_argument("file", type=Path, metavar="FILE", help=".toml or .json", nargs=optional)
        if name == "save":
            command.add_argument(
                "--to-board",
                action="store_true",
                help="store parameters and configuration in the data flash of the board; restored at each reset",
            )
            command.add_argument(
                "--match", default="param.*", metavar="PATTERN", help="variables to save (default: 'param.*')"
            )
    add(
        "factory",
        tool_storage.factory,
        "erase the values stored by save --to-board; built-in values from the next reset",
    )
    return parser


def _add_raw(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--raw", action="store_true", help="raw numbers of the type reported by the board, without scaling"
    )


def _run(args: argparse.Namespace) -> int:
    port = getattr(args, "port", os.environ.get("SERVO_PORT") or "/dev/ttyUSB0")
    try:
        baud = getattr(args, "baud", None) or argument.count(os.environ.get("SERVO_BAUD") or "115200")
    except argparse.ArgumentTypeError:
        raise UsageError(f"SERVO_BAUD is {os.environ['SERVO_BAUD']!r}, not a line speed") from None
    if args.command == _PROJECT:  # the only command without a board
        write_file(args.file, desktop_project(Catalogue.load(), baud))
        return 0
    run: tool_commands.CommandFunction = args.run
    check: tool_commands.Check = args.check
    check(args)  # before the port is opened
    connected = False
    try:
        with SerialPort(port, baud) as serial_port:
            # Some boards reset when their port is opened; the first response may take a second.
            client = Client(Line(serial_port, baud=baud, retries=_STARTUP_RETRIES))
            given: str | None = getattr(args, "password", None) or password_of_environment()
            client.ask_password = _ask_password if given is None else lambda: given
            catalogue = Catalogue.load()
            session = connect(client, catalogue)
            connected = True
            return run(
                tool_commands.Context(args, catalogue, session, port, baud, serial_port.low_latency, serial_port.close)
            )
    except (OutOfRangeError, RecorderError) as error:  # not an error of the link
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    except FreemasterError as error:
        print(f"servo-tool: {status_of(error, port, baud, connected=connected)}", file=sys.stderr)
        return 1


@program("servo-tool")
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    args = _parser().parse_args(argv)
    try:
        return _run(args)
    except (UsageError, ParameterFileError, PictureError, RecordingError) as error:
        print(f"servo-tool: {error}", file=sys.stderr)
        return 2
    except UnknownVariableError as error:
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
