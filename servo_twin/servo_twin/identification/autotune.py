"""``servo-sim autotune``: tune an axis of a virtual board for its load; random loads."""

from __future__ import annotations

import argparse
import dataclasses
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

from servo_measurement.access import FAULT, OSCILLATION, MeasurementError
from servo_measurement.autotune import Autotuned, AutotuneRequest
from servo_measurement.autotune import autotune as tune
from servo_measurement.autotune_command import ABOUT, add_options, configuration, finish, request_of
from servo_measurement.position_move import move_and_back
from servo_measurement.resonance import CHANGE
from servo_measurement.running_axis import RunningAxis
from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.runtime.program import complain
from servo_tuning.errors import ConfigError, Table

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.identification.session import BOOT
from servo_twin.level import FAST_LEVEL, Level, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.runner import Runner, run_to_file
from servo_twin.servo_config import ServoConfig
from servo_twin.simulation import SimulationError
from servo_twin.sprung_load import SprungLoad

TIME_MAX: Final = 90.0
"""Aim of the board time per axis [s]."""

FREQUENCY: Final = (60.0, 400.0)  # resonance of a random load [Hz]
RATIO: Final = (0.5, 8.0)  # inertia of a random load over that of the rotor
DAMPING: Final = (0.01, 0.05)  # of its resonance

CONFIRMED: Final = "confirmed"
"""Outcome of a trial."""

