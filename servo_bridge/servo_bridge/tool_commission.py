"""``servo-tool commission``: from a new board and motor to the first recorded move, step by step."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import TYPE_CHECKING, Final

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.output_file import write_file
from servo_msgs_py.runtime.program import complain

from servo_bridge import tool_identify
from servo_bridge.commissioning.figure import ImplausibleError, lines, require
from servo_bridge.commissioning.pack import Pack, PackError
from servo_bridge.commissioning.report import page
from servo_bridge.tool_commission_steps import CONFIG, FAILURES, PLANT, STEPS, Step, Subject, missing
from servo_bridge.tool_values import UsageError
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

ABOUT: Final = """\
Commission an axis of a new board: identification of the board, supply, pins, encoder, identification of the motor,
tuning, Bode plots, storage on the board, first move with a recording. Each step says what it will do and is confirmed
before the shaft moves. The sequence ends at the first implausible figure; the same command continues it there. The
folder of --out has recording, configuration, plant file and report.html."""

_REPORT: Final = "report.html"
_OUT: Final = "out/commission"
_AXES: Final = [axis_name(axis) for axis in range(AXES)]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.add_argument("axis", choices=_AXES)
    tool_identify.add_limits(command)
    command.add_argument("--yes", action="store_true", help="confirm every step: the shaft moves within the limits")
    command.add_argument(
        "--again",
        choices=[step.name for step in STEPS],
        metavar="STEP",
        help=f"repeat from this step on: {', '.join(step.name for step in STEPS)}",
    )
    command.add_argument(
        "--out",
        type=argument.output_folder,
        default=_OUT,
        metavar="FOLDER",
        help="the files are in FOLDER/AXIS (default: %(default)s)",
    )


def check(args: argparse.Namespace) -> None:
    """Check limits, files, packages and the terminal."""
    args.folder = args.out / args.axis
    for name, option in ((CONFIG, "config"), (PLANT, "plant")):
        if getattr(args, option) is None:  # the other axis may have been commissioned before
            others = [args.out / other / name for other in _AXES if other != args.axis]
            setattr(args, option, next((path for path in others if path.is_file()), None))
    tool_identify.check(args)
    if needed := missing():
        raise UsageError(f"commission needs {needed}: install it with pip")
    if not args.yes and not sys.stdin.isatty():
        raise UsageError("there is no terminal to confirm the steps; --yes confirms all of them")


def commission(context: Context) -> int:
    """Run the steps that are not done; returns 1 if one is not possible or has an implausible figure."""
    args, session = context.args, context.session
    if session.mismatch is not None:
        complain(f"servo-tool: {session.mismatch}")
        return 1
    subject = Subject(
        context,
        _AXES.index(args.axis),
        args.limits,
        args.base,
        args.config,
        args.plant,
        args.folder,
        None if args.yes else _asked,
    )
    known = {"axis": args.axis, "board": f"{session.info.name} {session.info.build}".strip()}
    try:
        pack = Pack.opened(args.folder, known | dataclasses.asdict(args.limits))
    except PackError as error:
        complain(f"servo-tool: {error}")
        return 1
    if args.again:
        names = [step.name for step in STEPS]
        pack.forget(names[names.index(args.again) :])
    trouble = ""
    for step in STEPS:
        trouble = _taken(step, subject, pack)
        write_file(args.folder / _REPORT, page(pack, trouble))
        if trouble:
            break
    if trouble:
        complain(f"servo-tool: {trouble}")
        return 1
    print(f"commissioned; report: {args.folder / _REPORT}")
    return 0


def _taken(step: Step, subject: Subject, pack: Pack) -> str:
    """Take a step and keep its result; returns why the sequence ends, else nothing."""
    if step.confirmed and step.name in pack.done:
        print(f"{step.name}: done before (--again '{step.name}' repeats it)")
        return ""
    print(f"{step.name}: {step.about(subject)}", flush=True)
    if step.confirmed and subject.ask is not None and subject.ask("Go on? [Enter: yes, n: no] ").strip():
        return f"ended before the step {step.name!r}; the same command continues"
    try:
        done = step.run(subject)
    except FAILURES as error:
        return f"{step.name}: {error}"
    print(*(f"  {line}" for line in (*lines(done.figures), *done.texts)), sep="\n", flush=True)
    try:
        require(done.figures)
    except ImplausibleError as error:
        return f"{step.name}: {error}; the same command repeats this step"
    pack.keep(step.name, done)
    return ""


def _asked(text: str) -> str:
    try:
        return input(text)
    except EOFError:
        return "n"
