"""Every fault in every state of an axis: time to outputs off, reported fault, behaviour of the other axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import active, first_fault, place, word
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_twin.board import Board
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
from servo_twin.validation.experiments.named_faults import (
    COMMON_FAULTS,
    FINAL_TIME,
    NOTHING,
    PROVOKED_TIME,
    fault_time,
    gain_max,
)
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Outcome, Panel, Row, experiment
from servo_twin.validation.experiments.rig import TICK, fresh_board, until

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
"""Speed of axis 2 [rad/s]."""

OTHER_ERROR_MAX: Final = 15.0
"""Permitted speed error of axis 2 by bus and noise [rad/s]."""

REACHED_TIME: Final = 5.0  # timeout for reaching a state [s]
WAIT: Final = 0.7  # time for the detection in the state [s]
ROTATION_TIME_MAX: Final = 1005
"""Largest detection time in rotation [PWM periods]: one revolution at 100 rad/s."""

HARDWARE_TIME_MAX: Final = 20
"""Largest detection time of faults that the hardware switches off [PWM periods]."""

BY_CLOCK: Final = 0.03
"""Permitted relative difference of times that a clock determines: watchdog and core have different clocks."""

BY_CHARGE: Final = 0.1
"""Permitted relative difference of the discharge time from 24 to 16 V (0.75 J at about 1.6 W): 0.1 W, and feedback."""


# ---- states
def _keep_alive(board: Board) -> None:
    """Write a command, because half a second without one is a fault."""
    board.write("cmd.quick_stop", [0, 0])


def _wait(board: Board, seconds: float) -> None:
    for _ in range(max(round(seconds / 0.1), 1)):
        _keep_alive(board)
        board.run(min(seconds, 0.1))


def _both(board: Board) -> None:
    """Axis 2 rotates, axis 1 is in STOP."""
    board.run(0.03)
    board.write("cmd.enable", [0, 1])
    until(board, "SPIN of axis 2", lambda: place(board, 1) == "SPIN", REACHED_TIME)
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [0.0, OTHER_SPEED])
    _wait(board, 0.2)


def _reach(where: str, seconds: float) -> Callable[[Board], None]:
    """Enable axis 1, wait for a sub-state and then for `seconds` [s]."""

    def prepare(board: Board) -> None:
        _both(board)
        board.write("cmd.enable", [1, 1])
        until(board, where, lambda: place(board, 0) == where, REACHED_TIME)
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
    """A load keeps the shaft rotating until the stop is aborted."""
    _speed(200.0)(board)
    board.write("param.i_q_limit", [0.1, 4.0])
    board.set_load(0, -0.006)
    board.write("cmd.enable", [0, 1])
    until(board, "FREEWHEEL", lambda: place(board, 0) == "FREEWHEEL", REACHED_TIME)
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
"""Operating states of axis 1: main states, sub-states, and SPIN in its modes."""


def _provoke(board: Board) -> None:
    """Command the axis to move."""
    board.write("param.i_q_limit", [4.0, 4.0])
    board.write("cmd.enable", [1, 1])
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [60.0, OTHER_SPEED])


# ---- faults
@dataclass(frozen=True)
class FaultCase:
    """One injected fault."""

    name: str
    fault: InjectedFault  # fault for `Board.inject`
    faults: tuple[str, ...]  # expected names; `NOTHING`: none
    periods_max: int | None = ROTATION_TIME_MAX
    """Largest detection time in rotation [PWM periods]; None: no bound."""
    provoked: bool = True  # must be detected when the axis moves
    apart: float | None = None
    """Permitted relative difference of the detection time between the levels, plus one slow tick; None: random."""


def fault_cases(plant: PlantConfig) -> list[FaultCase]:
    """Faults to inject into axis 1."""
    noise = 3.0 * plant.axes[0].i_noise
    stuck = ((phase, code) for phase in "abc" for code in (0, 1500, 2050, 4095))
    return [
        *(FaultCase(f"open phase {p}", OpenPhase(0, p), ("PHASE_LOST",)) for p in ("a", "b", "c")),
        FaultCase("phase a to minus", ShortedPhase(0, "a", "minus"), ("OVER_CURRENT",), HARDWARE_TIME_MAX),
        FaultCase("phase b to c", ShortedPhase(0, "b", "c"), ("OVER_CURRENT",), None),
        *(
            FaultCase(f"converter {p} at {c}", StuckConverter(0, p, c), ("CURRENT_SENSE",), None)  # type: ignore[arg-type]
            for p, c in stuck
        ),
        *(FaultCase(f"encoder line {line}", StuckLine(0, line), ("ENCODER_LOST",)) for line in ("A", "B")),
        FaultCase("rotor held", LockedRotor(0), ("STALLED", "ROTOR_SEARCH"), None, apart=BY_CLOCK),
        FaultCase("supply gone", SupplyDip(0.0), ("UNDER_VOLTAGE",), None, apart=BY_CHARGE),
        FaultCase("heat", HotPowerStage(0, 110.0), ("OVER_TEMPERATURE",), None, apart=BY_CLOCK),
        FaultCase("core stands still 1 ms", StalledCore(0.001), ("LATE_LOOP",), None, provoked=False, apart=BY_CLOCK),
        FaultCase("core hangs", StalledCore(0.2), ("WATCHDOG",), None, provoked=False, apart=BY_CLOCK),
        FaultCase("noise x 3", CurrentNoise(0, noise), (NOTHING,)),
        FaultCase("encoder glitches", EncoderGlitches(0, "A", 300.0), (NOTHING,)),
    ]


# ---- one case
@dataclass(frozen=True)
class Case:
    """Result of one fault in one state."""

    fault_case: FaultCase
    state: str
    name: str  # first fault, final; empty: none
    periods: int | None
    """PWM periods from injection to detection; None: detected only on a motion command, or no fault."""
    gained: float  # increase of the speed after the outputs are off [rad/s]
    gain_max: float  # permitted increase by the decaying current [rad/s]
    other: bool  # true if axis 2 continued as commanded

    @property
    def name_correct(self) -> bool:
        return self.name in self.fault_case.faults

    @property
    def agrees(self) -> bool:
        return self.name_correct and self.gained <= self.gain_max and self.other


def _fault_within(board: Board, seconds: float) -> bool:
    for k in range(round(seconds / TICK)):
        if k % 200 == 0:
            _keep_alive(board)
        board.run(TICK)
        if word(board, 0, "faults"):
            return True
    return False


def case(plant: PlantConfig, seed: int, fault_case: FaultCase, state: str) -> Case:
    """Inject a fault in a state and measure the response."""
    with fresh_board(plant, seed) as board:
        STATES[state](board)
        cause = board.time_ns // PERIOD_NS
        board.inject(fault_case.fault)
        found = _fault_within(board, WAIT)
        periods = None
        if found:
            time = fault_time(board, 0, lost_count=isinstance(fault_case.fault, StalledCore))
            periods = max(time // PERIOD_NS - cause, 0)
        elif fault_case.provoked:
            _provoke(board)
            found = _fault_within(board, PROVOKED_TIME)
        speed = abs(board.truth(0).omega_m)
        fastest = speed
        for k in range(round(FINAL_TIME / TICK)):
            if k % 200 == 0:
                _keep_alive(board)
            board.run(TICK)
            fastest = max(fastest, abs(board.truth(0).omega_m))
        name = first_fault(board, 0)
        other = active(board, 1)
        error = abs(board.truth(1).omega_m - OTHER_SPEED)
        fine = other == {name} if name in COMMON_FAULTS else not other and error < OTHER_ERROR_MAX
        gain = gain_max(plant.axes[0], plant.bus.u_source)  # the current decays against the bus
        return Case(fault_case, state, name, periods, fastest - speed if found else 0.0, gain, fine)


# ---- matrix
def cases(plant: PlantConfig, seed: int) -> list[Case]:
    """Every fault in every state."""
    return [
        case(plant, seed + k, fault_case, state)
        for k, (fault_case, state) in enumerate(
            (fault_case, state) for fault_case in fault_cases(plant) for state in STATES
        )
    ]


TURNING: Final = ("100 rad/s", "-250 rad/s")


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Run the matrix."""
    return judge(cases(plant, seed))


