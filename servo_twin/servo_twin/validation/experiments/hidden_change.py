"""Hidden changes of recorded runs, found by `servo_twin.runs.replay`: first divergent tick and cause."""

from __future__ import annotations

import argparse
import functools
import random
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.table_text import aligned

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.diagnosis.board_pair import COLUMNS, Motion
from servo_twin.diagnosis.change_detector import Kind
from servo_twin.diagnosis.monitor import PLANT_VALUES, SUPPLY
from servo_twin.level import FAST_LEVEL
from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.samples import PER_BOARD
from servo_twin.lockstep.twin import Pair
from servo_twin.plant import PlantConfig
from servo_twin.runner import HERE, Runner, run_in_order
from servo_twin.runs.recorded import RecordedRun
from servo_twin.runs.replay import Replay, Replayed, WhatIf, model_of
from servo_twin.runs.replay_report import verdict
from servo_twin.servo_config import ServoConfig, servo_table
from servo_twin.validation.experiments.outcome import BEYOND, Bound, Outcome, Row
from servo_twin.validation.simulated_run import SimulatedRun

NAME: Final = "hidden-change"
HELP: Final = """\
Beyond the reference design. Random motion of a virtual board is recorded in simulated time, with one percent of its
samples lost. At a random time a value of the plant changes that the recording does not mention, or one gain of the
controller differs from the recorded configuration from the reset on; some runs have no change. The replay must name the
first divergent sample and the cause. An equal board that gets the same commands outside the twin is the reference."""

COUNT: Final = 8
"""Default number of runs."""

SECONDS: Final = 20.0
"""Default duration of a run [s]."""

LOSS: Final = 0.01
"""Fraction of lost samples."""

SHARE_MIN: Final = 0.95
"""Smallest share of right answers."""

_GAINS: Final = ("speed.kp", "speed.ki", "position_gain", "current_loop.q.kp", "current_loop.q.ki")
_CAUSES: Final = (*PLANT_VALUES, "gain", "nothing")


@dataclass(frozen=True)
class Change:
    """A hidden change."""

    cause: str  # key of `PLANT_VALUES`, ``gain`` or ``nothing``
    axis: int  # index; of no meaning for the supply
    size: float  # factor; additional torque of a load [N m]
    member: str = ""  # of the configuration, for a gain

    def __str__(self) -> str:
        place = "" if self.cause in (SUPPLY, "nothing") else f"{axis_name(self.axis)} "
        return f"{place}{self.member or self.cause} x {self.size:.3g}"


@dataclass(frozen=True)
class Result:
    """Answer of the replay to one run."""

    number: int
    change: Change
    first: int | None  # first recorded sample that differs from that of an equal board [tick]; None: none
    said: int | None  # first divergent tick of the replay
    cause: bool  # the cause is right
    verdict: str
    factor: float  # duration of the run over that of its replay

    @property
    def tick(self) -> bool:
        """Whether the first divergent tick is right."""
        return self.said == self.first

    def __str__(self) -> str:
        return f"run {self.number}, {self.change}: {self.verdict}"


def draw(seed: int, number: int) -> Change:
    """The change of a run; the kinds take turns."""
    random_ = random.Random(f"hidden change {seed} {number}")
    cause = _CAUSES[number % len(_CAUSES)]
    axis = random_.randrange(AXES)
    if cause == "nothing":
        return Change(cause, axis, 1.0)
    if cause == "load":
        return Change(cause, axis, random_.choice((-1.0, 1.0)) * random_.uniform(1e-3, 4e-3))
    size = random_.choice((random_.uniform(0.7, 0.88), random_.uniform(1.12, 1.6)))
    if cause == SUPPLY:
        size = random_.uniform(0.9, 1.1)
        size += 0.03 if size > 1.0 else -0.03
    return Change(cause, axis, size, random_.choice(_GAINS) if cause == "gain" else "")


class _Shadowed(SimulatedRun):
    """A recorded run, and an equal board without the change that gets the same writes at the same ticks."""

    def __init__(self, path: Path, board: Board, equal: Board, *, seed: int) -> None:
        self._equal = Replica(equal)
        self.first: int | None = None  # first recorded sample that differs [tick]
        super().__init__(path, board, seed=seed, loss=LOSS)

    def write(self, variable: str, values: Sequence[float], mask: int = (1 << AXES) - 1) -> None:
        super().write(variable, values, mask)
        _, raw, _ = self._written[-1]
        self._equal.run_to(self.real.tick)  # also after a lost sample
        self._equal.write(variable, raw, mask)

    def on_sample(self, row: Sequence[float]) -> list[Pair]:
        pairs = super().on_sample(row)
        self._equal.run_to(self.real.tick)
        if self.first is None and any(
            self.real.raw[name] != self._equal.raw[name]
            for name in COLUMNS
            if name in self.real.raw and name not in PER_BOARD
        ):
            self.first = self.real.tick
        return pairs

    def close(self) -> None:
        self._equal.close()
        super().close()