_TRIALS: Final = """\
With --trials: random loads behind a spring, of 60 to 400 Hz, 0.5 to 8 times the rotor, with 1 to 5 % damping; then each
confirmed axis moves with a resonance changed by 20 %. Output file: trials.json."""


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``autotune`` to the commands of ``servo-sim``; parameters as of `sweep.command.add_parser`."""
    parser = verbs.add_parser(
        "autotune",
        parents=[common, levelled],
        help="choose and confirm the bandwidths of an axis for its load",
        description=f"{ABOUT}\n\n{_TRIALS}",
        formatter_class=ParagraphFormatter,
    )
    parser.add_argument("--axis", type=int, choices=range(1, AXES + 1), default=1, help="default: %(default)s")
    add_options(parser)
    parser.add_argument("--trials", type=argument.count, metavar="N", help="tune N random loads of --seed")
    Runner.add_options(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    plant, axis = PlantConfig.load(args.plant), args.axis - 1
    try:
        base = configuration(args)
    except ValueError as error:
        raise SimulationError(str(error)) from None
    level, request = chosen_level(args.level, default=FAST_LEVEL), request_of(args, axis)
    if args.trials is not None:
        return _trials(args, Trials(plant, base, request, level, args.seed))
    with Board(plant, seed=args.seed, level=level, servo=ServoConfig.of_table(base)) as board:
        board.run(BOOT)
        access = VirtualBoardAccess(board)
        return finish("servo-sim", args, lambda keep: tune(access, request, base, report=complain, keep=keep))


# ---- random loads ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trial:
    """Result for one load."""

    load: SprungLoad
    inertia: float  # of the whole shaft, over that of the plant file
    outcome: str  # CONFIRMED, or the reason
    unstable: str  # what was found on the way, or when the resonance changed afterwards; empty: nothing
    seconds: float  # board time [s]
    bandwidth: float  # chosen, of the speed loop [Hz]; 0: none
    phase: float  # measured, minus the predicted one [degrees]

    @property
    def part(self) -> float:
        """Bandwidth over the frequency of the antiresonance."""
        return self.bandwidth * math.sqrt(1.0 + self.load.ratio) / self.load.frequency

    @property
    def confirmed(self) -> bool:
        return self.outcome == CONFIRMED


@dataclass(frozen=True)
class Trials:
    """Numbered random loads; can be pickled."""

    plant: PlantConfig  # all values except those of the load
    base: Table  # parsed ``servo.toml``
    request: AutotuneRequest
    level: Level
    seed: int

    def load(self, number: int) -> tuple[SprungLoad, float]:
        """A load, and the inertia of the whole shaft over that of the plant file."""
        draw = random.Random(f"{self.seed}:{number}")

        def between(low: float, high: float) -> float:
            return math.exp(draw.uniform(math.log(low), math.log(high)))

        load = SprungLoad(between(*FREQUENCY), between(*RATIO), between(*DAMPING))
        return load, between(1.0, 1.0 + load.ratio)

    def run(self, number: int) -> Trial:
        """Tune a load, and move it with a resonance that has changed."""
        axis, (load, inertia) = self.request.axis, self.load(number)
        rigid = self.plant.axes[axis]
        rigid = dataclasses.replace(rigid, inertia=inertia * rigid.inertia)
        plant = self.plant.with_axis(axis, **dataclasses.asdict(load.of(rigid)))
        with Board(plant, seed=self.seed, level=self.level, servo=ServoConfig.of_table(self.base)) as board:
            board.run(BOOT)
            access = VirtualBoardAccess(board)
            try:
                found = tune(access, self.request, self.base)
            except (ConfigError, MeasurementError, ValueError) as error:
                return Trial(load, inertia, str(error), _unstable(error), board.clock(), 0.0, 0.0)
            seconds = board.clock()
            unstable = "" if found.problems else self._changed(board, access, found)
        predicted = found.shaft.within(found.after.shaft()).speed_margins().phase or 0.0
        phase = abs(found.measured.phase or 0.0) - abs(predicted)
        outcome = "; ".join(map(str, found.problems)) or CONFIRMED
        return Trial(load, inertia, outcome, unstable, seconds, found.after.axis("control.speed_bandwidth"), phase)

    def _changed(self, board: Board, access: VirtualBoardAccess, found: Autotuned) -> str:
        """Move with other resonances; returns the oscillation or fault that was found."""
        axis = found.request.axis
        stiffness = board.plant.axes[axis].shaft_stiffness
        rig = RunningAxis(access, axis)
        for factor in (CHANGE, 1.0 / CHANGE):
            board.set_plant(f"{axis_name(axis)}.shaft_stiffness", stiffness * factor**2)
            try:
                rig.wait_for_rest()
                move_and_back(rig, found.moves[0].distance, found.after.axis("control.position_gain"))
            except MeasurementError as error:
                return f"resonance times {factor:.3g}: {error}"
        return ""


def _unstable(error: Exception) -> str:
    """The text of an error because of an oscillation or a fault; empty: it has another reason."""
    about = error.about if isinstance(error, MeasurementError) else ""
    return str(error) if about in (OSCILLATION, FAULT) else ""


def _trials(args: argparse.Namespace, work: Trials) -> int:
    def entry_of(number: int, trial: Trial) -> dict[str, object]:
        return {"number": number, **dataclasses.asdict(trial), "part": trial.part}

    file = args.out / "trials.json"
    found, text = run_to_file(Runner.of(args), work, args.trials, "autotune, loads", file, entry_of)
    print(text if args.json else "\n".join(summary(found)))
    return 1 if any(trial.unstable for _, trial in found) else 0


def summary(trials: Sequence[tuple[int, Trial]]) -> list[str]:
    """Summary as lines of text."""
    done = [trial for _, trial in trials if trial.confirmed]
    lines = [f"{len(trials)} loads: {len(done)} confirmed, {len(trials) - len(done)} not, with a reason"]
    if done:
        parts, phases = ([getattr(trial, name) for trial in done] for name in ("part", "phase"))
        lines.append(f"bandwidth over antiresonance: median {median(parts):.2g}, {min(parts):.2g} .. {max(parts):.2g}")
        lines.append(f"measured minus predicted phase margin: {min(phases):+.1f} .. {max(phases):+.1f} degrees")
    seconds = [trial.seconds for _, trial in trials]
    lines.append(f"board time: median {median(seconds):.1f} s, maximum {max(seconds):.1f} s (aim {TIME_MAX:g} s)")
    unstable = [(number, trial.unstable) for number, trial in trials if trial.unstable]
    lines.append(f"oscillations and faults on the way, or with a resonance changed by {CHANGE:g}: {len(unstable)}")
    lines += [f"  load {number}: {reason}" for number, reason in unstable]
    for number, trial in trials:
        if not trial.confirmed:
            load = trial.load
            head = f"load {number}, {load.frequency:.0f} Hz, ratio {load.ratio:.2g}, damping {load.damping:.2g}"
            lines.append(f"{head}: {trial.outcome}")
    return lines
