"""Every damage in every state of an axis: how soon its outputs are off, what it is called, what the other axis did."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_twin.board import Board
from servo_twin.experiments.named_faults import (
    EVERYTHING,
    NAMED,
    NOTHING,
    PROVOKED,
    fault_time,
    faults,
    first_fault,
    gain_max,
    place,
)
from servo_twin.experiments.outcome import Curve, Item, Judge, Outcome, Panel, Row, experiment
from servo_twin.experiments.rig import TICK, fresh_board, until, word
from servo_twin.fault_injection import (
    CurrentNoise,
    EncoderGlitches,
    HotPowerStage,
    InjectedFault,
    LockedRotor,
    OpenPhase,
    ShortedPhase,
    StalledCore,
    StuckConverter,
    StuckLine,
    SupplyDip,
)
from servo_twin.plant import PlantConfig

NAME: Final = "fault-matrix"
HELP: Final = """\
Beyond the reference design, which lists its faults but shows no measurement. Every fault of the plant is injected in
every state of axis 1 while axis 2 turns: open and shorted phases, stuck current converters, dead encoder channels, a
blocked rotor, loss of the supply, heat, a stopped core; also noise and glitches that must not cause a fault. If the
fault has no effect in that state, the axis is then commanded to move, and the fault must be reported then. Criteria:
the reported fault, PWM periods from the cause to outputs off, no motion by the drive afterwards, and continued
operation of the other axis unless bus or core are affected. Where a clock determines the time, both levels of a board
agree within 3 %; where the charge of the bus does, within 10 %, because the ripple of the currents causes losses of
0.1 W that the averaged plant does not include; elsewhere rotor angle, vectors of the search and noise determine the
time."""

OTHER_SPEED: Final = 100.0
"""Of axis 2 [rad/s]."""

OTHER_OFF: Final = 15.0
"""Speed error that the bus and its noise may cause there [rad/s]."""

REACHED: Final = 5.0  # a state, at most [s]
WAIT: Final = 0.7  # for a fault, in the state itself [s]
SOON: Final = 1005
"""PWM periods within which a fault that shows in a turning motor has to be off: a turn at 100 rad/s."""

BREAK: Final = 20
"""PWM periods for what the hardware switches off and the software names."""

BY_CLOCK: Final = 0.03
"""Part of a time that a clock decides about: the watchdog's is another one than the core's."""

BY_CHARGE: Final = 0.1
"""Part of the time that the bus takes from 24 V to 16 V, 0.75 J at some 1.6 W: 0.1 W, and what the shafts feed back."""


# ---- states
def _keep_awake(board: Board) -> None:
    """A host that says nothing for half a second is a fault."""
    board.write("cmd.quick_stop", [0, 0])


def _wait(board: Board, seconds: float) -> None:
    for _ in range(max(round(seconds / 0.1), 1)):
        _keep_awake(board)
        board.run(min(seconds, 0.1))


def _both(board: Board) -> None:
    """Axis 2 turns, axis 1 is in STOP."""
    board.run(0.03)
    board.write("cmd.enable", [0, 1])
    until(board, "SPIN of axis 2", lambda: place(board, 1) == "SPIN", REACHED)
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [0.0, OTHER_SPEED])
    _wait(board, 0.2)


def _reach(where: str, seconds: float) -> Callable[[Board], None]:
    """Enable axis 1 as well; so long after a sub-state has been reached [s]."""

    def prepare(board: Board) -> None:
        _both(board)
        board.write("cmd.enable", [1, 1])
        until(board, where, lambda: place(board, 0) == where, REACHED)
        _wait(board, seconds)

    return prepare


_hold: Final = _reach("SPIN", 0.1)


def _speed(speed: float) -> Callable[[Board], None]:
    def prepare(board: Board) -> None:
        _hold(board)
        board.write("cmd.mode", [1, 1])
        board.write("cmd.speed", [speed, OTHER_SPEED])
        _wait(board, 0.3)

    return prepare


def _torque(board: Board) -> None:
    _hold(board)
    board.write("cmd.mode", [2, 1])
    board.write("cmd.i_q", [0.15, 0.0])
    _wait(board, 0.2)


def _coast(board: Board) -> None:
    """A load keeps the shaft turning until the stop is given up."""
    _speed(200.0)(board)
    board.write("param.i_q_limit", [0.1, 4.0])
    board.set_load(0, -0.006)
    board.write("cmd.enable", [0, 1])
    until(board, "FREEWHEEL", lambda: place(board, 0) == "FREEWHEEL", REACHED)
    board.set_load(0, 0.0)


STATES: Final[Mapping[str, Callable[[Board], None]]] = {
    "STOP": _both,
    "CALIB": _reach("CALIB", 0.005),
    "ALIGN": _reach("ALIGN", 0.05),
    "hold": _hold,
    "20 rad/s": _speed(20.0),
    "100 rad/s": _speed(100.0),
    "-250 rad/s": _speed(-250.0),
    "torque": _torque,
    "FREEWHEEL": _coast,
}
"""What axis 1 is doing when it happens: main states, sub-states, and SPIN in its modes."""


def _provoke(board: Board) -> None:
    """Ask the axis to move."""
    board.write("param.i_q_limit", [4.0, 4.0])
    board.write("cmd.enable", [1, 1])
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [60.0, OTHER_SPEED])


# ---- damage
@dataclass(frozen=True)
class Damage:
    """One kind of damage."""

    name: str
    fault: InjectedFault  # for the plant
    faults: tuple[str, ...]  # expected names; `NOTHING`: no fault
    periods_max: int | None = SOON
    """Outputs off after so many PWM periods in a turning motor; None: it takes what it takes."""
    provoked: bool = True  # it has to be detected when the axis moves
    apart: float | None = None
    """Part of the time until it shows by itself by which the levels of a board may differ, beside the slow tick that
    the supervision may come later; None: it is not the same twice."""


def damages(plant: PlantConfig) -> list[Damage]:
    """What is broken, on axis 1."""
    noise = 3.0 * plant.axes[0].i_noise
    stuck = ((phase, code) for phase in "abc" for code in (0, 1500, 2050, 4095))
    return [
        *(Damage(f"open phase {p}", OpenPhase(0, p), ("PHASE_LOST",)) for p in ("a", "b", "c")),
        Damage("phase a to minus", ShortedPhase(0, "a", "minus"), ("OVER_CURRENT",), BREAK),
        Damage("phase b to c", ShortedPhase(0, "b", "c"), ("OVER_CURRENT",), None),
        *(
            Damage(f"converter {p} at {c}", StuckConverter(0, p, c), ("CURRENT_SENSE",), None)  # type: ignore[arg-type]
            for p, c in stuck
        ),
        *(Damage(f"encoder line {line}", StuckLine(0, line), ("ENCODER_LOST",)) for line in ("A", "B")),
        Damage("rotor held", LockedRotor(0), ("STALLED", "ROTOR_SEARCH"), None, apart=BY_CLOCK),
        Damage("supply gone", SupplyDip(0.0), ("UNDER_VOLTAGE",), None, apart=BY_CHARGE),
        Damage("heat", HotPowerStage(0, 110.0), ("OVER_TEMPERATURE",), None, apart=BY_CLOCK),
        Damage("core stands still 1 ms", StalledCore(0.001), ("LATE_LOOP",), None, provoked=False, apart=BY_CLOCK),
        Damage("core hangs", StalledCore(0.2), ("WATCHDOG",), None, provoked=False, apart=BY_CLOCK),
        Damage("noise x 3", CurrentNoise(0, noise), (NOTHING,)),
        Damage("encoder glitches", EncoderGlitches(0, "A", 300.0), (NOTHING,)),
    ]


# ---- one case
@dataclass(frozen=True)
class Case:
    """What one damage did in one state."""

    damage: Damage
    state: str
    name: str  # first fault in its final form; empty without one
    periods: int | None
    """PWM periods from the cause to the fault; None if the axis had to be asked to move, or there was none."""
    gained: float  # increase of the speed of the shaft after the outputs were off [rad/s]
    gain_max: float  # largest that the remaining current of the winding explains [rad/s]
    other: bool  # whether axis 2 continued as commanded

    @property
    def named(self) -> bool:
        return self.name in self.damage.faults

    @property
    def agrees(self) -> bool:
        return self.named and self.gained <= self.gain_max and self.other


def _fault_within(board: Board, seconds: float) -> bool:
    for k in range(round(seconds / TICK)):
        if k % 200 == 0:
            _keep_awake(board)
        board.run(TICK)
        if word(board, 0, "faults"):
            return True
    return False


def case(plant: PlantConfig, seed: int, damage: Damage, state: str) -> Case:
    """Break something in a state and see."""
    with fresh_board(plant, seed) as board:
        STATES[state](board)
        cause = board.time_ns // PERIOD_NS
        board.inject(damage.fault)
        found = _fault_within(board, WAIT)
        periods = None
        if found:
            time = fault_time(board, 0, lost_count=isinstance(damage.fault, StalledCore))
            periods = max(time // PERIOD_NS - cause, 0)
        elif damage.provoked:
            _provoke(board)
            found = _fault_within(board, PROVOKED)
        speed = abs(board.truth(0).omega_m)
        fastest = speed
        for k in range(round(NAMED / TICK)):
            if k % 200 == 0:
                _keep_awake(board)
            board.run(TICK)
            fastest = max(fastest, abs(board.truth(0).omega_m))
        name = first_fault(board, 0)
        other = faults(board, 1)
        error = abs(board.truth(1).omega_m - OTHER_SPEED)
        fine = other == {name} if name in EVERYTHING else not other and error < OTHER_OFF
        gain = gain_max(plant.axes[0], plant.bus.u_source)  # the bus takes the current back
        return Case(damage, state, name, periods, fastest - speed if found else 0.0, gain, fine)


# ---- all of them
def cases(plant: PlantConfig, seed: int) -> list[Case]:
    """Every damage in every state."""
    return [
        case(plant, seed + k, damage, state)
        for k, (damage, state) in enumerate((damage, state) for damage in damages(plant) for state in STATES)
    ]


TURNING: Final = ("100 rad/s", "-250 rad/s")


def run(plant: PlantConfig, seed: int) -> Outcome:
    """The matrix, one row per damage and figure."""
    return judge(cases(plant, seed))


@experiment(NAME)
def judge(found: Sequence[Case]) -> Iterator[Item]:
    """Rows, notes with the matrix, and a picture of the times."""
    curves: list[Curve] = []
    for damage in dict.fromkeys(c.damage for c in found):
        mine = [c for c in found if c.damage == damage]
        yield from _rows(Judge(f"{damage.name}: "), damage, mine)
        yield f"{damage.name}: " + ", ".join(_text(c) for c in mine)
        times = [(k, c.periods) for k, c in enumerate(mine) if c.periods is not None]
        if times:  # something has shown by itself
            x, y = (np.array(numbers, dtype=np.float64) for numbers in zip(*times, strict=True))
            curves.append(Curve(damage.name, x, np.log10(np.maximum(y, 1.0)), "o"))
    title = "from cause to fault, by state: " + ", ".join(dict.fromkeys(c.state for c in found))
    yield Panel(title, "state", "log10 of PWM periods", curves)


def _rows(judge: Judge, damage: Damage, mine: Sequence[Case]) -> Iterator[Row]:
    """What is right; the slowest in a turning motor, and the slowest that showed by itself, where that is bounded."""
    for name, right in (
        (" or ".join(damage.faults) or "no fault", [c.named for c in mine]),
        ("no motion after", [c.gained <= c.gain_max for c in mine]),
        ("axis 2 as it should", [c.other for c in mine]),
    ):
        yield judge(name, sum(right) / len(right), "of all", 1.0, 1.0)
    shown = [c for c in mine if c.periods is not None]
    turning = [c.periods for c in shown if c.state in TURNING and c.periods is not None]
    if damage.periods_max is not None and NOTHING not in damage.faults and turning:
        yield judge("outputs off, turning", max(turning), "PWM periods", 0.0, damage.periods_max)
    if damage.apart is not None and shown:
        latest, within = max(c.periods for c in shown if c.periods is not None), round(WAIT * 1e9 / PERIOD_NS)
        apart = damage.apart * latest + SLOW_PERIODS
        yield judge("latest by itself", latest, "PWM periods", 0.0, within, apart=apart)


def _text(it: Case) -> str:
    when = "" if it.periods is None else f" {it.periods}"
    mark = "" if it.agrees else "!"
    return f"{mark}{it.state} {it.name or '-'}{when}"