def run_trial(plant: PlantConfig, seed: int, number: int, seconds: float) -> Result:
    """Record a run and replay it."""
    change = draw(seed, number)
    own = 1000 * seed + number
    when = random.Random(f"time {seed} {number}").uniform(0.2, 0.6) * seconds
    servo = _changed_configuration(change) if change.cause == "gain" else None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        board = Board(plant, seed=own, level=FAST_LEVEL, servo=servo)
        with _Shadowed(path, board, Board(plant, seed=own, level=FAST_LEVEL), seed=own) as run:
            run.enable()
            motion = Motion(run, own)
            list(motion.run(when))
            if change.cause in PLANT_VALUES:
                _change_plant(board, change)
            list(motion.run(seconds - when))
        begin = time.process_time()
        recorded = RecordedRun(path)
        replayed = Replay(recorded, model_of(recorded.contents, WhatIf())).run()
        factor = seconds / (time.process_time() - begin)
    return Result(number, change, run.first, replayed.first, _right(replayed, change), verdict(replayed), factor)


def _changed_configuration(change: Change) -> ServoConfig:
    config = ServoConfig.of_table(servo_table())
    place = list(AxisConfigTable.load().members).index(change.member)
    blocks = [list(block) for block in config.blocks]
    blocks[change.axis][place] = round(blocks[change.axis][place] * change.size)
    return replace(config, blocks=tuple(map(tuple, blocks)))


def _change_plant(board: Board, change: Change) -> None:
    entry = PLANT_VALUES[change.cause]
    name = entry if change.cause == SUPPLY else f"{axis_name(change.axis)}.{entry}"
    part = board.plant.bus if change.cause == SUPPLY else board.plant.axes[change.axis]
    old = float(getattr(part, entry.rpartition(".")[2]))
    board.set_plant(name, old + change.size if change.cause == "load" else old * change.size)


def _right(replayed: Replayed, change: Change) -> bool:
    if change.cause == "nothing":
        return replayed.first is None
    if change.cause == "gain":
        return replayed.controller == axis_name(change.axis)
    axis = None if change.cause == SUPPLY else change.axis
    found = [(one.axis, one.finding.kind, one.finding.changes) for one in replayed.findings]
    return found == [(axis, Kind.SINGLE, (change.cause,))]


@dataclass(frozen=True)
class _Campaign:
    plant: PlantConfig
    seed: int
    seconds: float

    def run(self, number: int) -> Result:
        return run_trial(self.plant, self.seed, number, self.seconds)


def run(plant: PlantConfig, seed: int, count: int = COUNT, seconds: float = SECONDS, runner: Runner = HERE) -> Outcome:
    """Run the campaign."""
    return judge(run_in_order(runner, _Campaign(plant, seed, seconds), range(count), NAME, str))


def judge(results: Sequence[Result]) -> Outcome:
    """Shares of right answers, and a table by cause."""
    changed = [one for one in results if one.change.cause != "nothing"]
    equal = [one for one in results if one.change.cause == "nothing"]
    rows = [
        Row(
            f"first divergent tick right, of {len(changed)} changes",
            BEYOND,
            sum(one.tick for one in changed) / max(len(changed), 1),
            "of all",
            Bound(SHARE_MIN, 1.0),
        ),
        Row(
            f"cause right, of {len(changed)} changes",
            BEYOND,
            sum(one.cause for one in changed) / max(len(changed), 1),
            "of all",
            Bound(SHARE_MIN, 1.0),
        ),
        Row(
            f"divergences of {len(equal)} equal pairs", BEYOND, sum(not one.cause for one in equal), "", Bound(0.0, 0.0)
        ),
    ]
    table = [["cause", "runs", "tick right", "cause right"]]
    for cause in _CAUSES:
        own = [one for one in results if one.change.cause == cause]
        if own:
            table.append([cause, str(len(own)), str(sum(one.tick for one in own)), str(sum(one.cause for one in own))])
    wrong = [str(one) for one in results if not (one.tick and one.cause)]
    factors = sorted(one.factor for one in results)
    speed = f"replay {factors[len(factors) // 2]:.0f} times real time (median, {factors[0]:.0f} at least)"
    return Outcome(NAME, tuple(rows), (), (*aligned(table, "<>"), speed, *wrong))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this experiment."""
    parser.add_argument(
        "--count", type=argument.count, metavar="N", default=COUNT, help="number of runs (default: %(default)s)"
    )
    parser.add_argument(
        "--time", type=argument.positive, metavar="S", default=SECONDS, help="duration of a run (default: %(default)s)"
    )
    Runner.add_options(parser)


def with_options(args: argparse.Namespace) -> Callable[[PlantConfig, int], Outcome]:
    """The experiment with the parsed options."""
    return functools.partial(run, count=args.count, seconds=args.time, runner=Runner.of(args))
