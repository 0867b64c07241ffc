"""``servo-sim experiment``: run experiments, print and write the results."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.output_file import write_file

from servo_msgs_py import argument
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import EXPERIMENTS, levels, rig
from servo_twin.validation.experiments.outcome import Bound, Outcome, Row
from servo_twin.validation.experiments.plant_limits import differences
from servo_twin.validation.experiments.report import draw, summary, table, update_summary
from servo_twin.validation.experiments.rig import at_level

_OUT: Final = "out/experiments"


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``experiment`` with one command per experiment to the commands of ``servo-sim``.

    Parameters
    ----------
    verbs : argparse subparsers
        Subparsers of ``servo-sim``.
    common : ArgumentParser
        Parent with ``--seed``, ``--plant`` and ``--json``.
    levelled : ArgumentParser
        Parent with ``--level``.
    """
    experiment = verbs.add_parser("experiment", help="repeat the experiments of the reference design")
    names = experiment.add_subparsers(dest="experiment", required=True, metavar="NAME")
    for entry in EXPERIMENTS.values():
        parser = names.add_parser(
            entry.name,
            parents=[common, levelled],
            help=_first_sentence(entry.help).replace("%", "%%"),
            description=entry.help,
            formatter_class=ParagraphFormatter,
        )
        if entry.add_options is not None:
            entry.add_options(parser)
        parser.add_argument("--plot", type=argument.picture, metavar="FILE", help="file for the picture")
        parser.add_argument(
            "--out", type=argument.output_folder, metavar="FOLDER", help="folder for table, picture and summary"
        )
        parser.set_defaults(run=_run, names=[entry.name])
    everything = names.add_parser("all", parents=[common, levelled], help="run all experiments")
    everything.add_argument(
        "--out",
        type=argument.output_folder,
        default=_OUT,
        metavar="FOLDER",
        help="folder for tables, pictures, summary (default: %(default)s)",
    )
    everything.set_defaults(run=_run, names=list(EXPERIMENTS), plot=None)
    both = names.add_parser(
        "levels",
        parents=[common],
        help="run all experiments at both levels of the board and compare them",
        description=levels.HELP,
        formatter_class=ParagraphFormatter,
    )
    both.add_argument(
        "--only",
        nargs="+",
        choices=list(EXPERIMENTS),
        default=[name for name in EXPERIMENTS if name not in levels.NOT_COMPARED],
        metavar="NAME",
        help="experiments (default: all that are compared)",
    )
    both.add_argument(
        "--out",
        type=argument.output_folder,
        default=_OUT,
        metavar="FOLDER",
        help="folder for levels.json and levels.md (default: %(default)s)",
    )
    both.set_defaults(run=_run_levels)


def _first_sentence(text: str) -> str:
    """First sentence of a text, without the full stop."""
    return re.split(r"(?<=[a-z)])\.(?=\s|$)", " ".join(text.split()), maxsplit=1)[0]


def run_experiments(
    names: Sequence[str],
    plant: PlantConfig,
    seed: int,
    folder: Path | None = None,
    quiet: bool = False,
    level: Level | None = None,
    options: argparse.Namespace | None = None,
) -> list[Outcome]:
    """Run experiments, print their tables and write the files of each when it is finished.

    Parameters
    ----------
    names : sequence of str
        Names in `EXPERIMENTS`.
    plant : PlantConfig
        Plant data.
    seed : int
        Seed of all random numbers.
    folder : Path or None
        Folder for tables, pictures and ``summary.json``.
    quiet : bool
        Do not print tables.
    level : {"registers", "ideal"}, optional
        Level of the boards; by default the environment variable, or `FAST_LEVEL`.
    options : argparse.Namespace, optional
        Parsed options, if there is only one experiment.
    """
    outcomes: list[Outcome] = []
    with at_level(level):
        notes = _differences(plant, seed)
    for name in names:
        with at_level(level):
            attempt = _attempt(name, plant, seed, options)
            outcome = dataclasses.replace(attempt, notes=attempt.notes + notes, level=rig.level())
        outcomes.append(outcome)
        if not quiet:
            print(table(outcome), flush=True)
        if folder is not None:
            write_file(folder / f"{name}.txt", table(outcome))
            draw(outcome, folder / f"{name}.png")
            update_summary(folder, [outcome])
    return outcomes


def _differences(plant: PlantConfig, seed: int) -> tuple[str, ...]:
    """Notes about this plant for every table; empty if they cannot be determined, as the experiments report that."""
    try:
        return differences(plant, seed)
    except SimulationError:
        return ()


def _attempt(name: str, plant: PlantConfig, seed: int, options: argparse.Namespace | None) -> Outcome:
    """Run one experiment; an error is returned as a row that does not agree."""
    entry = EXPERIMENTS[name]
    run = entry.run if options is None or entry.with_options is None else entry.with_options(options)
    try:
        return run(plant, seed)
    except SimulationError as error:
        row = Row("can be run", "yes", None, "", Bound(1.0, 1.0))
        return Outcome(name, (row,), (), (str(error),))


def _run(args: argparse.Namespace) -> int:
    plant = PlantConfig.load(args.plant)
    options = args if len(args.names) == 1 else None
    outcomes = run_experiments(args.names, plant, args.seed, args.out, args.json, args.level, options)
    if args.plot is not None:
        draw(outcomes[0], args.plot)
    if args.json:
        print(json.dumps(summary(outcomes), indent=2, allow_nan=False, ensure_ascii=False))
    else:
        rows = [row for outcome in outcomes for row in outcome.rows]
        wrong = [f"{o.name}: {row.name}" for o in outcomes for row in o.rows if not row.agrees]
        print(f"{len(rows) - len(wrong)} of {len(rows)} figures agree with the reference design")
        print("".join(f"  does not agree: {name}\n" for name in wrong), end="")
    return 0 if all(outcome.agrees for outcome in outcomes) else 1


def _run_levels(args: argparse.Namespace) -> int:
    plant = PlantConfig.load(args.plant)
    pairs: list[levels.Pair] = []
    for name in args.only:
        ideal, registers = (
            run_experiments([name], plant, args.seed, quiet=True, level=level)[0] for level in levels.LEVELS
        )
        pairs.extend(levels.pairs(ideal, registers))
        if not args.json:
            print(levels.table(name, pairs), flush=True)
    path = levels.write(args.out, pairs)
    if args.json:
        print(path.read_text(encoding="utf-8"), end="")
    else:
        print(levels.overview(pairs))
        print(f"{sum(pair.agrees for pair in pairs)} of {len(pairs)} figures agree at both levels, and with each other")
        wrong = [f"{pair.experiment}: {pair.figure}" for pair in pairs if not pair.agrees]
        print("".join(f"  does not agree: {name}\n" for name in wrong), end="")
    return 0 if all(pair.agrees for pair in pairs) else 1
