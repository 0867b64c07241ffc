"""Random motors: a data-sheet configuration is refused with remedies that work, or the drive enables and moves."""

from __future__ import annotations

import argparse
import collections
import copy
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from servo_msgs_py.catalogue import AXES, AXIS_NAMES, Catalogue
from servo_msgs_py.units import COUNTS_PER_TURN
from servo_tuning import remedies
from servo_tuning.assessment import assess
from servo_tuning.configuration import Configuration
from servo_tuning.errors import Problem, Remedy, Table
from servo_tuning.findings import findings
from servo_tuning.gains import Gains
from servo_tuning.reading import parse
from servo_tuning.remedies import Correction, refusal_of, with_value
from servo_tuning.rotor_search import RotorSearch
from servo_tuning.tuned import tuned

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.random_motor import RandomMotor, random_motor
from servo_twin.runner import HERE, Runner, run_in_order
from servo_twin.servo_config import ServoConfig, servo_table
from servo_twin.simulation import SimulationError, enable, move
from servo_twin.validation.experiments.outcome import BEYOND, Bound, Outcome, Row
from servo_twin.validation.experiments.rig import at_level, fresh_board, level

NAME: Final = "motor-campaign"
HELP: Final = """\
Beyond the reference design. Random motors, both axes with the same one: data of a data sheet are written to servo.toml,
everything else keeps its default. A refusal or a warning is corrected with the value of its remedy. Then a board with
this configuration and this motor enables and moves by 20 rad. Criteria: every refused configuration has a remedy that
is accepted, or contradicts a limit of the board; every accepted one drives: no fault, arrival, overshoot, duration."""

COUNT: Final = 120
"""Default number of motors."""

SPEED_USE: Final = 0.7  # limits.speed over the no-load speed
ACCELERATION_USE: Final = 0.6  # limits.acceleration over the one by the current of the drive

FIXED: Final = ("motor.", "friction.", "nominal_voltage", "observer.", "start_up.")
"""Entries that are properties of motor and supply, or not used with an encoder: they are not changed."""

MOVE: Final = 20.0  # [rad]
TOLERANCE: Final = 6  # permitted distance from the target after the arrival [counts]
OVERSHOOT_MAX: Final = 12  # [counts], 1.1 degrees
DURATION_MAX: Final = 1.25
"""Largest duration of the move, over the one of ramps and path filter; `SETTLING` is added."""
SETTLING: Final = 0.3  # [s]


def _with_brake() -> dict[str, Any]:
    """The ``servo.toml`` of a board with a brake resistor and thresholds for any of the voltages."""
    table = copy.deepcopy(dict(servo_table()))
    table["board"] |= {
        "over_voltage": 36.0,
        "brake": {**table["board"]["brake"], "fitted": True, "on_voltage": 34.0, "off_voltage": 33.5},
        "regeneration": {"start_voltage": 34.5, "full_voltage": 35.5},
    }
    return table


