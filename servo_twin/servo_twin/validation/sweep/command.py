"""``servo-sim sweep``: experiments with varied values of plant, configuration or parameters."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import hashlib
import json
import shlex
import time
from collections.abc import Sequence
from fnmatch import fnmatch
from itertools import islice
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.runtime.claim import claimed
from servo_msgs_py.runtime.program import Interrupted
from servo_tuning.reading import SERVO_TOML

from servo_msgs_py import argument
from servo_twin import board as board_module
from servo_twin.level import FAST_LEVEL, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.runner import Runner
from servo_twin.servo_config import servo_table
from servo_twin.validation.experiments.report import table
from servo_twin.validation.sweep.files import draw, write_csv, write_parquet
from servo_twin.validation.sweep.space import METHODS, SYNTAX, Space, SpaceError, Varied
from servo_twin.validation.sweep.store import RESULTS, Store
from servo_twin.validation.sweep.summary import Summary
from servo_twin.validation.sweep.trial import MEASURES, Sweep
from servo_twin.validation.sweep.variant import Base

_HELP: Final = f"""\
Run an experiment on many boards with varied values of the plant file (plant.axis1.inertia, plant.bus.u_source), of
servo.toml (servo.axis1.control.speed_bandwidth), or of the board parameters (param.i_q_limit[0]), and collect the
figures.

  servo-sim sweep move --vary "plant.axis1.inertia=*0.3..3 log" \\
      --vary "plant.bus.u_source=20..28" --count 1000

{SYNTAX}

Results are written to a folder: {RESULTS} during the run (one line per trial), sweep.csv and sweep.png at the end or
after Ctrl-C. The worst trials are printed with the command that repeats them. The same seed gives the same results,
independent of the number of workers."""

_OUT: Final = "out/sweep"
ROWS_MAX: Final = 16  # figures of a picture
DRAWN_MAX: Final = 4000  # trials of a picture


def measuring_parser(
    verbs: Any, name: str, parents: Sequence[argparse.ArgumentParser], short: str, description: str, out: str
) -> argparse.ArgumentParser:
    """Add a command that runs one experiment on many boards, with the options of its base and its workers.

    Parameters
    ----------
    verbs : argparse subparsers
        Subparsers of ``servo-sim``.
    name : str
        Name of the command.
    parents : sequence of ArgumentParser
        Parents with the common options.
    short, description : str
        Help in the list of commands, and of the command itself.
    out : Path
        Default folder of the results.
    """
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        parents=parents,
        help=short,
        description=description.replace("%", "%%"),
        formatter_class=ParagraphFormatter,
    )
    parser.add_argument("measure", choices=MEASURES, metavar="EXPERIMENT", help=f"one of {', '.join(MEASURES)}")
    parser.add_argument("--config", type=Path, metavar="FILE", help="present servo.toml (default: of the firmware)")
    parser.add_argument(
        "--out", type=argument.output_folder, default=out, metavar="FOLDER", help="default: %(default)s"
    )
    Runner.add_options(parser)
    return parser


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``sweep`` to the commands of ``servo-sim``; parameters as of `experiments.command.add_parser`."""
    parser = measuring_parser(
        verbs, "sweep", [common, levelled], "run an experiment on many boards with varied values", _HELP, _OUT
    )
    parser.add_argument(
        "--vary", action="append", required=True, metavar="NAME=VALUES", help="value to vary; syntax above"
    )
    parser.add_argument("--method", choices=METHODS, help="default: grid if all values are discrete, else latin")
    parser.add_argument("--count", type=argument.count, metavar="N", help="trials, for latin and random")
    parser.add_argument("--resume", action="store_true", help="continue with the results in the folder")
    parser.add_argument("--parquet", action="store_true", help="also write sweep.parquet (needs pyarrow)")
    parser.add_argument(
        "--draw",
        nargs="+",
        default=["*"],
        metavar="PATTERN",
        help=f"figures in the picture (default: the first {ROWS_MAX})",
    )
    parser.add_argument("--trial", type=int, metavar="K", help="run only this trial and print its table")
    parser.set_defaults(run=_run)


def sweep_of(args: argparse.Namespace) -> Sweep:
    """Sweep for the parsed options.

    Raises
    ------
    SpaceError, PlantError, SimulationError, OSError
        If a value cannot be varied, or a file cannot be used.
    """
    varied = [Varied.parse(text) for text in args.vary]
    needs_servo = args.config is not None or any(one.name.startswith("servo.") for one in varied)
    base = Base(PlantConfig.load(args.plant), servo_table(args.config or SERVO_TOML) if needs_servo else {})
    space = Space.of([base.resolved(one) for one in varied], args.method, args.count, args.seed)
    return Sweep(args.measure, base, space, chosen_level(args.level, default=FAST_LEVEL))


