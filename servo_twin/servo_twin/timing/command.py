"""``servo-sim timing``: print and draw the timing of both motors on one chip."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.catalogue import AXES
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board
from servo_twin.core_load import CoreLoad
from servo_twin.experiments.outcome import Outcome
from servo_twin.experiments.report import summary, table
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable
from servo_twin.timing.figures import circle, margins, start
from servo_twin.timing.picture import draw
from servo_twin.timing.trace import Trace

__all__ = ["add_parser", "measure"]

HELP: Final = """\
Timing of both motors on one chip, as it emerges from the register values on the register-level board: the carriers
180 degrees apart, the instants of the samples, the converter's sequence, the two interrupts (F33, F34, F35, F38),
and the start of the sequence (4.3.3)."""

PERIODS: Final = 400  # of the circle: 50 slow loops
START_TIME: Final = 3e-3  # from power-on [s]
SPEED: Final = 100.0  # of both shafts [rad/s]
SETTLE: Final = 0.3  # [s]


def measure(
    plant: PlantConfig, seed: int, spoil: Callable[[Board], None] = lambda board: None
) -> tuple[Outcome, Trace, Trace]:
    """Record the start, and the circle with both shafts turning.

    Parameters
    ----------
    plant : PlantConfig
        What is really there.
    seed : int
        Of every random number.
    spoil : callable
        Done to the board before the circle is recorded.

    Returns
    -------
    Outcome
        Judged figures.
    Trace, Trace
        The circle, and the start.
    """
    with Board(plant, seed=seed, level="registers") as board:
        boot = Trace(board.trace(round(START_TIME * 1e9)))
        enable(board)
        board.write("cmd.mode", [1] * AXES)
        board.write("cmd.speed", [SPEED] * AXES)
        board.run(SETTLE)
        spoil(board)
        turning = Trace(board.trace(board.time_ns + PERIODS * PERIOD_NS))
    rows = (*circle(turning), *start(boot))
    notes = (
        f"circle: {PERIODS} PWM periods, both shafts at {SPEED:g} rad/s",
        *margins(turning, CoreLoad.load(), CoreLoad.longest()),
    )
    return Outcome("timing", rows, (), notes), turning, boot


def add_parser(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add ``timing`` to the commands of ``servo-sim``.

    Parameters
    ----------
    verbs : argparse subparsers
        Where to add it.
    common : ArgumentParser
        Parent with ``--seed``, ``--plant`` and ``--json``.
    """
    parser = verbs.add_parser(
        "timing",
        parents=[common],
        help="timing of both motors on one chip",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw F34, F35, F38 and the start to this file")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    outcome, turning, boot = measure(PlantConfig.load(args.plant), args.seed)
    if args.plot is not None:
        draw(turning, boot, args.plot)
    if args.json:
        print(json.dumps(summary([outcome]), indent=2, allow_nan=False, ensure_ascii=False))
    else:
        print(table(outcome))
    return 0 if outcome.agrees else 1
