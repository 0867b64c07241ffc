"""Sensorless start-up: time of convergence, time of the criterion, and success rate."""

from __future__ import annotations

import argparse
import functools
import itertools
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.board_port import word, write_axis
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.runner import HERE, Runner, run_in_order
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Outcome, Panel, experiment
from servo_twin.validation.experiments.rig import RPM, at_level, level
from servo_twin.validation.experiments.sensorless import (
    angle_error,
    fault_names,
    follow,
    limits_of,
    observing,
    substate,
)

NAME: Final = "start-up"
HELP: Final = """\
A rotating current vector accelerates the rotor until mean and variance of the observed speed meet the criterion. The
reference design shows a start-up in which the angle converges within 150 ms and the criterion is met within 500 ms (ST
document, waveforms of a start-up). Measured on both axes with their nominal plant, from the start of the vector; the
angle has converged when its error stays within 15 degrees from then on, also in closed loop. Then 1000 starts with
random rotor angle, direction and set-point, with inertia, friction and load torque spread about the nominal ones, on
all cores (20 of them at register level): the number of starts after which the shaft turns at the set-point."""

STARTS: Final = 1000
"""Random starts, two per board."""

STARTS_REGISTERS: Final = 20
"""Random starts at level registers, which takes about ten times as long."""

CONVERGED: Final = 15.0
"""Largest error of a converged angle [deg]; it reduces the torque by 3.4 %."""

ANGLE_MAX: Final = 0.150  # of the reference design [s]
CRITERION_MAX: Final = 0.500  # of the reference design [s]

INERTIA: Final = (0.5, 2.0)
"""Range of the inertia, relative to the nominal one, uniform on a logarithmic scale."""

FRICTION: Final = (0.5, 3.0)
"""Range of the friction, relative to the nominal one, uniform on a logarithmic scale."""

LOAD: Final = 0.3
"""Largest load torque (fan characteristic), relative to the torque at half of the current limit."""

SET_POINTS: Final = (0.15, 0.9)
"""Range of the set-point, relative to the speed limit."""

RATE_MIN: Final = 99.0
"""Required success rate of the random starts [%]; the reference design gives no figure."""

NOMINAL: Final = 0.6  # length of the nominal start [s]
START_LENGTH_MAX: Final = 2.5  # largest length of a random start [s]
SETTLED: Final = 0.4  # time in closed loop before the speed is checked [s]
SPEED_MAX: Final = 0.1  # permitted relative error of the true speed


@dataclass(frozen=True)
class Start:
    """One start of one axis."""

    criterion: float | None  # from the start of the start-up to closed loop [s]
    converged: float | None  # time of convergence of the angle [s]
    end: str  # reason of a failure; empty: success
    what: str = ""  # conditions, as text

    @property
    def succeeded(self) -> bool:
        return not self.end


@dataclass(frozen=True)
class Draw:
    """Conditions of one start."""

    inertia: float  # relative to the nominal one
    friction: float  # relative to the nominal one
    load: float  # torque at the set-point, relative to the torque at half of the current limit
    set_point: float  # relative to the speed limit, with sign

    def __str__(self) -> str:
        return (
            f"inertia x {self.inertia:.2f}, friction x {self.friction:.2f}, load {100.0 * self.load:.0f} %, "
            f"set-point {100.0 * self.set_point:.0f} %"
        )


@dataclass(frozen=True)
class _Starts:
    """The boards of all random starts."""

    plant: PlantConfig
    seed: int
    drawn: Sequence[tuple[Draw, ...]]
    level: Level

    def run(self, number: int) -> tuple[Start, ...]:
        with at_level(self.level):
            return start(self.plant, self.seed + 1 + number, self.drawn[number])


def draws(seed: int, boards: int) -> list[tuple[Draw, ...]]:
    """Random conditions for `boards` boards."""
    source = random.Random(f"start-up {seed}")

    def spread(low: float, high: float) -> float:
        return math.exp(source.uniform(math.log(low), math.log(high)))

    def one() -> Draw:
        direction = source.choice((-1.0, 1.0))
        return Draw(
            spread(*INERTIA), spread(*FRICTION), source.uniform(0.0, LOAD), direction * source.uniform(*SET_POINTS)
        )

    return [tuple(one() for _ in range(AXES)) for _ in range(boards)]


