"""``servo-twin``: replay, compare and export recorded runs, without ROS and in less than their time."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from servo_msgs_py.runtime.program import program

from servo_twin.board import SimulationError
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.level import FAST_LEVEL, add_level_option, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.runs import replay_report
from servo_twin.runs.recorded import RecordedRun
from servo_twin.runs.replay import Replay, WhatIf, model_of
from servo_twin.servo_config import ServoConfig, servo_table

DIVERGENCE, BAD_INPUT = 1, 2


def parser() -> argparse.ArgumentParser:
    """Command line of ``servo-twin``."""
    result = argparse.ArgumentParser(prog="servo-twin", description="Recorded runs: would the drive do it again?")
    verbs = result.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    replayer = verbs.add_parser(
        "replay",
        help="repeat a recorded run on the twin and name the first divergence",
        description="Repeats a recorded run on the twin, at the same ticks, and names the first divergence. "
        "Exit status: 0 identical, 1 divergence, 2 wrong input.",
    )
    replayer.add_argument("run", type=Path, metavar="RUN", help=".mcap or .db3 file, or folder of a bag")
    replayer.add_argument("--namespace", default="", help="of the bridge in the recording (default: /servo)")
    replayer.add_argument("--plant", type=Path, metavar="FILE", help="what if: another plant, changes of plant.toml")
    replayer.add_argument("--config", type=Path, metavar="FILE", help="what if: another configuration, a servo.toml")
    replayer.add_argument("--seed", type=int, help="seed of the sensor noise (default: recorded, or 1)")
    add_level_option(replayer, "the twin is", FAST_LEVEL)
    replayer.add_argument(
        "--thresholds", type=Path, metavar="FILE", help="noise of a healthy pair, from `servo_twin calibrate`"
    )
    replayer.add_argument("--json", action="store_true", help="print the result as JSON")
    replayer.set_defaults(run_command=_replay)
    return result


def _replay(args: argparse.Namespace) -> int:
    level = chosen_level(args.level, default=FAST_LEVEL)
    what_if = WhatIf(
        PlantConfig.load(args.plant) if args.plant else None,
        ServoConfig.of_table(servo_table(args.config)) if args.config else None,
        level,
        args.seed,
    )
    run = RecordedRun(args.run, args.namespace)
    model = model_of(run.contents, what_if)
    replayed = Replay(run, model, Thresholds.load(args.thresholds, level)).run()
    if args.json:
        print(json.dumps(replay_report.document(replayed), indent=2))
    else:
        print(replay_report.text(replayed))
    if not replayed.stretches:
        return BAD_INPUT
    return DIVERGENCE if replayed.first is not None else 0


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
    except (SimulationError, ValueError) as error:
        print(f"servo-twin: {error}", file=sys.stderr)
        return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
