"""Random fault injection with six motors: reported fault, detection time, no motion afterwards, no false alarm."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import random
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import first_fault, place
from servo_msgs_py.table_text import aligned
from servo_msgs_py.units import TICK, TICK_NS

from servo_msgs_py import argument
from servo_twin.level import Level
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.runner import HERE, Runner, run_in_order
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments.campaign_motors import MOTORS, Motor, deviating
from servo_twin.validation.experiments.fault_scenarios import (
    INJECTED_FAULTS,
    NO_FAULT,
    BusRange,
    Context,
    FaultScenario,
    no_fault,
)
from servo_twin.validation.experiments.named_faults import (
    COMMON_FAULTS,
    FINAL_TIME,
    NOTHING,
    PROVOKED_TIME,
    fault_time,
    gain_max,
    has_fault,
)
from servo_twin.validation.experiments.operating_states import MANOEUVRES, STATES, Bench, Script, State
from servo_twin.validation.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.validation.experiments.rig import at_level, level

NAME: Final = "fault-campaign"
HELP: Final = """\
Beyond the reference design. Random trials: one of several motors, each with gains tuned for it and a plant that
deviates from its nominal data; one of many operating states, with or without an encoder; one kind of fault with random
parameters at a random time. If the fault has no effect in that state, the axis is then commanded to move. Criteria:
the reported fault, no motion by the drive afterwards, and continued operation of the other axis unless bus or core are
affected. Some trials inject no fault, but demanding motion, noise, load steps and a varying supply: no fault may be
reported there."""

COUNT: Final = 150
"""Default number of trials."""

NO_FAULT_INTERVAL: Final = 5
"""One of this number of trials has no fault."""

SHORTS: Final = ("short to minus", "short between phases")
OTHER_ERROR_MAX: Final = 0.05  # speed error of the other axis by bus and noise, relative to its speed limit
RUNAWAY_MARGIN: Final = 40.0  # permitted speed above the limit (timing.runaway_margin) [rad/s]


# ---- random trials
@dataclass(frozen=True)
class Trial:
    """One trial before its run. It is pickled as the arguments of `draw`, because functions cannot be pickled.

    Pickling a trial that `draw` does not reproduce raises `TypeError`.
    """

    seed: int  # determines the trial, with number, plant and motors
    number: int  # number of the trial
    motor: Motor
    state: State
    fault: FaultScenario
    plant: PlantConfig  # true parameters
    motors: tuple[str, ...] = tuple(MOTORS)  # motors for the random selection
    nominal: PlantConfig | None = None  # argument of `draw`; None: not created by `draw`

    def __reduce__(self) -> tuple[Callable[..., Trial], tuple[object, ...]]:
        if self.nominal is not None:
            drawn = draw(self.nominal, self.seed, self.number, self.motors)
            if drawn._comparable == self._comparable:
                return draw, (self.nominal, self.seed, self.number, self.motors)
        raise TypeError("only trials created by draw() can be pickled")

    @property
    def _comparable(self) -> tuple[object, ...]:
        """Members that can be compared."""
        return self.motor, self.plant, self.state, self.fault.kind, self.fault.text

    @property
    def random(self) -> random.Random:
        """Random numbers of the run."""
        return random.Random(f"{NAME}, run {self.seed} {self.number}")


def draw(plant: PlantConfig, seed: int, number: int, motors: Sequence[str] = MOTORS) -> Trial:
    """Create a trial; it depends on the arguments only."""
    rng = random.Random(f"{NAME} {seed} {number}")
    motor = Motor.of(rng.choice(tuple(motors)), plant)
    true_plant = deviating(motor.plant, rng)
    without_fault = number % NO_FAULT_INTERVAL == NO_FAULT_INTERVAL - 1
    states = (MANOEUVRES if without_fault else STATES).values()
    state = rng.choice([s for s in states if motor.observable or not s.sensorless])
    context = Context(true_plant, motor.axis, state)
    if without_fault:
        fault = no_fault(context)
    else:
        make = rng.choice([make for make, observed in INJECTED_FAULTS.values() if observed or not state.sensorless])
        fault = make(rng, context)
    return Trial(seed, number, motor, state, fault, true_plant, tuple(motors), plant)


# ---- run
@dataclass(frozen=True)
class Result:
    """Result of a trial."""

    trial: Trial
    name: str  # first fault, final; empty: none
    right: tuple[str, ...]  # expected fault names
    seconds: float | None  # from injection to outputs off; None: detected only on a motion command, or no fault
    beyond: float  # speed above the commanded or initial one, between injection and outputs off [rad/s]
    gained: float  # increase of the speed after the outputs are off [rad/s]
    failures: tuple[str, ...]  # failed criteria; empty: passed

    @property
    def failed(self) -> bool:
        return bool(self.failures)

    def __str__(self) -> str:
        t = self.trial
        when = "" if self.seconds is None else f" after {1e3 * self.seconds:.1f} ms"
        what = "; ".join(self.failures) or "right"
        among = "" if t.motors == tuple(MOTORS) else f" --motors {' '.join(t.motors)}"
        how = f"--seed {t.seed} --trial {t.number}{among}"
        return f"{how}: {t.motor.name}, {t.state.name}, {t.fault.text}{when}: {what}"


class _Monitor:
    """Monitors the axis after the injection in slow ticks."""

    def __init__(self, bench: Bench, script: Script, start: int) -> None:
        self._bench = bench
        self._events = sorted(script.events, key=lambda event: event[0])
        self._start = start
        self.wait = script.wait
        self.speed_max = 0.0
        self.u_min, self.u_max = np.inf, 0.0

    def play(self, until_ns: int) -> None:
        """Run to a time and execute the events up to it."""
        board = self._bench.board
        while self._events and self._start + round(self._events[0][0] * 1e9) <= until_ns:
            moment, act = self._events.pop(0)
            board.advance(self._start + round(moment * 1e9))
            act()
        board.advance(until_ns)

    def fault_within(self, seconds: float) -> bool:
        board = self._bench.board
        end = board.time_ns + round(seconds * 1e9)
        while board.time_ns < end:
            self.play(min(board.time_ns + TICK_NS, end))
            self.look()
            if has_fault(self._bench.board, self._bench.axis):
                return True
        return False

    def look(self) -> None:
        truth = self._bench.board.truth(self._bench.axis)
        self.speed_max = max(self.speed_max, abs(truth.omega_m))
        self.u_min, self.u_max = min(self.u_min, truth.u_dc), max(self.u_max, truth.u_dc)

    def forget(self) -> None:
        """Discard the remaining events."""
        self._events.clear()


def _gain(motor: AxisPlant, plant: PlantConfig, fault: FaultScenario) -> float:
    """Permitted gain of speed: the current decays against the bus, or in a short against drop and resistance."""
    shorted = fault.kind in SHORTS
    return gain_max(motor, motor.v_drop + 0.5 * motor.r_s * motor.i_break if shorted else plant.bus.u_source)


def run_trial(trial: Trial) -> Result:
    """Run a trial."""
    rng = trial.random
    with trial.motor.board(trial.plant, rng.getrandbits(32)) as board:
        true_plant = trial.plant.axes[trial.motor.axis]
        bench = Bench(board, trial.motor.axis, true_plant, trial.state.sensorless, trial.motor.slowest)
        try:
            script = trial.state.begin(bench, rng)
        except SimulationError as error:
            return Result(trial, NOTHING, (), None, 0.0, 0.0, (str(error),))
        monitor = _Monitor(bench, script, board.time_ns)
        monitor.play(board.time_ns + round(rng.uniform(0.0, script.window) * 1e9))
        if early := bench.faults():
            return Result(
                trial, NOTHING, (), None, 0.0, 0.0, (f"fault before the injection: {', '.join(sorted(early))}",)
            )
        return _inject(trial, bench, monitor, rng.choice((-1.0, 1.0)))


def _inject(trial: Trial, bench: Bench, monitor: _Monitor, sign: float) -> Result:
    board, fault = bench.board, trial.fault
    monitor.look()
    at_first, cause = monitor.speed_max, board.time_ns
    fault.inject(board)
    found = monitor.fault_within(monitor.wait)
    seconds = None
    if found:
        seconds = max(fault_time(board, bench.axis, lost_count=fault.stops_core) - cause, 0) * 1e-9
    elif fault.move_if_undetected:
        monitor.forget()
        bench.provoke(sign)
        found = monitor.fault_within(PROVOKED_TIME)
    # A load that the controller holds accelerates the shaft while the core is stopped.
    driven = abs(bench.load_torque) / bench.motor.inertia * (seconds or 0.0)
    before = abs(board.truth(bench.axis).omega_m)
    fastest = monitor.speed_max
    beyond = fastest - max(at_first, bench.commanded_speed)
    board.set_load(bench.axis, 0.0)  # from now on only the drive can move the shaft
    monitor.speed_max = before
    monitor.forget()
    for _ in range(round(FINAL_TIME / TICK)):
        monitor.fault_within(TICK)
    gained = monitor.speed_max - before if found else 0.0
    name = first_fault(bench.board, bench.axis)
    right = fault.expected_faults(BusRange(monitor.u_min, monitor.u_max))
    load_pulses = fault.kind == NO_FAULT  # may accelerate a light shaft above its limit
    maximum = np.inf if load_pulses else RUNAWAY_MARGIN + max(at_first, bench.speed_limit) + driven
    failures = [
        *([] if name in right else [f"{name or 'no fault'} instead of {' or '.join(n or 'none' for n in right)}"]),
        *([] if fastest <= maximum else [f"{fastest:.0f} rad/s"]),
        *(
            []
            if gained <= _gain(bench.motor, trial.plant, fault)
            else [f"{gained:.3g} rad/s gained with the outputs off"]
        ),
        *_others(bench, name),
    ]
    return Result(trial, name, right, seconds, beyond, gained, tuple(failures))


def _others(bench: Bench, name: str) -> list[str]:
    """Failed criteria of the other axis."""
    other_fault = first_fault(bench.board, bench.other)
    if other_fault != (name if name in COMMON_FAULTS else NOTHING):
        return [f"the other axis has {other_fault or 'no fault'}"]
    if other_fault or place(bench.board, bench.other) != "SPIN":
        return []  # not commanded to move
    error = abs(bench.board.truth(bench.other).omega_m - bench.other_speed)
    maximum = OTHER_ERROR_MAX * bench.other_limit
    return [] if error <= maximum else [f"speed error of the other axis {error:.3g} rad/s"]


# ---- campaign
@dataclass(frozen=True)
class _Campaign:
    """All trials of a seed."""

    plant: PlantConfig
    seed: int
    motors: tuple[str, ...]
    level: Level

    def run(self, number: int) -> Result:
        with at_level(self.level):
            return run_trial(draw(self.plant, self.seed, number, self.motors))


def trials(
    plant: PlantConfig, seed: int, numbers: Sequence[int], motors: Sequence[str] = MOTORS, runner: Runner = HERE
) -> list[Result]:
    """Run trials by number; results depend on seed and number only."""
    return run_in_order(runner, _Campaign(plant, seed, tuple(motors), level()), numbers, f"{NAME}, trials", str)


def run(
    plant: PlantConfig, seed: int, count: int = COUNT, motors: Sequence[str] = MOTORS, runner: Runner = HERE
) -> Outcome:
    """Run a campaign."""
    return judge(trials(plant, seed, range(count), motors, runner))


def judge(results: Sequence[Result]) -> Outcome:
    """Rows per kind of fault, failed trials, table by fault and motor, and picture of the times."""
    kinds = [kind for kind in (*INJECTED_FAULTS, NO_FAULT) if any(r.trial.fault.kind == kind for r in results)]
    motors = [motor for motor in MOTORS if any(r.trial.motor.name == motor for r in results)]

    def among(kind: str, motor: str = "") -> list[Result]:
        return [r for r in results if r.trial.fault.kind == kind and motor in ("", r.trial.motor.name)]

    rows = [_row(kind, among(kind)) for kind in kinds]
    cells = [[kind, *(_cell(among(kind, motor)) for motor in motors)] for kind in kinds]
    table = aligned([["passed of all trials", *motors], *cells], "<>")
    curves = []
    for motor in motors:
        points = [(k, r.seconds) for k, kind in enumerate(kinds) for r in among(kind, motor) if r.seconds is not None]
        if points:
            x, y = (np.array(numbers, dtype=np.float64) for numbers in zip(*points, strict=True))
            curves.append(Curve(motor, x, np.maximum(1e3 * y, 0.05), "o"))
    title = "time from injection to outputs off: " + ", ".join(f"{k} {kind}" for k, kind in enumerate(kinds))
    panel = Panel("\n".join(textwrap.wrap(title, 90)), "fault", "ms", tuple(curves), log_y=True)
    notes = (*table, *(f"FAILED {r}" for r in results if r.failed))
    return Outcome(NAME, tuple(rows), (panel,), notes)


def _row(kind: str, own: Sequence[Result]) -> Row:
    share = sum(not r.failed for r in own) / len(own)
    times = sorted(r.seconds for r in own if r.seconds is not None)
    when = f", off after {1e3 * times[len(times) // 2]:.1f} ms, {1e3 * times[-1]:.0f} ms at most" if times else ""
    return Row(f"{kind}: passed", f"{BEYOND}; {len(own)} trials{when}", share, "of all", Bound(1.0, 1.0))


def _cell(own: Sequence[Result]) -> str:
    return f"{sum(not r.failed for r in own)}/{len(own)}"


# ---- command line
def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this experiment."""
    parser.add_argument(
        "--count", type=argument.count, metavar="N", default=COUNT, help="number of trials (default: %(default)s)"
    )
    parser.add_argument(
        "--trial", type=int, nargs="+", metavar="K", help="run only these trials and print their results"
    )
    parser.add_argument(
        "--motors",
        nargs="+",
        metavar="NAME",
        choices=MOTORS,
        default=MOTORS,
        help="only these motors: %(choices)s (changes the trials)",
    )
    Runner.add_options(parser)


def with_options(args: argparse.Namespace) -> Callable[[PlantConfig, int], Outcome]:
    """The experiment with the parsed options."""
    if args.trial is None:
        return functools.partial(run, count=args.count, motors=args.motors, runner=Runner.of(args))

    def replay(plant: PlantConfig, seed: int) -> Outcome:
        results = trials(plant, seed, args.trial, args.motors, Runner.of(args))
        outcome = judge(results)
        return dataclasses.replace(outcome, notes=(*outcome.notes, *map(str, results)))

    return replay