def _head(sweep: Sweep) -> dict[str, Any]:
    """Identification of the sweep, for the results file."""
    plant = json.dumps(dataclasses.asdict(sweep.base.plant), sort_keys=True)
    servo = json.dumps(sweep.base.servo, sort_keys=True)
    return {
        "experiment": sweep.measure,
        "level": sweep.level,
        "space": dataclasses.asdict(sweep.space),
        "plant": hashlib.sha256(plant.encode()).hexdigest(),
        "servo": hashlib.sha256(servo.encode()).hexdigest(),
        "boards": _boards_digest(),
    }


def _boards_digest() -> str:
    """Digest of the compiled firmware and models: results of different ones must not be mixed."""
    modules = sorted(Path(board_module.__file__).parent.glob("_*.so"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in modules)).hexdigest()


def _replay(args: argparse.Namespace, sweep: Sweep) -> str:
    """Command that repeats a trial, without the trial number."""
    words = ["servo-sim", "sweep", args.measure, *(word for text in args.vary for word in ("--vary", text))]
    words += ["--method", sweep.space.method, "--seed", str(args.seed), "--level", sweep.level]
    words += [] if sweep.space.method == "grid" else ["--count", str(sweep.space.count)]
    words += [
        word for name in ("plant", "config") if getattr(args, name) for word in (f"--{name}", str(getattr(args, name)))
    ]
    return shlex.join([*words, "--trial"])


def _run(args: argparse.Namespace) -> int:
    sweep = sweep_of(args)
    if args.trial is not None:
        return _show(sweep, args.trial)
    space = sweep.space
    status = 0
    with claimed(args.out / RESULTS), Store(args.out, _head(sweep), space.count, args.resume) as store:
        begin, before = time.monotonic(), len(store)
        try:
            with contextlib.closing(Runner.of(args).run(sweep, store.missing, "sweep, trials")) as results:
                for _, trial in results:
                    store.add(trial)
        except Interrupted as interruption:
            status = interruption.status
        finally:
            seconds = time.monotonic() - begin
            summary = Summary(store)
            _write(args, store, summary, space.varied)
        if args.json:
            print(json.dumps(_as_json(summary), indent=2))
            return status
        print("\n".join(summary.lines(_replay(args, sweep))))
        print(
            f"\n{len(store)} of {space.count} trials, {len(store) - before} of them new, in {seconds:.1f} s: {args.out}"
        )
        if status:
            print("interrupted: continue with the same command and --resume")
    return status


def _show(sweep: Sweep, number: int) -> int:
    if not 0 <= number < sweep.space.count:
        raise SpaceError(f"no trial {number}; trials: 0 .. {sweep.space.count - 1}")
    point = ", ".join(f"{name} = {value:g}" for name, value in sweep.space.point(number).items())
    print(f"trial {number}: {point}\n")
    outcome = sweep.outcome(number)
    print(table(outcome), end="")
    return 0 if outcome.agrees else 1


def _write(args: argparse.Namespace, store: Store, summary: Summary, varied: Sequence[Varied]) -> None:
    figures, names = list(summary.figures), [one.name for one in varied]
    write_csv(args.out / "sweep.csv", store, names, figures)
    if args.parquet:
        write_parquet(args.out / "sweep.parquet", store, names, figures)
    if selected := [name for name in figures if any(fnmatch(name, pattern) for pattern in args.draw)][:ROWS_MAX]:
        shown = islice(store, 0, None, max(len(store) // DRAWN_MAX, 1))
        draw(args.out / "sweep.png", shown, varied, selected, f"{args.measure}: {len(store)} trials")


def _as_json(summary: Summary) -> dict[str, Any]:
    figures = {
        name: {
            "unit": f.unit,
            "mean": f.mean if f.count > f.absent else None,
            "min": f.minimum if f.count > f.absent else None,
            "max": f.maximum if f.count > f.absent else None,
            "absent": f.absent,
            "outside": f.outside,
            "worst": f.worst_trials(),
        }
        for name, f in summary.figures.items()
    }
    return {"trials": summary.trials, "figures": figures, "problems": {k: v[0] for k, v in summary.problems.items()}}
