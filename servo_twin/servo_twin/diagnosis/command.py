"""``servo-sim diagnose`` and ``calibrate``: detection of plant changes, measured with many virtual pairs."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from servo_msgs_py.output_file import write_file
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.table_text import aligned

from servo_msgs_py import argument
from servo_twin.diagnosis.calibration import DURATION
from servo_twin.diagnosis.monitor import PLANT_VALUES
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.diagnosis.trials import NOTHING, Answer, Change, HealthyRuns, Trials, confusion
from servo_twin.level import FAST_LEVEL, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.runner import Runner, run_in_order

_DEFAULT: Final = tuple(
    Change(name, size) for name in PLANT_VALUES for size in ((1e-3, -1e-3) if name == "load" else (1.15, 0.85))
)
"""15 %; a load of 1 mN m is 1 % of the rated torque."""
_LOSS: Final = Quantity(minimum=0.0, maximum=0.9)


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add the commands to ``servo-sim``.

    Parameters
    ----------
    verbs : argparse subparsers
    common, levelled : ArgumentParser
        Parents with ``--seed``, ``--plant`` and ``--json``, and with ``--level``.
    """
    parser = verbs.add_parser(
        "diagnose",
        parents=[common, levelled],
        help="measure the detection of plant changes by the twin with many virtual pairs",
    )
    parser.add_argument(
        "--trials", type=argument.count, default=60, metavar="N", help="number of trials (default: %(default)s)"
    )
    parser.add_argument(
        "--change",
        action="append",
        metavar="NAME=FACTOR",
        help=f"one of {', '.join(PLANT_VALUES)}; load=TORQUE in N m; may be repeated; nothing: false alarms only"
        " (default: each by +15 %% and -15 %%, the load by 1 mN m)",
    )
    parser.add_argument(
        "--time",
        type=argument.positive,
        default=10.0,
        metavar="S",
        help="time after the change, or of a trial without one (default: 10)",
    )
    parser.add_argument(
        "--loss",
        type=partial(argument.finite, valid=_LOSS),
        default=0.0,
        metavar="PART",
        help="fraction of lost samples, 0 .. 0.9",
    )
    parser.add_argument(
        "--thresholds", type=Path, metavar="FILE", help="file of `servo_twin calibrate` (default: packaged)"
    )
    Runner.add_options(parser)
    parser.set_defaults(run=_run)
    calibrator = verbs.add_parser(
        "calibrate",
        parents=[common, levelled],
        help="calibrate the thresholds of the diagnosis with virtual pairs",
    )
    calibrator.add_argument(
        "--runs", type=argument.count, default=10, metavar="N", help="number of runs (default: %(default)s)"
    )
    calibrator.add_argument(
        "--time",
        type=partial(argument.finite, valid=DURATION),
        default=120.0,
        metavar="S",
        help="duration of each run (default: %(default)s)",
    )
    calibrator.add_argument(
        "--out", type=argument.output_file, default="thresholds.toml", metavar="FILE", help="default: %(default)s"
    )
    Runner.add_options(calibrator)
    calibrator.set_defaults(run=_calibrate)


def _changes(texts: Sequence[str] | None) -> tuple[Change, ...]:
    if texts is None:
        return _DEFAULT
    return () if list(texts) == [NOTHING] else tuple(Change.parse(text) for text in texts)


def _run(args: argparse.Namespace) -> int:
    level = chosen_level(args.level, default=FAST_LEVEL)
    trials = Trials(
        PlantConfig.load(args.plant),
        Thresholds.load(args.thresholds, level),
        _changes(args.change),
        args.seed,
        args.time,
        args.loss,
        level,
    )
    answers = run_in_order(Runner.of(args), trials, range(args.trials), "diagnose")
    if args.json:
        print(json.dumps([dataclasses.asdict(answer) for answer in answers], indent=2))
    else:
        print(summary(answers))
    right = all(answer.said == answer.truth and not answer.false_alarms for answer in answers)
    return 0 if right else 1


def _calibrate(args: argparse.Namespace) -> int:
    level = chosen_level(args.level, default=FAST_LEVEL)
    runs = HealthyRuns(PlantConfig.load(args.plant), args.seed, args.time, level)
    first, *others = run_in_order(Runner.of(args), runs, range(args.runs), "calibrate")
    for other in others:
        first.merge(other)
    calibrated = first.thresholds()
    write_file(args.out, calibrated.text())
    print(
        f"{args.out}: detection threshold of the log likelihood ratio {calibrated.detect:.1f}, "
        f"one false alarm in {calibrated.false_alarm_hours:g} h of motion, extrapolated from "
        f"{calibrated.run_hours:.2f} h"
    )
    return 0


def summary(answers: Sequence[Answer]) -> str:
    """Confusion table with delays and coverage, and the false alarms."""
    rows = [["changed", "trials", "right", "delay [s]: median, 95 %, max", "interval right", "other"]]
    for name, said in confusion(answers).items():
        mine = [answer for answer in answers if answer.truth.change == name and not answer.problem]
        right = [answer for answer in mine if answer.said == answer.truth]
        delays = [answer.delay for answer in right if answer.delay is not None]
        times = "{:.2f} {:.2f} {:.2f}".format(*np.percentile(delays, (50, 95, 100))) if delays else ""
        held = f"{sum(answer.covered for answer in right)}/{len(right)}" if delays else ""
        other = ", ".join(f"{text} {count}" for text, count in said.items() if text != name)
        rows.append([name, str(sum(said.values())), str(len(right)), times, held, other])
    lines = aligned(rows, "<>>>><")
    hours = sum(answer.seconds for answer in answers) / 3600.0
    alarms = [f"trial {a.number}: {text}" for a in answers for text in a.false_alarms]
    lines.append(f"false alarms: {len(alarms)} in {hours:.2f} simulated hours without a change")
    lines += [f"  {alarm}" for alarm in alarms]
    lines += [f"  trial {a.number} was not run: {a.problem}" for a in answers if a.problem]
    return "\n".join(lines)