@experiment(NAME)
def judge(found: Sequence[Case]) -> Iterator[Item]:
    """Rows, notes with the matrix, and a picture of the times."""
    curves: list[Curve] = []
    for fault_case in dict.fromkeys(c.fault_case for c in found):
        own = [c for c in found if c.fault_case == fault_case]
        yield from _rows(Judge(f"{fault_case.name}: "), fault_case, own)
        yield f"{fault_case.name}: " + ", ".join(_text(c) for c in own)
        times = [(k, c.periods) for k, c in enumerate(own) if c.periods is not None]
        if times:  # detected without a motion command
            x, y = (np.array(numbers, dtype=np.float64) for numbers in zip(*times, strict=True))
            curves.append(Curve(fault_case.name, x, np.log10(np.maximum(y, 1.0)), "o"))
    title = "time from injection to detection, by state: " + ", ".join(dict.fromkeys(c.state for c in found))
    yield Panel(title, "state", "log10 of PWM periods", curves)


def _rows(judge: Judge, fault_case: FaultCase, own: Sequence[Case]) -> Iterator[Row]:
    """Fractions of passed cases; longest detection time in rotation, and without a motion command, if bounded."""
    for name, right in (
        (" or ".join(fault_case.faults) or "no fault", [c.name_correct for c in own]),
        ("no motion after the fault", [c.gained <= c.gain_max for c in own]),
        ("axis 2 as expected", [c.other for c in own]),
    ):
        yield judge(name, sum(right) / len(right), "of all", 1.0, 1.0)
    shown = [c for c in own if c.periods is not None]
    turning = [c.periods for c in shown if c.state in TURNING and c.periods is not None]
    if fault_case.periods_max is not None and NOTHING not in fault_case.faults and turning:
        yield judge("time until outputs off in rotation", max(turning), "PWM periods", 0.0, fault_case.periods_max)
    if fault_case.apart is not None and shown:
        latest, within = max(c.periods for c in shown if c.periods is not None), round(WAIT * 1e9 / PERIOD_NS)
        apart = fault_case.apart * latest + SLOW_PERIODS
        yield judge(
            "longest time to detection without a motion command", latest, "PWM periods", 0.0, within, apart=apart
        )


def _text(case: Case) -> str:
    when = "" if case.periods is None else f" {case.periods}"
    mark = "" if case.agrees else "!"
    return f"{mark}{case.state} {case.name or '-'}{when}"
