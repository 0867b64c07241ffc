"""``servo-sim tune-robust``: robust gains for a set of plants."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.table_text import aligned
from servo_msgs_py.text_file import toml_text
from servo_tuning.reading import SERVO_TOML
from tqdm import tqdm

from servo_msgs_py import argument
from servo_twin.level import FAST_LEVEL, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.runner import Runner
from servo_twin.servo_config import servo_table
from servo_twin.simulation import SimulationError
from servo_twin.validation.sweep.command import measuring_parser
from servo_twin.validation.sweep.robust import Candidates, Objective, Score, front, search
from servo_twin.validation.sweep.space import SYNTAX, Space, SpaceError, Varied
from servo_twin.validation.sweep.variant import Base

_HELP: Final = f"""\
Optimise values of servo.toml for the worst case of a set of plants.

  servo-sim tune-robust move \\
      --tune "servo.axis1.control.speed_bandwidth=20..120 log" \\
      --over "plant.axis1.inertia=*0.5..3 log" --minimize "axis1 settling time"

Each candidate runs the experiment on the nominal plant and on all others. Printed are the present gains, the Pareto
front of nominal and worst figure, and a test of its first candidate on other plants. The folder gets a picture, and
servo.toml with this candidate (`servo-tool tune` sends it).

{SYNTAX}"""

_OUT: Final = "out/tune-robust"
PLANTS: Final = 12
CANDIDATES: Final = 64


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``tune-robust`` to the commands of ``servo-sim``; parameters as of `experiments.command.add_parser`."""
    parser = measuring_parser(
        verbs, "tune-robust", [common, levelled], "optimise gains for a set of plants", _HELP, _OUT
    )
    parser.add_argument(
        "--tune", action="append", required=True, metavar="NAME=RANGE", help="value of servo.toml or parameter to tune"
    )
    parser.add_argument("--over", action="append", required=True, metavar="NAME=RANGE", help="variation of the plants")
    goal = parser.add_mutually_exclusive_group(required=True)
    goal.add_argument("--minimize", metavar="FIGURE", help="row of the experiment")
    goal.add_argument("--maximize", metavar="FIGURE", help="row of the experiment")
    parser.add_argument(
        "--plants",
        type=argument.count,
        default=PLANTS,
        metavar="N",
        help="number of plants in addition to the nominal one (default: %(default)s)",
    )
    parser.add_argument(
        "--candidates", type=argument.count, default=CANDIDATES, metavar="N", help="default: %(default)s"
    )
    parser.set_defaults(run=_run)


def _tuned(base: Base, texts: Sequence[str]) -> list[Varied]:
    found = [base.resolved(Varied.parse(text)) for text in texts]
    for one in found:
        if one.name.startswith("plant."):
            raise SpaceError(f"{one.name}: a plant value cannot be tuned; use --over")
        if one.kind == "normal":
            raise SpaceError(f"{one.name}: --tune requires a range or levels")
    return found


def _run(args: argparse.Namespace) -> int:
    base = Base(PlantConfig.load(args.plant), servo_table(args.config or SERVO_TOML))
    tuned = _tuned(base, args.tune)
    objective = Objective(args.minimize or args.maximize, "minimize" if args.minimize else "maximize")
    over = [base.resolved(Varied.parse(text)) for text in args.over]
    plants = Space.of(over, "latin", args.plants, args.seed)
    others = Space.of(over, "latin", args.plants, args.seed + 1)
    level, runner = chosen_level(args.level, default=FAST_LEVEL), Runner.of(args)

    def scores(candidates: Sequence[Any], over: Space = plants) -> list[Score]:
        work = Candidates(args.measure, base, over, level, tuple(candidates))
        return work.scores(objective, runner, "trials")

    _check_figure(Candidates(args.measure, base, plants, level, ({},)), objective)
    (present,) = scores([{}])
    found = list(
        tqdm(
            search(scores, tuned, objective, present, args.candidates, args.seed),
            desc="candidates",
            total=args.candidates,
            disable=None,
        )
    )
    best = front(found, objective, present)
    if not best:
        print(f"all of {len(found)} candidates have more violations than the present gains ({present.violations})")
        return 1
    args.out.mkdir(parents=True, exist_ok=True)
    servo = base.variant(best[0].candidate).servo or base.servo
    write_file(args.out / "servo.toml", toml_text(servo))
    _draw(args.out / "tune-robust.png", found, best, present, objective)
    print(f"{objective.direction} {objective.figure}")
    print("\n".join(_table(best, present)))
    again = scores([{}, best[0].candidate], others)
    worst = " and ".join(f"{score.worst:.4g}" for score in again)
    print(f"\nworst figure on {args.plants} other plants: {worst} with the present gains and with candidate 1")
    print(f"candidate 1: {args.out}/servo.toml; send it to a board with `servo-tool tune`")
    return 0 if objective.better(best[0].worst, present.worst) else 1


def _check_figure(work: Candidates, objective: Objective) -> None:
    """Raise if the experiment does not have the figure."""
    nominal = work.run(0)
    if nominal.problem:
        raise SimulationError(f"the experiment cannot be run on the nominal plant: {nominal.problem}")
    if objective.figure not in nominal.figures:
        raise SpaceError(f"the experiment has no figure {objective.figure!r}; figures: {', '.join(nominal.figures)}")


def _table(best: Sequence[Score], present: Score) -> list[str]:
    rows = [["", "nominal", "mean", "worst", "violations", ""]]
    for label, score in (("present", present), *((f"{k + 1}", score) for k, score in enumerate(best))):
        values = ", ".join(f"{name} = {value:.4g}" for name, value in score.candidate.items())
        figures = (f"{figure:.4g}" for figure in (score.nominal, score.mean, score.worst))
        rows.append([label, *figures, str(score.violations), values])
    return aligned(rows, ">>>>><")


def _draw(path: Path, found: Sequence[Score], best: Sequence[Score], present: Score, objective: Objective) -> None:
    drawing = new_figure(7.0, 5.0, 120)
    plot = drawing.subplots()
    permitted = [score for score in found if score.violations <= present.violations]
    refused = [score for score in found if score.violations > present.violations]
    for scores, style, label in (
        (refused, "x", "more violations than present gains"),
        (permitted, ".", "candidates"),
        (best, "o-", "front"),
        ([present], "D", "present gains"),
    ):
        plot.plot([s.nominal for s in scores], [s.worst for s in scores], style, label=label, markersize=5)
    plot.set_xlabel(f"{objective.figure}, nominal plant")
    plot.set_ylabel(f"{objective.figure}, worst plant")
    plot.grid(alpha=0.3)
    plot.legend()
    write_figure(drawing, path)
