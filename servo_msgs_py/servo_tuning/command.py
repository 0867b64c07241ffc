"""Command line of the tuning tool."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.codegen import update
from servo_msgs_py.figure import PictureError

from servo_msgs_py import argument
from servo_tuning.braking import brake_constants
from servo_tuning.configuration import Configuration
from servo_tuning.constants import time_outs
from servo_tuning.errors import ConfigError
from servo_tuning.passwords import password_constants
from servo_tuning.picture import draw
from servo_tuning.reading import SERVO_TOML, load
from servo_tuning.remedies import explained
from servo_tuning.report import as_dict, axis_reports, text
from servo_tuning.source import c_source

_ABOUT: Final = """\
Tune the two axes: convert motor data, inertia and bandwidths of a configuration (servo.toml) to the integers of the
firmware. A configuration that cannot work is refused with the entry, the reason and a remedy."""

_EPILOG: Final = """\
exit status: 0 done; 1 the configuration is refused, or with --check the C file is out of date; 2 wrong arguments, or
a file that cannot be opened.
Warnings are printed to standard error and do not change the exit status.

another motor: edit servo.toml (or a copy), check it with `tune.py report`, then `make generate` and `make build`;
README.md in the directory of this tool has the details."""


def parser() -> argparse.ArgumentParser:
    """Parser of the command line; the default command is ``generate``."""
    layout = ParagraphFormatter
    result = argument.Parser(prog="tune.py", description=_ABOUT, epilog=_EPILOG, formatter_class=layout)
    common = argument.Parser(add_help=False)
    common.add_argument(
        "--config",
        type=Path,
        default=SERVO_TOML,
        metavar="FILE",
        help="configuration (default: %(default)s)",
    )
    verbs = result.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    about = "write the C file of the firmware (the default command)"
    generate = verbs.add_parser("generate", parents=[common], help=about, description=about)
    target = SERVO_TOML.with_name("servo_config_gen.c")
    generate.add_argument(
        "--output", type=argument.output_file, default=target, metavar="FILE", help="C file (default: %(default)s)"
    )
    generate.add_argument("--check", action="store_true", help="compare only, write nothing")
    generate.set_defaults(run=_generate)
    about = "print gains, margins, poles, E43..E45, sensitivity to the inertia"
    report = verbs.add_parser("report", parents=[common], help=about, description=about)
    report.add_argument("--json", action="store_true", help="all figures as JSON on standard output")
    report.add_argument("--plot", type=argument.picture, metavar="FILE", help="draw the responses (needs matplotlib)")
    report.set_defaults(run=_report)
    return result


def _generate(args: argparse.Namespace, configuration: Configuration) -> int:
    reports = axis_reports(configuration)
    for report in reports:
        for finding in report.findings:
            print(f"{args.config}: warning: {finding}", file=sys.stderr)
    source = c_source(
        [report.tuned.constants for report in reports],
        brake_constants(configuration),
        {**time_outs(configuration.board), **password_constants(configuration.board.passwords)},
    )
    stale = update([(args.output, source)], check=args.check)
    return 1 if args.check and stale else 0


def _report(args: argparse.Namespace, configuration: Configuration) -> int:
    reports = axis_reports(configuration)
    if args.plot:
        draw(reports, args.plot)
    print(json.dumps(as_dict(reports), indent=2, allow_nan=False) if args.json else text(reports), end="")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit status."""
    given = list(sys.argv[1:] if argv is None else argv)
    if not given or (given[0].startswith("-") and given[0] not in ("-h", "--help")):
        given.insert(0, "generate")
    args = parser().parse_args(given)
    try:
        return int(args.run(args, load(args.config, Catalogue.load())))
    except ConfigError as error:
        print(f"{args.config}: {explained(error)}", file=sys.stderr)
    except PictureError as error:
        print(error, file=sys.stderr)
    return 1
