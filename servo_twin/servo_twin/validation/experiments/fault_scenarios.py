"""Scenarios of the fault experiments: what is injected, what must be reported; kinds with random parameters."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from servo_twin.board import Board
from servo_twin.fault_injection import (
    BadContact,
    BusNoise,
    CurrentNoise,
    DryBearing,
    EncoderGlitches,
    HotPowerStage,
    InjectedFault,
    LockedRotor,
    OpenPhase,
    ShiftedDisc,
    ShortedPhase,
    SlippedEncoder,
    StalledCore,
    StuckConverter,
    StuckLine,
    SupplyDip,
    WeakMagnet,
    WornShaft,
)
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.named_faults import NOTHING
from servo_twin.validation.experiments.operating_states import State

NO_FAULT: Final = "no damage"
"""Kind of the trials without a fault, for false alarms."""

UNDER, OVER = 16.0, 33.0  # voltage limits of the bus in servo.toml [V]
NEAR: Final = 0.5  # uncertainty of the limits by noise and filter [V]
WATCHDOG: Final = 0.05  # timeout [s]
SLIP_MIN: Final = 30.0  # smallest slip, electrical [deg]
SLIP_DETECTED: Final = 90.0  # smallest slip that must be detected: the torque reverses [deg]
WORN_LOAD: Final = 0.2  # fraction of the inertia on the load side of a worn shaft
WORN_RESONANCE: Final = 400.0  # Hz
WORN_DAMPING: Final = 0.05  # damping ratio of this resonance


@dataclass(frozen=True)
class BusRange:
    """Range of the bus voltage between injection and detection."""

    u_min: float  # smallest voltage of the bus [V]
    u_max: float  # largest voltage of the bus [V]


REPORTED: Final[Mapping[type[InjectedFault], tuple[str, ...]]] = {
    OpenPhase: ("PHASE_LOST",),
    ShortedPhase: ("OVER_CURRENT",),
    StuckConverter: ("CURRENT_SENSE",),
    StuckLine: ("ENCODER_LOST",),
    LockedRotor: ("STALLED", "ROTOR_SEARCH"),  # in motion, or during the rotor search
    HotPowerStage: ("OVER_TEMPERATURE",),
    BadContact: (NOTHING,),
    BusNoise: (NOTHING,),
    CurrentNoise: (NOTHING,),
    DryBearing: (NOTHING,),
    EncoderGlitches: (NOTHING,),
    ShiftedDisc: (NOTHING,),
    WeakMagnet: (NOTHING,),
}
"""Faults that the firmware may report for an injected fault; `NOTHING`: it must tolerate it."""


@dataclass(frozen=True)
class FaultScenario:
    """An injected fault with its parameters, and what must follow."""

    kind: str  # name in tables
    text: str  # description with the parameters
    inject: Callable[[Board], None]  # injects the fault into a board
    reported: tuple[str, ...] = ()
    """Permitted names of the reported fault; `NOTHING`: none. Empty: determined by the course of the bus voltage."""
    move_if_undetected: bool = True
    """Commands the axis to move if the fault has not been detected by then; it must be detected at the latest then.

    If False, the axis is not commanded to move; `expected_faults` states whether the fault may stay undetected.
    """
    stops_core: bool = False  # the core stops and does not count the PWM periods

    def expected_faults(self, seen: BusRange) -> tuple[str, ...]:
        """Permitted names of the reported fault for a course of the bus voltage."""
        return self.reported or _by_voltage(seen)


@dataclass(frozen=True)
class Context:
    """Context of a random fault."""

    plant: PlantConfig
    axis: int
    state: State


def scenario(kind: str, fault: InjectedFault, *reported: str) -> FaultScenario:
    """Scenario of one fault; `reported` replaces the names of `REPORTED`."""
    if isinstance(fault, StalledCore):
        late, dead = fault.seconds < 1.1 * WATCHDOG, fault.seconds > 0.9 * WATCHDOG
        reported = (*(("LATE_LOOP",) if late else ()), *(("WATCHDOG",) if dead else ()))
        return FaultScenario(kind, str(fault), lambda board: board.inject(fault), reported, False, stops_core=True)
    by_voltage = isinstance(fault, SupplyDip) and not reported
    names = reported or (() if by_voltage else REPORTED[type(fault)])
    moves = not by_voltage and NOTHING not in names
    return FaultScenario(kind, str(fault), lambda board: board.inject(fault), names, moves)


def _open(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("open phase", OpenPhase(context.axis, rng.choice("abc")))  # type: ignore[arg-type]


def _cable(rng: random.Random, context: Context) -> FaultScenario:
    return FaultScenario(
        "motor cable", "no motor", lambda board: board.connect_motor(context.axis, False), ("PHASE_LOST",)
    )


def _to_minus(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("short to minus", ShortedPhase(context.axis, rng.choice("abc"), "minus"))  # type: ignore[arg-type]


def _between(rng: random.Random, context: Context) -> FaultScenario:
    one, other = rng.sample("abc", 2)
    return scenario("short between phases", ShortedPhase(context.axis, one, other))  # type: ignore[arg-type]


def _converter(rng: random.Random, context: Context) -> FaultScenario:
    code = rng.choice((0, 4095, rng.randint(0, 4095), rng.randint(0, 4095), rng.randint(1990, 2110)))
    fault = StuckConverter(context.axis, rng.choice("abc"), code)  # type: ignore[arg-type]
    # Before the offset measurement a stuck converter may also be reported as an invalid offset.
    early = () if context.state.calibrated else (*REPORTED[StuckConverter], "CURRENT_OFFSET")
    return scenario("converter stuck", fault, *early)


def _line(rng: random.Random, context: Context) -> FaultScenario:
    line = StuckLine(context.axis, rng.choice("AB"), rng.random() < 0.5)  # type: ignore[arg-type]
    return scenario("encoder line", line)


def _plug(rng: random.Random, context: Context) -> FaultScenario:
    return FaultScenario(
        "encoder plug", "no encoder", lambda board: board.connect_encoder(context.axis, False), ("ENCODER_LOST",)
    )


def _slip(rng: random.Random, context: Context) -> FaultScenario:
    """No effect before the rotor search; afterwards a small slip reduces the torque."""
    motor = context.plant.axes[context.axis]
    degrees = rng.choice((-1.0, 1.0)) * rng.uniform(SLIP_MIN, 180.0)
    slip = SlippedEncoder(context.axis, round(degrees / 360.0 * 4 * motor.encoder_lines / motor.pole_pairs))
    if not context.state.calibrated:
        expected_faults: tuple[str, ...] = (NOTHING,)
    elif not context.state.aligned:
        expected_faults = (NOTHING, "ANGLE_MISMATCH", "ROTOR_SEARCH")
    elif abs(degrees) < SLIP_DETECTED:
        expected_faults = (NOTHING, "ANGLE_MISMATCH")
    else:
        expected_faults = ("ANGLE_MISMATCH",)
    return scenario("encoder slips", slip, *expected_faults)


def _held(rng: random.Random, context: Context) -> FaultScenario:
    # Without an encoder: in closed loop, or during the start-up.
    reported = ("SPEED_FEEDBACK", "START_UP") if context.state.sensorless else ()
    return scenario("rotor held", LockedRotor(context.axis), *reported)


def _by_voltage(seen: BusRange) -> tuple[str, ...]:
    expected_faults: list[str] = []
    if seen.u_min < UNDER + NEAR:
        expected_faults.append("UNDER_VOLTAGE")
    if seen.u_max > OVER - NEAR:
        expected_faults.append("OVER_VOLTAGE")
    if seen.u_min > UNDER - NEAR and seen.u_max < OVER + NEAR:
        expected_faults.append(NOTHING)
    return tuple(expected_faults)


def _dip(rng: random.Random, context: Context) -> FaultScenario:
    seconds = rng.choice((math.inf, 10.0 ** rng.uniform(-3.0, 0.0)))
    return scenario(
        "supply dip", SupplyDip(rng.choice((0.0, rng.uniform(0.0, 23.0), rng.uniform(16.5, 23.0))), seconds)
    )


def _surge(rng: random.Random, context: Context) -> FaultScenario:
    surge = SupplyDip(rng.uniform(25.0, 36.0), rng.choice((math.inf, 10.0 ** rng.uniform(-3.0, 0.0))))
    return scenario("supply surge", surge)


def _heat(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("heat", HotPowerStage(context.axis, rng.uniform(87.0, 145.0)))


def _stall(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("core stalled", StalledCore(10.0 ** rng.uniform(-3.3, -0.7)))


def _noise(rng: random.Random, context: Context) -> FaultScenario:
    noise = CurrentNoise(context.axis, rng.uniform(1.0, 3.0) * context.plant.axes[context.axis].i_noise)
    return scenario("current noise", noise)


def _bus_noise(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("bus noise", BusNoise(rng.uniform(1.0, 10.0) * context.plant.bus.u_noise))


def _glitches(rng: random.Random, context: Context) -> FaultScenario:
    glitches = EncoderGlitches(context.axis, rng.choice("AB"), rng.uniform(10.0, 300.0))  # type: ignore[arg-type]
    return scenario("encoder glitches", glitches)


def _magnet(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("weak magnet", WeakMagnet(context.axis, rng.uniform(0.7, 1.0)))


def _contact(rng: random.Random, context: Context) -> FaultScenario:
    return scenario(
        "bad contact", BadContact(context.axis, rng.uniform(0.0, 0.5) * context.plant.axes[context.axis].r_s)
    )


def _worn(rng: random.Random, context: Context) -> FaultScenario:
    """An elastic shaft with a fifth of the inertia on the load side, and backlash."""
    axis = context.plant.axes[context.axis]
    load, rotor = WORN_LOAD * axis.inertia, (1.0 - WORN_LOAD) * axis.inertia
    mass = load * rotor / axis.inertia
    twist = 2.0 * math.pi * WORN_RESONANCE
    worn = WornShaft(context.axis, rng.uniform(0.0, 0.02))

    def inject(board: Board) -> None:
        board.take_plant(
            board.plant.with_axis(
                context.axis,
                inertia=rotor,
                load_inertia=load,
                shaft_stiffness=mass * twist**2,
                shaft_damping=2.0 * WORN_DAMPING * mass * twist,
            )
        )
        board.inject(worn)

    return FaultScenario("worn shaft", str(worn), inject, (NOTHING,), move_if_undetected=False)


def _disc(rng: random.Random, context: Context) -> FaultScenario:
    disc = ShiftedDisc(context.axis, rng.uniform(0.0, 0.02), rng.uniform(0.0, 2.0 * math.pi))
    return scenario("shifted disc", disc)


def _bearing(rng: random.Random, context: Context) -> FaultScenario:
    return scenario("dry bearing", DryBearing(context.axis, rng.uniform(1.0, 5.0)))


INJECTED_FAULTS: Final[Mapping[str, tuple[Callable[[random.Random, Context], FaultScenario], bool]]] = {
    "open phase": (_open, True),
    "motor cable": (_cable, True),
    "short to minus": (_to_minus, True),
    "short between phases": (_between, True),
    "converter stuck": (_converter, True),
    "encoder line": (_line, False),
    "encoder plug": (_plug, False),
    "encoder slips": (_slip, False),
    "rotor held": (_held, True),
    "supply dip": (_dip, True),
    "supply surge": (_surge, True),
    "heat": (_heat, True),
    "core stalled": (_stall, True),
    "current noise": (_noise, True),
    "bus noise": (_bus_noise, True),
    "encoder glitches": (_glitches, False),
    "weak magnet": (_magnet, True),
    "bad contact": (_contact, True),
    "worn shaft": (_worn, True),
    "shifted disc": (_disc, False),
    "dry bearing": (_bearing, True),
}
"""Random generator of each kind, and whether it affects a sensorless axis."""


def no_fault(where: Context) -> FaultScenario:
    """Three times the normal noise, which is not a fault."""
    axis, bus = where.plant.axes[where.axis], where.plant.bus

    def inject(board: Board) -> None:
        board.inject(CurrentNoise(where.axis, 3.0 * axis.i_noise))
        board.inject(BusNoise(3.0 * bus.u_noise))

    return FaultScenario(NO_FAULT, "noise", inject, (NOTHING,), move_if_undetected=False)
