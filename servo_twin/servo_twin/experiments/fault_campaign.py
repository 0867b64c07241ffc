"""Random damage at random moments to motors that are not ours: the right name, in time, no motion, no false alarm."""

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

from servo_msgs_py import argument
from servo_twin.experiments.campaign_damage import DAMAGES, NO_DAMAGE, Damage, Seen, Where, no_damage
from servo_twin.experiments.campaign_motors import MOTORS, Motor, deviating
from servo_twin.experiments.campaign_states import MANOEUVRES, STATES, Bench, Script, State
from servo_twin.experiments.named_faults import EVERYTHING, NAMED, NOTHING, PROVOKED, fault_time, gain_max
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import TICK, TICK_NS, at_level, level
from servo_twin.level import Level
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.runner import HERE, Runner, run_in_order
from servo_twin.simulation import SimulationError

NAME: Final = "fault-campaign"
HELP: Final = """\
Beyond the reference design. Random trials: one of several motors, each with a firmware tuned for it and a plant that
deviates from its nominal data; one of many operating states, with or without an encoder; one kind of fault with random
parameters at a random time. If the fault has no effect in that state, the axis is then commanded to move. Criteria:
the reported fault, no motion by the drive afterwards, and continued operation of the other axis unless bus or core are
affected. Some trials inject no fault, but demanding motion, noise, load steps and a varying supply: no fault may be
reported there."""

COUNT: Final = 150
"""Trials by default."""

WHOLE: Final = 5
"""One trial of so many has no damage."""

SHORTS: Final = ("short to minus", "short between phases")
OTHER_OFF: Final = 0.05  # speed error of the other axis that bus and noise may cause, part of its speed limit
RUNAWAY_MARGIN: Final = 40.0  # beyond its limit that no axis may come (timing.runaway_margin) [rad/s]


# ---- drawing
@dataclass(frozen=True)
class Trial:
    """One trial before it is run. Between processes only what it follows from travels: its functions cannot.

    One that does not follow from that, made by hand or with another damage, is not pickled: `TypeError`.
    """

    seed: int  # determines the trial, with the number, the plant and the motors
    number: int  # of the trial
    motor: Motor
    state: State
    damage: Damage
    plant: PlantConfig  # true parameters
    motors: tuple[str, ...] = tuple(MOTORS)  # among which the motor was drawn
    nominal: PlantConfig | None = None  # the plant that it follows from; None if it was not drawn

    def __reduce__(self) -> tuple[Callable[..., Trial], tuple[object, ...]]:
        if self.nominal is not None:
            drawn = draw(self.nominal, self.seed, self.number, self.motors)
            if drawn._what == self._what:
                return draw, (self.nominal, self.seed, self.number, self.motors)
        raise TypeError("only a drawn trial can travel to another process")

    @property
    def _what(self) -> tuple[object, ...]:
        """What can be compared."""
        return self.motor, self.plant, self.state, self.damage.kind, self.damage.text

    @property
    def random(self) -> random.Random:
        """For whatever is drawn while it runs."""
        return random.Random(f"{NAME}, run {self.seed} {self.number}")


def draw(plant: PlantConfig, seed: int, number: int, motors: Sequence[str] = MOTORS) -> Trial:
    """Everything about a trial follows from its seed and number."""
    rng = random.Random(f"{NAME} {seed} {number}")
    motor = Motor.of(rng.choice(tuple(motors)), plant)
    there = deviating(motor.plant, rng)
    whole = number % WHOLE == WHOLE - 1
    states = (MANOEUVRES if whole else STATES).values()
    state = rng.choice([s for s in states if motor.observable or not s.sensorless])
    where = Where(there, motor.axis, state)
    if whole:
        damage = no_damage(where)
    else:
        make = rng.choice([make for make, observed in DAMAGES.values() if observed or not state.sensorless])
        damage = make(rng, where)
    return Trial(seed, number, motor, state, damage, there, tuple(motors), plant)


# ---- running
@dataclass(frozen=True)
class Result:
    """What came of a trial."""

    trial: Trial
    name: str  # first fault in its final form; empty without one
    right: tuple[str, ...]  # correct names
    seconds: float | None  # from the cause to outputs off; None: the axis had to be commanded to move, or no fault
    beyond: float  # speed beyond the commanded or initial one, between cause and outputs off [rad/s]
    gained: float  # increase of the shaft's speed after the outputs were off [rad/s]
    complaints: tuple[str, ...]  # criteria that are not met; empty: the trial is passed

    @property
    def lost(self) -> bool:
        return bool(self.complaints)

    def __str__(self) -> str:
        t = self.trial
        when = "" if self.seconds is None else f" after {1e3 * self.seconds:.1f} ms"
        what = "; ".join(self.complaints) or "right"
        among = "" if t.motors == tuple(MOTORS) else f" --motors {' '.join(t.motors)}"
        how = f"--seed {t.seed} --trial {t.number}{among}"
        return f"{how}: {t.motor.name}, {t.state.name}, {t.damage.text}{when}: {what}"