def examine(trace: Trace, startup: int, spin: int) -> Start:
    """Evaluate the start-up in a trace."""
    started = np.nonzero(trace["substate"] == startup)[0]
    done = np.nonzero(trace["substate"] == spin)[0]
    if started.size == 0:
        return Start(None, None, "no start-up")
    if done.size == 0:
        return Start(None, None, "no closed loop")
    criterion = float(done[0] - started[0]) * TICK
    wrong = np.nonzero(np.abs(angle_error(trace)[started[0] :]) > CONVERGED)[0]
    converged = None
    if wrong.size == 0:
        converged = 0.0
    elif wrong[-1] + 1 < trace.time.size - started[0]:
        converged = float(wrong[-1] + 1) * TICK
    return Start(criterion, converged, "")


def nominal(plant: PlantConfig, seed: int) -> dict[int, Trace]:
    """Start both axes of the plant, to a third of the speed limit."""
    with observing(plant, seed) as board:
        for axis in range(AXES):
            write_axis(board, "cmd.speed", axis, limits_of(board, axis)[0] / 3.0)
        return follow(board, range(AXES), NOMINAL)


def start(plant: PlantConfig, seed: int, drawn: tuple[Draw, ...]) -> tuple[Start, ...]:
    """Start both axes of one board simultaneously."""
    for axis, draw in enumerate(drawn):
        motor = plant.axes[axis]
        friction = draw.friction * motor.friction
        plant = plant.with_axis(axis, inertia=draw.inertia * motor.inertia, friction=friction)
    with observing(plant, seed) as board:
        speeds = [draw.set_point * limits_of(board, axis)[0] for axis, draw in enumerate(drawn)]
        fans = [_fan(board, axis, draw, speeds[axis]) for axis, draw in enumerate(drawn)]
        for axis, speed in enumerate(speeds):
            write_axis(board, "cmd.speed", axis, speed)
        fan_loads = _FanLoads(board, fans)
        traces = follow(board, range(AXES), START_LENGTH_MAX, fan_loads)
        startup, spin = (substate(board, name) for name in ("STARTUP", "SPIN"))
        return tuple(
            _judged(board, traces[axis], examine(traces[axis], startup, spin), speeds[axis], str(draw))
            for axis, draw in enumerate(drawn)
        )


def _fan(board: Board, axis: int, draw: Draw, speed: float) -> float:
    """Torque of the fan divided by the squared speed [N m s^2]."""
    torque = draw.load * 0.5 * limits_of(board, axis)[1] * board.plant.axes[axis].torque_constant
    return torque / speed**2


class _FanLoads:
    """Applies the fan loads; ends the run when every axis has been in closed loop for `SETTLED`, or has a fault."""

    def __init__(self, board: Board, fans: Sequence[float]) -> None:
        self._board, self._fans = board, fans
        self._spin = substate(board, "SPIN")
        self._spinning = [0] * AXES

    def __call__(self, _: int) -> bool:
        over = True
        for axis in range(AXES):
            omega = self._board.truth(axis).omega_m
            self._board.set_load(axis, self._fans[axis] * omega * abs(omega))
            self._spinning[axis] += word(self._board, axis, "substate") == self._spin
            over = over and (word(self._board, axis, "faults") != 0 or self._spinning[axis] * TICK >= SETTLED)
        return over


def _judged(board: Board, trace: Trace, found: Start, speed: float, what: str) -> Start:
    """A start with the reason of a failure."""
    if trace["faults"].any():
        first = int(trace["faults"][int(np.argmax(trace["faults"] != 0))])
        return replace(found, end=fault_names(board, first), what=what)
    mean = float(trace["omega"][-round(0.05 / TICK) :].mean())
    slow = f"{mean / RPM:.0f} rpm instead of {speed / RPM:.0f}" if abs(mean / speed - 1.0) > SPEED_MAX else ""
    return replace(found, end=found.end or slow or ("a wrong angle" if found.converged is None else ""), what=what)


