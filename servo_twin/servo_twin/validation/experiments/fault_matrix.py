"""Every fault in every state of an axis: time to outputs off, reported fault, behaviour of the other axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import active, first_fault, reached, write_axis
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS, TICK

from servo_twin.fault_injection import (
    CurrentNoise,
    EncoderGlitches,
    HotPowerStage,
    LockedRotor,
    OpenPhase,
    ShortedPhase,
    StalledCore,
    StuckConverter,
    StuckLine,
    SupplyDip,
)
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.fault_scenarios import FaultScenario, scenario
from servo_twin.validation.experiments.named_faults import (
    COMMON_FAULTS,
    FINAL_TIME,
    NOTHING,
    PROVOKED_TIME,
    fault_time,
    gain_max,
    has_fault,
)
from servo_twin.validation.experiments.operating_states import Bench
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Outcome, Panel, Row, experiment
from servo_twin.validation.experiments.rig import fresh_board

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
def _enabled(where: str, seconds: float) -> Callable[[Bench], None]:
    """Enable axis 1, wait for a sub-state and then for `seconds` [s]."""

    def prepare(bench: Bench) -> None:
        bench.boot()
        bench.enable()
        bench.until(where, lambda: bench.place == where)
        bench.board.run(seconds)

    return prepare


_hold: Final = _enabled("SPIN", 0.1)


def _speed(speed: float) -> Callable[[Bench], None]:
    def prepare(bench: Bench) -> None:
        _hold(bench)
        bench.speed(speed)
        bench.board.run(0.3)

    return prepare


def _torque(bench: Bench) -> None:
    _hold(bench)
    bench.torque(0.15)
    bench.board.run(0.2)


def _coast(bench: Bench) -> None:
    """A load keeps the shaft rotating until the stop is aborted."""
    _speed(200.0)(bench)
    write_axis(bench.board, "param.i_q_limit", bench.axis, 0.1)
    bench.board.set_load(bench.axis, -0.006)
    bench.enable(False)
    bench.until("FREEWHEEL", lambda: bench.place == "FREEWHEEL")
    bench.board.set_load(bench.axis, 0.0)


STATES: Final[Mapping[str, Callable[[Bench], None]]] = {
    "STOP": Bench.boot,
    "CALIB": _enabled("CALIB", 0.005),
    "ALIGN": _enabled("ALIGN", 0.05),
    "hold": _hold,
    "20 rad/s": _speed(20.0),
    "100 rad/s": _speed(100.0),
    "-250 rad/s": _speed(-250.0),
    "torque": _torque,
    "FREEWHEEL": _coast,
}
"""Operating states of axis 1: main states, sub-states, and SPIN in its modes."""


def _provoke(bench: Bench) -> None:
    """Command the axis to move."""
    write_axis(bench.board, "param.i_q_limit", bench.axis, 4.0)
    bench.enable()
    bench.speed(60.0)


# ---- faults
@dataclass(frozen=True)
class FaultCase:
    """One injected fault, with its bounds."""

    scenario: FaultScenario
    periods_max: int | None = ROTATION_TIME_MAX
    """Largest detection time in rotation [PWM periods]; None: no bound."""
    apart: float | None = None
    """Permitted relative difference of the detection time between the levels, plus one slow tick; None: random."""

    @property
    def name(self) -> str:
        return self.scenario.kind


def fault_cases(plant: PlantConfig) -> list[FaultCase]:
    """Faults to inject into axis 1."""
    noise = 3.0 * plant.axes[0].i_noise
    stuck = ((phase, code) for phase in "abc" for code in (0, 1500, 2050, 4095))
    return [
        *(FaultCase(scenario(f"open phase {p}", OpenPhase(0, p))) for p in ("a", "b", "c")),
        FaultCase(scenario("phase a to minus", ShortedPhase(0, "a", "minus")), HARDWARE_TIME_MAX),
        FaultCase(scenario("phase b to c", ShortedPhase(0, "b", "c")), None),
        *(FaultCase(scenario(f"converter {p} at {c}", StuckConverter(0, p, c)), None) for p, c in stuck),  # type: ignore[arg-type]
        *(FaultCase(scenario(f"encoder line {line}", StuckLine(0, line))) for line in ("A", "B")),
        FaultCase(scenario("rotor held", LockedRotor(0)), None, BY_CLOCK),
        FaultCase(scenario("supply gone", SupplyDip(0.0), "UNDER_VOLTAGE"), None, BY_CHARGE),
        FaultCase(scenario("heat", HotPowerStage(0, 110.0)), None, BY_CLOCK),
        FaultCase(scenario("core stands still 1 ms", StalledCore(0.001)), None, BY_CLOCK),
        FaultCase(scenario("core hangs", StalledCore(0.2)), None, BY_CLOCK),
        FaultCase(scenario("noise x 3", CurrentNoise(0, noise))),
        FaultCase(scenario("encoder glitches", EncoderGlitches(0, "A", 300.0))),
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
        return self.name in self.fault_case.scenario.reported

    @property
    def agrees(self) -> bool:
        return self.name_correct and self.gained <= self.gain_max and self.other


def case(plant: PlantConfig, seed: int, fault_case: FaultCase, state: str) -> Case:
    """Inject a fault in a state and measure the response."""
    injected = fault_case.scenario
    with fresh_board(plant, seed) as board:
        bench = Bench(board, 0, plant.axes[0], other_speed=OTHER_SPEED)
        STATES[state](bench)

        def found_within(seconds: float) -> bool:
            return reached(board, lambda: has_fault(board, 0), seconds)

        cause = board.time_ns // PERIOD_NS
        injected.inject(board)
        found = found_within(WAIT)
        periods = None
        if found:
            periods = max(fault_time(board, 0, lost_count=injected.stops_core) // PERIOD_NS - cause, 0)
        elif not injected.stops_core:
            _provoke(bench)
            found = found_within(PROVOKED_TIME)
        speed = abs(board.truth(0).omega_m)
        fastest = speed
        for _ in range(round(FINAL_TIME / TICK)):
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
        (" or ".join(fault_case.scenario.reported) or "no fault", [c.name_correct for c in own]),
        ("no motion after the fault", [c.gained <= c.gain_max for c in own]),
        ("axis 2 as expected", [c.other for c in own]),
    ):
        yield judge(name, sum(right) / len(right), "of all", 1.0, 1.0)
    shown = [c for c in own if c.periods is not None]
    turning = [c.periods for c in shown if c.state in TURNING and c.periods is not None]
    if fault_case.periods_max is not None and NOTHING not in fault_case.scenario.reported and turning:
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