class _Watch:
    """The axis from the cause on, slow tick by slow tick."""

    def __init__(self, bench: Bench, script: Script, start: int) -> None:
        self._bench = bench
        self._events = sorted(script.events, key=lambda event: event[0])
        self._start = start
        self.wait = script.wait
        self.speed_max = 0.0
        self.u_min, self.u_max = np.inf, 0.0

    def play(self, until_ns: int) -> None:
        """Run to a moment, and do what is to be done before."""
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
            if self._bench.word("faults"):
                return True
        return False

    def look(self) -> None:
        truth = self._bench.board.truth(self._bench.axis)
        self.speed_max = max(self.speed_max, abs(truth.omega_m))
        self.u_min, self.u_max = min(self.u_min, truth.u_dc), max(self.u_max, truth.u_dc)

    def forget(self) -> None:
        """No more of what was to be done."""
        self._events.clear()


def _gain(motor: AxisPlant, plant: PlantConfig, damage: Damage) -> float:
    """The bus takes the current back, but for what goes round in a short, which drop and resistance end."""
    shorted = damage.kind in SHORTS
    return gain_max(motor, motor.v_drop + 0.5 * motor.r_s * motor.i_break if shorted else plant.bus.u_source)


def run_trial(trial: Trial) -> Result:
    """Break something, and see."""
    rng = trial.random
    with trial.motor.board(trial.plant, rng.getrandbits(32)) as board:
        there = trial.plant.axes[trial.motor.axis]
        bench = Bench(board, trial.motor.axis, there, trial.state.sensorless, trial.motor.slowest)
        try:
            script = trial.state.begin(bench, rng)
        except SimulationError as error:
            return Result(trial, NOTHING, (), None, 0.0, 0.0, (str(error),))
        watch = _Watch(bench, script, board.time_ns)
        watch.play(board.time_ns + round(rng.uniform(0.0, script.window) * 1e9))
        if early := bench.faults() | bench.faults(bench.other):
            return Result(trial, NOTHING, (), None, 0.0, 0.0, (f"before any cause: {', '.join(sorted(early))}",))
        return _break(trial, bench, watch, rng.choice((-1.0, 1.0)))


def _break(trial: Trial, bench: Bench, watch: _Watch, sign: float) -> Result:
    board, damage = bench.board, trial.damage
    watch.look()
    at_first, cause = watch.speed_max, board.time_ns
    damage.strike(board)
    found = watch.fault_within(watch.wait)
    seconds = None
    if found:
        seconds = max(fault_time(board, bench.axis, lost_count=damage.stalls) - cause, 0) * 1e-9
    elif damage.shows:
        watch.forget()
        bench.provoke(sign)
        found = watch.fault_within(PROVOKED)
    # What an axis bears while its core works drives it when that stands still.
    driven = abs(bench.torque_of_load) / bench.motor.inertia * (seconds or 0.0)
    before = abs(board.truth(bench.axis).omega_m)
    fastest = watch.speed_max
    beyond = fastest - max(at_first, bench.wanted)
    board.set_load(bench.axis, 0.0)  # whatever moves the shaft now is the drive
    watch.speed_max = before
    watch.forget()
    for _ in range(round(NAMED / TICK)):
        watch.fault_within(TICK)
    gained = watch.speed_max - before if found else 0.0
    name = bench.first_fault()
    right = damage.names(Seen(watch.u_min, watch.u_max))
    load_pulses = damage.kind == NO_DAMAGE  # of a load, which may well drive a light shaft beyond its limit
    maximum = np.inf if load_pulses else RUNAWAY_MARGIN + max(at_first, bench.speed_limit) + driven
    complaints = [
        *([] if name in right else [f"{name or 'no fault'} instead of {' or '.join(n or 'none' for n in right)}"]),
        *([] if fastest <= maximum else [f"{fastest:.0f} rad/s"]),
        *(
            []
            if gained <= _gain(bench.motor, trial.plant, damage)
            else [f"{gained:.3g} rad/s gained with the outputs off"]
        ),
        *_others(bench, name),
    ]
    return Result(trial, name, right, seconds, beyond, gained, tuple(complaints))