def many(plant: PlantConfig, seed: int, count: int, runner: Runner) -> list[Start]:
    """Run random starts; results depend on the seed only."""
    boards = range((count + AXES - 1) // AXES)
    work = _Starts(plant, seed, draws(seed, len(boards)), level())
    results = run_in_order(runner, work, boards, f"{NAME}, boards")
    return list(itertools.chain.from_iterable(results))[:count]


TIMES: Final[tuple[tuple[str, str, str, float, Callable[[Start], float | None]], ...]] = (
    ("time until the angle converges", "angle", "angle has converged", ANGLE_MAX, lambda start_: start_.converged),
    (
        "time until the criterion is met",
        "criterion",
        "criterion is met",
        CRITERION_MAX,
        lambda start_: start_.criterion,
    ),
)
"""Figures of a start: name, name in the notes, name of the curve, bound and value [s]."""


@experiment(NAME)
def run(plant: PlantConfig, seed: int, count: int | None = None, runner: Runner = HERE) -> Iterator[Item]:
    """The nominal starts, then the random ones."""
    startup, spin = (Catalogue.load().enums["substate_t"][name] for name in ("STARTUP", "SPIN"))
    for axis, trace in nominal(plant, seed).items():
        judge, found = Judge(f"{axis_name(axis)}, "), examine(trace, startup, spin)
        for name, _, _, maximum, value in TIMES:
            seconds, reference = value(found), f"{1e3 * maximum:.0f} ms on the waveforms"
            yield judge(
                name, None if seconds is None else 1e3 * seconds, "ms", maximum=1e3 * maximum, reference=reference
            )
        time = 1e3 * trace.time
        waveforms = (
            Curve("error of the angle [deg]", time, angle_error(trace)),
            Curve("true speed [rpm]", time, trace["omega"] / RPM),
            Curve("observed speed [rpm]", time, trace["speed"] / RPM),
        )
        yield Panel(f"{axis_name(axis)}: start-up", "time [ms]", "", waveforms)
    starts = many(plant, seed, count or (STARTS if level() == "ideal" else STARTS_REGISTERS), runner)
    good, failed = ([s for s in starts if s.succeeded is succeeded] for succeeded in (True, False))
    yield f"random starts: {len(starts)}"
    judge = Judge("", NOT_SHOWN)
    yield judge("successful random starts", 100.0 * len(good) / len(starts), "%", RATE_MIN)
    lost = sum(s.criterion is not None and not s.end.isupper() for s in failed)  # names of faults are in capitals
    yield judge("random starts that fail without a fault", lost, maximum=0.0)
    distributions: list[Curve] = []
    for name, label, done, maximum, value in TIMES:
        times = np.sort([1e3 * seconds for s in good if (seconds := value(s)) is not None])
        usual = np.median(times) if times.size else None
        yield judge(f"median, {name}", usual, "ms", maximum=1e3 * maximum, reference="as above")
        if times.size:
            tenth, half, late = (float(np.percentile(times, q)) for q in (10, 50, 95))
            yield f"{label}: 10 % within {tenth:.0f} ms, half within {half:.0f} ms, 95 % within {late:.0f} ms"
        distributions.append(Curve(done, times, 100.0 * np.arange(1, times.size + 1) / max(len(starts), 1)))
    yield from (f"failed: {s.end} ({s.what})" for s in failed[:5])
    yield f"and {len(failed) - 5} more" if len(failed) > 5 else ""
    yield Panel(f"{len(starts)} random starts", "time [ms]", "fraction of the starts [%]", distributions)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this experiment."""
    text = f"number of random starts (default: {STARTS}, at level registers {STARTS_REGISTERS})"
    parser.add_argument("--count", type=argument.count, metavar="N", help=text)
    Runner.add_options(parser)


def with_options(args: argparse.Namespace) -> Callable[[PlantConfig, int], Outcome]:
    """The experiment with the parsed options."""
    return functools.partial(run, count=args.count, runner=Runner.of(args))
