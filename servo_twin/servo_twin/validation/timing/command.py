"""``servo-sim timing``: print and draw the timing of both motors on one chip."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.core_speed import CoreSpeed
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments.outcome import Bound, Outcome, Row
from servo_twin.validation.experiments.report import summary, table
from servo_twin.validation.timing import deadlines
from servo_twin.validation.timing.chip_map import VECTOR_M1
from servo_twin.validation.timing.figures import pwm_cycle, start
from servo_twin.validation.timing.picture import draw
from servo_twin.validation.timing.scenarios import SCENARIOS, STANDARD, Scenario
from servo_twin.validation.timing.trace import ChipTrace, Kind

HELP: Final = """\
Timing of both motors on one chip, simulated from the register values at level registers: carriers with a phase shift of
180 degrees, sampling times, sequence of the converter, the two interrupts (F33, F34, F35, F38), the start of the
sequence (4.3.3), and the time margin of each kind of handler before the load of its duties."""

START_TIME: Final = 3e-3  # from power-on [s]
ENTRIES: Final = 100  # entries of a trace per PWM period


@dataclass(frozen=True)
class Measured:
    """Recording of a scenario."""

    boot: ChipTrace  # from power-on until both loops run
    trace: ChipTrace
    first_m1: int  # time of the first M1 since reset [clocks]
    late_loops: int  # counter of the board at the end
    overruns: int  # counter of the board at the end


def record(
    scenario: Scenario,
    plant: PlantConfig,
    seed: int,
    core: CoreSpeed | None = None,
    modify: Callable[[Board], None] = lambda board: None,
) -> Measured:
    """Run a scenario on a new board and record a trace.

    Parameters
    ----------
    scenario : Scenario
    plant : PlantConfig
        Plant data.
    seed : int
        Seed of all random numbers.
    core : CoreSpeed, optional
        Execution time of the core; by default the packaged one.
    modify : callable
        Modification of the board before the trace, for tests.

    Raises
    ------
    SimulationError
        If the axes do not reach the state of the scenario.
    """
    with Board(plant, seed=seed, level="registers", core=core, baud=scenario.baud) as board:
        boot = ChipTrace(board.trace(round(START_TIME * 1e9)))
        scenario.prepare(board)
        modify(board)
        scenario.during(board)
        periods = round(scenario.seconds * 1e9 / PERIOD_NS)
        trace = ChipTrace(board.trace(board.time_ns + periods * PERIOD_NS, ENTRIES * periods))
        late, overruns = (int(board.read_words(name)[0]) for name in ("late_loops", "receiver_overruns"))
    starts = boot.clocks(Kind.ENTER, VECTOR_M1)
    return Measured(boot, trace, int(starts[0]) if starts.size else 0, late, overruns)


def measure(
    plant: PlantConfig,
    seed: int,
    modify: Callable[[Board], None] = lambda board: None,
    core: CoreSpeed | None = None,
) -> tuple[Outcome, ChipTrace, ChipTrace]:
    """Record the start, and the PWM cycle with both shafts rotating; parameters: see `record`.

    Returns
    -------
    Outcome
        Figures with bounds.
    ChipTrace, ChipTrace
        Traces of the PWM cycle and of the start.
    """
    turning = record(STANDARD, plant, seed, core, modify)
    trace, first = turning.trace, turning.first_m1
    rows = (*pwm_cycle(trace), *deadlines.rows(trace, first), *counters(turning), *start(turning.boot))
    notes = (
        f"{STANDARD.seconds:g} s with both shafts at 100 rad/s; largest times of the handlers from the sample [us]:",
        *deadlines.lines(deadlines.handlers(trace, first)),
    )
    return Outcome("timing", rows, (), notes), trace, turning.boot


def everything(
    plant: PlantConfig, seed: int, core: CoreSpeed | None = None, report: Callable[[str], None] = lambda text: None
) -> Outcome:
    """Run all scenarios: modes, features, feedback, search, start-up, stops and faults.

    Parameters
    ----------
    plant, seed, core
        See `record`.
    report : callable
        Called with a line of text before each scenario.
    """
    rows: list[Row] = []
    notes: list[str] = []
    for scenario in SCENARIOS:
        report(scenario.name)
        try:
            measured = record(scenario, plant, seed, core)
        except SimulationError as error:
            rows.append(Row(f"{scenario.name}: gets there", "", None, "", Bound(1.0, 1.0)))
            notes += [f"{scenario.name}: {error}"]
            continue
        rows += deadlines.rows(measured.trace, measured.first_m1, scenario.name)
        rows += counters(measured, scenario.name)
        notes += [f"{scenario.name}:", *deadlines.lines(deadlines.handlers(measured.trace, measured.first_m1))]
    return Outcome("timing", tuple(rows), (), tuple(notes))


def counters(measured: Measured, what: str = "") -> list[Row]:
    """Rows for the counters of the board."""
    prefix = f"{what}: " if what else ""
    none = Bound(0.0, 0.0)
    return [
        Row(f"{prefix}late loops", "never", float(measured.late_loops), "", none),
        Row(f"{prefix}receiver overruns", "never", float(measured.overruns), "", none),
    ]


def add_parser(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add ``timing`` to the commands of ``servo-sim``.

    Parameters
    ----------
    verbs : argparse subparsers
        Subparsers of ``servo-sim``.
    common : ArgumentParser
        Parent with ``--seed``, ``--plant`` and ``--json``.
    """
    parser = verbs.add_parser(
        "timing",
        parents=[common],
        help="timing of both motors on one chip",
        description=HELP,
        formatter_class=ParagraphFormatter,
    )
    parser.add_argument(
        "--plot",
        type=argument.picture,
        metavar="FILE",
        help="file for a picture of F34 with the deadlines, F35, F38 and the start",
    )
    parser.add_argument(
        "--all", action="store_true", help="measure the handlers in all modes, features, feedbacks, stops and faults"
    )
    parser.add_argument(
        "--cycles-per-instruction",
        type=argument.positive,
        metavar="N",
        help="clock cycles per instruction (default: core.toml)",
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    core = CoreSpeed.load()
    if args.cycles_per_instruction is not None:
        core = replace(core, cycles_per_instruction=args.cycles_per_instruction)
    if args.all and args.plot is not None:
        raise SimulationError("--plot and --all cannot be combined")
    plant = PlantConfig.load(args.plant)
    if args.all:
        outcome = everything(plant, args.seed, core, lambda text: print(f"{text} ..", file=sys.stderr))
    else:
        outcome, turning, boot = measure(plant, args.seed, core=core)
        if args.plot is not None:
            draw(turning, boot, args.plot)
    if args.json:
        print(json.dumps(summary([outcome]), indent=2, allow_nan=False, ensure_ascii=False))
    else:
        print(table(outcome))
    return 0 if outcome.agrees else 1
