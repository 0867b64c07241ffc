"""``servo-twin``: replay, compare and export recorded runs, without ROS and in less than their time."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.figure import write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.runtime.program import program
from servo_msgs_py.table_text import aligned
from servo_msgs_py.trace import Trace

from servo_msgs_py import argument
from servo_twin.board import BoardError, SimulationError, firmware_of
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.level import FAST_LEVEL, add_level_options, chosen_level, use_elf
from servo_twin.lockstep.twin import Pair
from servo_twin.plant import PlantConfig
from servo_twin.robot.command import load_on_line
from servo_twin.runs import replay_report, spectrum, steps
from servo_twin.runs.alignment import FIT, RESET, START, shift_of
from servo_twin.runs.compare import Compared, compare, table
from servo_twin.runs.compare_output import Picture, RerunFile
from servo_twin.runs.curves import curves_of
from servo_twin.runs.divergence import noise_bands
from servo_twin.runs.export import FORMATS, export
from servo_twin.runs.member_search import explain
from servo_twin.runs.recorded import DEFAULT_NAMESPACE, RecordedRun
from servo_twin.runs.replay import Replay, WhatIf, model_of
from servo_twin.runs.replay_output import McapOutput, RrdOutput
from servo_twin.servo_config import ServoConfig
from servo_twin.view import layouts

DIVERGENCE, BAD_INPUT = 1, 2
_RECORDING = ".mcap or .db3 file, or folder of a bag"
_CURVES = ".mcap, bag, .rrd of the viewer, .csv of servo-tool record"
_NAMESPACE = "of the bridge in a recording (default: /servo)"
_PICTURES = (".png", ".svg", ".pdf")
_OUTPUTS: Mapping[str, type[McapOutput | RrdOutput]] = {".mcap": McapOutput, ".rrd": RrdOutput}


def parser() -> argparse.ArgumentParser:
    """Command line of ``servo-twin``."""
    result = argument.Parser(prog="servo-twin", description="Recorded runs: would the drive do it again?")
    verbs = result.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    replayer = verbs.add_parser(
        "replay",
        help="repeat a recorded run on the twin and name the first divergence",
        description="Repeats a recorded run on the twin, at the same ticks, and names the first divergence. "
        "Exit status: 0 identical, 1 divergence, 2 wrong input.",
    )
    replayer.add_argument("run", type=Path, metavar="RUN", help=_RECORDING)
    replayer.add_argument("--plant", type=Path, metavar="FILE", help="what if: another plant, changes of plant.toml")
    replayer.add_argument("--config", type=Path, metavar="FILE", help="what if: another configuration, a servo.toml")
    replayer.add_argument(
        "--firmware",
        type=Path,
        metavar="DIR",
        help="what if: another build, a checkout after `make build`",
    )
    replayer.add_argument("--robot", metavar="MODEL", help="what if: another MuJoCo model that the shafts move")
    replayer.add_argument("--seed", type=int, help="seed of the sensor noise (default: recorded, or 1)")
    add_level_options(replayer, "the twin is", FAST_LEVEL)
    _add_common_options(replayer, ".mcap, .rrd or .json")
    replayer.set_defaults(run_command=_replay)
    comparer = verbs.add_parser(
        "compare",
        help="name the largest differences between runs",
        description="Compares runs with the first one. Exit status: 0 within noise, 1 beyond it, 2 wrong input.",
    )
    comparer.add_argument("runs", type=Path, nargs="+", metavar="RUN", help=_CURVES)
    comparer.add_argument(
        "--at",
        default=FIT,
        metavar="EVENT",
        help=f"align at the best {FIT} of the speeds (default), the {RESET} of the board, the {START} of the runs, or "
        "the first change of a variable: applied_count for the first command",
    )
    _add_common_options(comparer, ".png, .svg, .pdf or .rrd")
    comparer.set_defaults(run_command=_compare)
    stepper = verbs.add_parser(
        "steps",
        help="rise, settling, overshoot and lag of every step and move of a run",
        description="Finds every change of a set-point between two rests and measures how the shaft follows: position "
        "where it is controlled, else speed. Exit status: 0 all settled, 1 one did not, 2 wrong input.",
    )
    _add_curve_options(stepper)
    stepper.add_argument(
        "--band",
        type=argument.positive,
        metavar="VALUE",
        help=f"half width of the band of arrival [rad] or [rad/s] (default: {100 * steps.BAND:g} %% of each step)",
    )
    stepper.set_defaults(run_command=_steps)
    analyser = verbs.add_parser(
        "spectrum",
        help="amplitude spectrum of a variable of a run",
        description="Averages the spectrum of a variable and names its lines, at constant speed also in periods per "
        "turn of the shaft. Exit status: 0 success, 2 wrong input.",
    )
    _add_curve_options(analyser)
    analyser.add_argument("variable", metavar="VARIABLE", help="as axis1.speed")
    for name, what in (("--start", "begin"), ("--end", "end")):
        analyser.add_argument(name, type=argument.finite, metavar="SECONDS", help=f"{what} (default: of the run)")
    analyser.set_defaults(run_command=_spectrum)
    layouter = verbs.add_parser(
        "layout",
        help="layout of the plots of both axes for PlotJuggler or Foxglove",
        description="Writes a layout with position, speed, current and residual of both axes over the topics of bridge "
        "and twin.",
    )
    layouter.add_argument(
        "-o",
        "--output",
        type=argument.output_file,
        required=True,
        metavar="FILE",
        help=".xml: PlotJuggler, .json: Foxglove",
    )
    layouter.add_argument(
        "--namespace", type=argument.namespace, default=DEFAULT_NAMESPACE, help="of the bridge (default: %(default)s)"
    )
    layouter.add_argument(
        "--twin",
        type=argument.namespace,
        default="/twin",
        metavar="NAMESPACE",
        help="of the twin (default: %(default)s)",
    )
    layouter.add_argument(
        "--joints",
        nargs=AXES,
        default=[axis_name(axis) for axis in range(AXES)],
        metavar="NAME",
        help="names of the joints, if the bridge has others than axis1 axis2",
    )
    layouter.set_defaults(run_command=_layout)
    exporter = verbs.add_parser(
        "export",
        help="write the tables of a recording as CSV or Parquet files",
        description="Writes one table per topic, and per command variable, with times, ticks and SI units in the heads "
        "of the columns. Topics with texts and states are left out. Exit status: 0 success, 2 wrong input.",
    )
    exporter.add_argument("run", type=Path, metavar="RUN", help=f"{_RECORDING}; or .rrd of the viewer")
    exporter.add_argument(
        "-o",
        "--output",
        type=argument.output_folder,
        required=True,
        metavar="FOLDER",
        help="files of the same name are replaced",
    )
    exporter.add_argument("--format", choices=FORMATS, default="csv", help="default: csv; parquet needs pyarrow")
    exporter.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="TOPIC",
        help="only this one, as /servo/snapshot; repeatable",
    )
    _add_json_option(exporter)
    exporter.set_defaults(run_command=_export)
    return result


def _add_json_option(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--json", action="store_true", help="print the result as JSON, SI units")


def _add_curve_options(verb: argparse.ArgumentParser) -> None:
    """Options of a command that measures the curves of one run."""
    verb.add_argument("run", type=Path, metavar="RUN", help=_CURVES)
    verb.add_argument("--namespace", type=argument.namespace, default="", help=_NAMESPACE)
    _add_json_option(verb)
    verb.add_argument("-o", "--output", type=argument.picture, metavar="FILE", help="picture of the result")


def _add_common_options(verb: argparse.ArgumentParser, outputs: str) -> None:
    """Options of a command that compares a run with another one, or with the twin."""
    verb.add_argument("--namespace", type=argument.namespace, default="", help=_NAMESPACE)
    verb.add_argument(
        "--thresholds", type=Path, metavar="FILE", help="noise of a healthy pair, from `servo_twin calibrate`"
    )
    _add_json_option(verb)
    verb.add_argument(
        "-o", "--output", type=argument.output_file, action="append", default=[], metavar="FILE", help=outputs
    )


def _check_suffixes(paths: Sequence[Path], known: Sequence[str]) -> None:
    for path in paths:
        if path.suffix not in known:
            raise ValueError(f"{path}: the name must end with one of {', '.join(known)}")


def _compare(args: argparse.Namespace) -> int:
    if len(args.runs) < 2:
        raise ValueError("give at least two runs")
    _check_suffixes(args.output, (*_PICTURES, ".rrd"))
    runs = [curves_of(path, args.namespace) for path in args.runs]
    titles = {f"run{number}": path.name for number, path in enumerate(args.runs, 1)}
    reference, *others = titles
    bands = noise_bands(Thresholds.load(args.thresholds, FAST_LEVEL), PlantConfig.load().bus.u_source)
    pictures = {path: Picture(titles) for path in args.output if path.suffix in _PICTURES}
    recordings = [RerunFile(path, titles) for path in args.output if path.suffix == ".rrd"]
    results: dict[str, Compared] = {}
    for source, other in zip(others, runs[1:], strict=True):

        def watch(block: Trace, values: Mapping[str, NDArray[np.float64]], source: str = source) -> None:
            outputs: list[Picture | RerunFile] = [*pictures.values(), *recordings]
            for output in outputs:
                output.watch(source, reference, block, values)

        shift = shift_of(runs[0], other, args.at)
        results[source] = compare(runs[0], other, shift, bands, watch if args.output else None)
    for path, picture in pictures.items():
        picture.write(path)
    for recording in recordings:
        recording.close()
    if args.json:
        print(json.dumps({titles[source]: asdict(one) for source, one in results.items()}, indent=2))
    else:
        for source, one in results.items():
            print(
                f"{titles[reference]} minus {titles[source]}, shifted by {one.shift:+.4f} s: {one.samples} samples, "
                f"{one.start:.3f} to {one.end:.3f} s"
            )
            print("\n".join(aligned(table(one), "<>>>>")))
    return DIVERGENCE if any(one.beyond_noise for one in results.values()) else 0


def _replay(args: argparse.Namespace) -> int:
    use_elf(args)
    level = chosen_level(args.level, default=FAST_LEVEL)
    what_if = WhatIf(
        PlantConfig.load(args.plant) if args.plant else None,
        ServoConfig.load(args.config) if args.config else None,
        level,
        args.seed,
        firmware_of(args.firmware) if args.firmware else None,
        load_on_line(args.robot) if args.robot else None,
    )
    _check_suffixes(args.output, (*_OUTPUTS, ".json"))
    run = RecordedRun(args.run, args.namespace)
    model = model_of(run.contents, what_if)
    outputs = [_OUTPUTS[path.suffix](path) for path in args.output if path.suffix in _OUTPUTS]

    def watch(pair: Pair, torque_constants: Sequence[float]) -> None:
        for output in outputs:
            output.watch(pair, torque_constants)

    replayed = Replay(run, model, Thresholds.load(args.thresholds, level), watch if outputs else None).run()
    for output in outputs:
        output.close()
    if not args.config and not args.firmware:  # else the difference is known
        replayed.explained = explain(run, model, replayed)
    document = json.dumps(replay_report.document(replayed), indent=2)
    for path in args.output:
        if path.suffix == ".json":
            write_file(path, document + "\n")
    if args.json:
        print(document)
    else:
        print(replay_report.text(replayed))
    if not replayed.stretches:
        return BAD_INPUT
    return DIVERGENCE if replayed.first is not None else 0


def _steps(args: argparse.Namespace) -> int:
    found = steps.steps_of(curves_of(args.run, args.namespace), args.band)
    if not found:
        raise ValueError(f"{args.run} has no step: no set-point changes between two rests")
    if args.json:
        print(json.dumps([steps.document(step) for step in found], indent=2))
    else:
        print("\n".join(aligned(steps.table(found), "><<>")))
    if args.output:
        write_figure(steps.picture(found), args.output)
    return DIVERGENCE if any(step.figures.settling_time is None for step in found) else 0


def _spectrum(args: argparse.Namespace) -> int:
    run = curves_of(args.run, args.namespace)
    found = spectrum.spectrum_of(run, args.variable, args.start, args.end)
    known = Catalogue.load().variables.get(args.variable)
    unit = known.unit if known else ""
    if args.json:
        print(json.dumps([asdict(line) for line in found.lines], indent=2))
    elif found.lines:
        print("\n".join(aligned(spectrum.table(found, unit), ">")))
    else:
        print(f"no line from {found.frequency[3]:.2g} to {found.frequency[-1]:.4g} Hz")
    if args.output:
        write_figure(spectrum.picture(found, unit), args.output)
    return 0


def _layout(args: argparse.Namespace) -> int:
    _check_suffixes([args.output], list(layouts.FORMATS))
    namespaces = ["/" + name.strip("/") for name in (args.namespace, args.twin)]
    columns = layouts.plots(args.joints, *namespaces)
    write_file(args.output, layouts.FORMATS[args.output.suffix](columns, args.joints))
    return 0


def _export(args: argparse.Namespace) -> int:
    exported = export(args.run, args.output, args.format, args.topic)
    troubles = [f"{text} ({count} times)" if count > 1 else text for text, count in exported.troubles.items()]
    if args.json:
        tables = [{**asdict(table), "path": str(table.path)} for table in exported.tables]
        print(json.dumps({"tables": tables, "left_out": exported.left_out, "missing": troubles}, indent=2))
    else:
        rows = [["file", "rows", "columns"]]
        rows += [[str(table.path), str(table.rows), str(table.columns)] for table in exported.tables]
        print("\n".join(aligned(rows, "<>>")))
        if exported.left_out:
            print(f"without numbers for a table: {', '.join(sorted(exported.left_out))}")
        print(*(f"missing: {text}" for text in troubles), sep="\n", end="\n" if troubles else "")
    if not exported.tables:
        raise ValueError(f"{args.run} has no table" + (f" of {', '.join(args.topic)}" if args.topic else ""))
    return 0


@program("servo-twin")
def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns
    -------
    int
        0: success, 1: divergence, 2: wrong usage or input; else `program`.
    """
    args = parser().parse_args(argv)
    try:
        return int(args.run_command(args))
    except (BoardError, SimulationError, ValueError) as error:
        print(f"servo-twin: {error}", file=sys.stderr)
        return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