def _others(bench: Bench, name: str) -> list[str]:
    """What is wrong with the other axis."""
    theirs = bench.first_fault(bench.other)
    if theirs != (name if name in EVERYTHING else NOTHING):
        return [f"the other axis has {theirs or 'no fault'}"]
    if theirs or bench.place(bench.other) != "SPIN":
        return []  # it was never asked to turn
    error = abs(bench.board.truth(bench.other).omega_m - bench.other_speed)
    maximum = OTHER_OFF * bench.other_limit
    return [] if error <= maximum else [f"the other axis is {error:.3g} rad/s off its speed"]


# ---- all of them
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
    """Trials by their numbers; the same seed gives the same ones, wherever they run."""
    return run_in_order(runner, _Campaign(plant, seed, tuple(motors), level()), numbers, f"{NAME}, trials")


def run(
    plant: PlantConfig, seed: int, count: int = COUNT, motors: Sequence[str] = MOTORS, runner: Runner = HERE
) -> Outcome:
    """A campaign."""
    return judge(trials(plant, seed, range(count), motors, runner))


def judge(results: Sequence[Result]) -> Outcome:
    """A row per kind of damage, the lost trials, a table by damage and motor, and a picture of the times."""
    kinds = [kind for kind in (*DAMAGES, NO_DAMAGE) if any(r.trial.damage.kind == kind for r in results)]
    motors = [motor for motor in MOTORS if any(r.trial.motor.name == motor for r in results)]

    def among(kind: str, motor: str = "") -> list[Result]:
        return [r for r in results if r.trial.damage.kind == kind and motor in ("", r.trial.motor.name)]

    rows = [_row(kind, among(kind)) for kind in kinds]
    table = [_line("trials not lost of all", motors)]
    table += [_line(kind, [_cell(among(kind, motor)) for motor in motors]) for kind in kinds]
    curves = []
    for motor in motors:
        points = [(k, r.seconds) for k, kind in enumerate(kinds) for r in among(kind, motor) if r.seconds is not None]
        if points:
            x, y = (np.array(numbers, dtype=np.float64) for numbers in zip(*points, strict=True))
            curves.append(Curve(motor, x, np.maximum(1e3 * y, 0.05), "o"))
    title = "from cause to outputs off: " + ", ".join(f"{k} {kind}" for k, kind in enumerate(kinds))
    panel = Panel("\n".join(textwrap.wrap(title, 90)), "damage", "ms", tuple(curves), log_y=True)
    notes = (*table, *(f"LOST {r}" for r in results if r.lost))
    return Outcome(NAME, tuple(rows), (panel,), notes)


def _row(kind: str, mine: Sequence[Result]) -> Row:
    share = sum(not r.lost for r in mine) / len(mine)
    times = sorted(r.seconds for r in mine if r.seconds is not None)
    when = f", off after {1e3 * times[len(times) // 2]:.1f} ms, {1e3 * times[-1]:.0f} ms at most" if times else ""
    return Row(f"{kind}: not lost", f"{BEYOND}; {len(mine)} trials{when}", share, "of all", Bound(1.0, 1.0))


def _cell(mine: Sequence[Result]) -> str:
    return f"{sum(not r.lost for r in mine)}/{len(mine)}"


def _line(head: str, cells: Sequence[str]) -> str:
    return f"{head:<24}" + "".join(f"{cell:>8}" for cell in cells)


# ---- command line
def add_options(parser: argparse.ArgumentParser) -> None:
    """What this experiment can be told beyond plant and seed."""
    parser.add_argument(
        "--count", type=argument.count, metavar="N", default=COUNT, help="number of trials (default: %(default)s)"
    )
    parser.add_argument(
        "--trial", type=int, nargs="+", metavar="K", help="only these trials, each with what came of it"
    )
    parser.add_argument("--motors", nargs="+", choices=MOTORS, default=MOTORS, help="only these (other trials, then)")
    Runner.add_options(parser)


def with_options(args: argparse.Namespace) -> Callable[[PlantConfig, int], Outcome]:
    """The experiment as it was asked for."""
    if args.trial is None:
        return functools.partial(run, count=args.count, motors=args.motors, runner=Runner.of(args))

    def replay(plant: PlantConfig, seed: int) -> Outcome:
        results = trials(plant, seed, args.trial, args.motors, Runner.of(args))
        outcome = judge(results)
        return dataclasses.replace(outcome, notes=(*outcome.notes, *map(str, results)))

    return replay