def data_sheet(motor: RandomMotor) -> dict[str, Any]:
    """A ``servo.toml`` with the data of the motor, as in the first two steps of ``firmware/config/README.md``."""
    table = _with_brake()
    board = table["board"]
    board |= {"nominal_voltage": motor.voltage, "under_voltage": 0.67 * motor.voltage}
    speed = SPEED_USE * motor.no_load_speed
    torque = 1.5 * motor.pole_pairs * motor.psi_m * motor.current
    own = {
        "feedback": "encoder",
        "motor": {
            **{key: getattr(motor, key) for key in ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia")},
            "rotor_inertia": motor.inertia,
            "rated_speed": speed,
            "rated_current": 0.5 * motor.current,
        },
        "friction": {"coulomb": motor.friction, "viscous": motor.viscous},
        "limits": {
            "current": motor.current,
            "speed": speed,
            "over_speed": 1.2 * speed,
            "acceleration": ACCELERATION_USE * torque / motor.inertia,
        },
        "rotor_search": {"current": motor.current},
    }
    return {**table, **{name: copy.deepcopy(own) for name in AXIS_NAMES}}


@dataclass(frozen=True)
class Result:
    """Result of a motor."""

    number: int
    motor: RandomMotor
    refusals: tuple[str, ...]  # refused entries, in the order of their correction
    refused: str  # final refusal; empty: accepted
    contradicts: bool  # whether the final refusal has no remedy but another motor or supply
    problem: str = ""  # why an accepted drive does not work; empty: it works
    search: float = math.nan  # duration of the rotor search of both axes [s]
    overshoot: float = math.nan  # larger one of both axes [counts]
    duration: float = math.nan  # of the move, over its planned duration; the larger one

    @property
    def failed(self) -> bool:
        return bool(self.problem) or bool(self.refused and not self.contradicts)

    def __str__(self) -> str:
        drives = f"drives, overshoot {self.overshoot:g} counts, {self.duration:.2f} of the planned duration"
        what = self.problem or (f"refused: {self.refused}" if self.refused else drives)
        return f"{self.number}: {self.motor}: {what}"


def corrected(table: Table) -> Correction:
    """Apply remedies of refusals and warnings until nothing is refused."""
    return remedies.corrected(table, _applicable, _problem, _for_both_axes)


def _for_both_axes(table: Table, entry: str, value: float) -> Table:
    owner, _, path = entry.partition(".")
    for name in AXIS_NAMES if owner in AXIS_NAMES else (owner,):
        table = with_value(table, f"{name}.{path}", value)
    return table


def _problem(table: Table) -> Problem | None:
    """First refusal, or the first warning of an axis that an entry can correct."""
    if refusal := refusal_of(table):
        return refusal
    configuration = parse(table, Catalogue.load())
    design = tuned(configuration.axes[0], configuration)
    return next((one for one in findings(design, assess(design)) if any(map(_applicable, one.remedies))), None)


def _applicable(remedy: Remedy) -> bool:
    return not remedy.entry.partition(".")[2].startswith(FIXED)


def run_trial(seed: int, number: int, plant: PlantConfig) -> Result:
    """Configure and drive one motor; `plant` has the other properties of the board."""
    motor = random_motor(seed, number)
    found = corrected(data_sheet(motor))
    table, refusals = found.table, tuple(one.entry for one in found.corrected)
    if refusal := refusal_of(table):
        refusal = remedies.tried(refusal, table, write=_for_both_axes)
        return Result(number, motor, refusals, str(refusal), not any(map(_applicable, refusal.remedies)))
    result = Result(number, motor, refusals, "", contradicts=False)
    try:
        return _driven(result, parse(table, Catalogue.load()), _with_motor(plant, motor), seed)
    except SimulationError as problem:
        return dataclasses.replace(result, problem=str(problem))


def _with_motor(plant: PlantConfig, motor: RandomMotor) -> PlantConfig:
    for axis in range(AXES):
        plant = motor.at(plant, axis)
    return plant.with_bus(r_brake=float(servo_table()["board"]["brake"]["resistance"]))


def _driven(result: Result, configuration: Configuration, plant: PlantConfig, seed: int) -> Result:
    axis = configuration.axes[0]
    search = RotorSearch.of(axis, configuration.board)
    with fresh_board(plant, seed + result.number, ServoConfig.of(configuration)) as board:
        searching = enable(board, search.time_max + 1.0)
        planned = _planned(configuration)
        moves = _moves(board, DURATION_MAX * planned + SETTLING + 1.0)
    result = dataclasses.replace(
        result,
        search=searching,
        overshoot=max(one.overshoot for one in moves),
        duration=max(math.inf if one.settling_time is None else one.settling_time / planned for one in moves),
    )
    problems = []
    if not math.isfinite(result.duration):
        problems.append(f"no arrival: {max(one.steady_state for one in moves)} counts off")
    elif result.duration * planned > DURATION_MAX * planned + SETTLING:
        problems.append(f"{result.duration * planned:.3g} s instead of {planned:.3g} s")
    if result.overshoot > OVERSHOOT_MAX:
        problems.append(f"overshoot of {result.overshoot:g} counts")
    return dataclasses.replace(result, problem="; ".join(problems))


def _planned(configuration: Configuration) -> float:
    """Duration of the move: at the speed limit, decay of the path filter (DRM E40) and of the position loop [s]."""
    axis = configuration.axes[0]
    rest = math.log(MOVE / (2.0 * math.pi) * COUNTS_PER_TURN / TOLERANCE)
    omega_n = Gains.of(axis, configuration.board).path_omega_n
    # (1 + x) exp(-x) of the filter, x = omega_n t, is exp(-rest) at about 1.3 rest
    return MOVE / axis("limits.speed") + 1.3 * rest / omega_n + rest / axis("control.position_gain")


def _moves(board: Board, seconds: float) -> Sequence[Any]:
    position = [board.read_words(f"{name}.position")[0] for name in AXIS_NAMES]
    counts = round(MOVE / (2.0 * math.pi) * COUNTS_PER_TURN)
    targets = {0: position[0] + counts, 1: position[1] - counts}
    results, log = move(board, targets, seconds, TOLERANCE)
    for name in AXIS_NAMES:
        if faults := board.catalogue.active("faults", int(log[-1][f"{name}.faults"])):
            raise SimulationError(f"{name}: {', '.join(fault.name for fault in faults)} in the move")
    return results


# ---- the experiment


@dataclass(frozen=True)
class _Campaign:
    """Work of the runner; can be pickled."""

    plant: PlantConfig  # other properties of the board
    seed: int
    level: Level  # level of the boards

    def run(self, number: int) -> Result:
        """Configure and drive one motor."""
        with at_level(self.level):
            return run_trial(self.seed, number, self.plant)


def trials(plant: PlantConfig, seed: int, numbers: Sequence[int], runner: Runner = HERE) -> list[Result]:
    """Run motors in order."""
    return run_in_order(runner, _Campaign(plant, seed, level()), numbers, f"{NAME}, motors", str)


def judge(results: Sequence[Result]) -> Outcome:
    """Figures of all motors."""
    accepted = [one for one in results if not one.refused]
    driving = [one for one in accepted if not one.problem]

    def row(name: str, value: float, unit: str, bound: Bound) -> Row:
        return Row(name, BEYOND, value, unit, bound)

    rows = (
        row("motors", len(results), "", Bound()),
        row("accepted as they are", sum(not one.refusals for one in accepted), "", Bound()),
        row("accepted with remedies", sum(bool(one.refusals) for one in accepted), "", Bound()),
        row("refused, beyond a limit of the board", sum(one.contradicts for one in results), "", Bound()),
        row("refused without a remedy", sum(bool(one.refused) and not one.contradicts for one in results), "", _NONE),
        row("accepted, drives within the aims", len(driving), "", Bound(minimum=len(accepted))),
        row("largest duration of a rotor search", _largest(one.search for one in driving), "s", Bound()),
        row("largest overshoot", _largest(one.overshoot for one in driving), "counts", Bound(maximum=OVERSHOOT_MAX)),
        row("largest duration over the planned one", _largest(one.duration for one in driving), "", Bound()),
    )
    counted = collections.Counter(entry.partition(".")[2] or entry for one in results for entry in one.refusals)
    notes = [f"corrected {number} times: {entry}" for entry, number in counted.most_common()]
    notes += [str(one) for one in results if one.refused or one.problem]
    return Outcome(NAME, rows, (), tuple(notes))


_NONE: Final = Bound(maximum=0.0)


def _largest(values: Iterator[float]) -> float:
    return float(np.max([0.0, *values]))


def run(plant: PlantConfig, seed: int, count: int = COUNT, runner: Runner = HERE) -> Outcome:
    """Drive random motors."""
    return judge(trials(plant, seed, range(count), runner))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this experiment."""
    parser.add_argument(
        "--count", type=argument.count, metavar="N", default=COUNT, help="number of motors (default: %(default)s)"
    )
    parser.add_argument("--trial", type=int, nargs="+", metavar="K", help="run only these motors")
    Runner.add_options(parser)


def with_options(args: argparse.Namespace) -> Callable[[PlantConfig, int], Outcome]:
    """The experiment with the parsed options."""
    if args.trial is None:
        return functools.partial(run, count=args.count, runner=Runner.of(args))
    return lambda plant, seed: judge(trials(plant, seed, args.trial, Runner.of(args)))
