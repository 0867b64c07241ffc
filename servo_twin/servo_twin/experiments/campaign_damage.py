"""What can break in the experiment fault-campaign, with random parameters, and what it may be called."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from servo_twin.board import Board
from servo_twin.experiments.campaign_states import State
from servo_twin.experiments.named_faults import NOTHING
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

NO_DAMAGE: Final = "no damage"
"""Kind of the trials that look for false alarms."""

UNDER, OVER = 16.0, 33.0  # limits of the bus in servo.toml [V]
NEAR: Final = 0.5  # noise and filter leave it open on which side of them the bus was [V]
WATCHDOG: Final = 0.05  # s
SLIP_MIN: Final = 30.0  # electrical [deg]
SLIP_NAMED: Final = 90.0  # from here on the torque acts the other way [deg]
WORN_LOAD: Final = 0.2  # part of the inertia that is behind a worn shaft
WORN_RESONANCE: Final = 400.0  # Hz
WORN_DAMPING: Final = 0.05  # of that resonance


@dataclass(frozen=True)
class Seen:
    """What the plant went through between the cause and the name."""

    u_min: float  # smallest voltage of the bus [V]
    u_max: float  # largest voltage of the bus [V]


@dataclass(frozen=True)
class Damage:
    """One kind of damage with its parameters."""

    kind: str  # one of `DAMAGES`
    text: str  # the same with the parameters
    strike: Callable[[Board], None]  # applies it to a board
    names: Callable[[Seen], tuple[str, ...]]  # correct names, given the course of the plant; `NOTHING` for none
    shows: bool = True  # it has to be detected at the latest when the axis is commanded to move
    stalls: bool = False  # the firmware loses count of its periods


@dataclass(frozen=True)
class Where:
    """What a damage is drawn for."""

    plant: PlantConfig
    axis: int
    state: State


def _injected(kind: str, fault: InjectedFault, *names: str) -> Damage:
    return Damage(kind, str(fault), lambda board: board.inject(fault), lambda seen: names, shows=NOTHING not in names)


def _open(rng: random.Random, at: Where) -> Damage:
    return _injected("open phase", OpenPhase(at.axis, rng.choice("abc")), "PHASE_LOST")  # type: ignore[arg-type]


def _cable(rng: random.Random, at: Where) -> Damage:
    return Damage(
        "motor cable", "no motor", lambda board: board.connect_motor(at.axis, False), lambda seen: ("PHASE_LOST",)
    )


def _to_minus(rng: random.Random, at: Where) -> Damage:
    phase = rng.choice("abc")
    return _injected("short to minus", ShortedPhase(at.axis, phase, "minus"), "OVER_CURRENT")  # type: ignore[arg-type]


def _between(rng: random.Random, at: Where) -> Damage:
    one, other = rng.sample("abc", 2)
    return _injected("short between phases", ShortedPhase(at.axis, one, other), "OVER_CURRENT")  # type: ignore[arg-type]


def _converter(rng: random.Random, at: Where) -> Damage:
    code = rng.choice((0, 4095, rng.randint(0, 4095), rng.randint(0, 4095), rng.randint(1990, 2110)))
    # Stuck before the offsets are measured it is an offset that cannot be.
    names = ("CURRENT_SENSE",) if at.state.calibrated else ("CURRENT_SENSE", "CURRENT_OFFSET")
    return _injected("converter stuck", StuckConverter(at.axis, rng.choice("abc"), code), *names)  # type: ignore[arg-type]


def _line(rng: random.Random, at: Where) -> Damage:
    line = StuckLine(at.axis, rng.choice("AB"), rng.random() < 0.5)  # type: ignore[arg-type]
    return _injected("encoder line", line, "ENCODER_LOST")


def _plug(rng: random.Random, at: Where) -> Damage:
    return Damage(
        "encoder plug",
        "no encoder",
        lambda board: board.connect_encoder(at.axis, False),
        lambda seen: ("ENCODER_LOST",),
    )


def _slip(rng: random.Random, at: Where) -> Damage:
    """Before the rotor is looked for it means nothing; afterwards a small one leaves a part of the torque."""
    motor = at.plant.axes[at.axis]
    degrees = rng.choice((-1.0, 1.0)) * rng.uniform(SLIP_MIN, 180.0)
    slip = SlippedEncoder(at.axis, round(degrees / 360.0 * 4 * motor.encoder_lines / motor.pole_pairs))
    if not at.state.calibrated:
        names: tuple[str, ...] = (NOTHING,)
    elif not at.state.aligned:
        names = (NOTHING, "ANGLE_MISMATCH", "ROTOR_SEARCH")
    elif abs(degrees) < SLIP_NAMED:
        names = (NOTHING, "ANGLE_MISMATCH")
    else:
        names = ("ANGLE_MISMATCH",)
    return _injected("encoder slips", slip, *names)


def _held(rng: random.Random, at: Where) -> Damage:
    # In motion, during the search; without an encoder: where the observer had it, or where it was to be started.
    names = ("SPEED_FEEDBACK", "START_UP") if at.state.sensorless else ("STALLED", "ROTOR_SEARCH")
    return _injected("rotor held", LockedRotor(at.axis), *names)


def _by_voltage(seen: Seen) -> tuple[str, ...]:
    names: list[str] = []
    if seen.u_min < UNDER + NEAR:
        names.append("UNDER_VOLTAGE")
    if seen.u_max > OVER - NEAR:
        names.append("OVER_VOLTAGE")
    if seen.u_min > UNDER - NEAR and seen.u_max < OVER + NEAR:
        names.append(NOTHING)
    return tuple(names)


def _dip(rng: random.Random, at: Where) -> Damage:
    seconds = rng.choice((math.inf, 10.0 ** rng.uniform(-3.0, 0.0)))
    dip = SupplyDip(rng.choice((0.0, rng.uniform(0.0, 23.0), rng.uniform(16.5, 23.0))), seconds)
    return Damage("supply dip", str(dip), lambda board: board.inject(dip), _by_voltage, shows=False)


def _surge(rng: random.Random, at: Where) -> Damage:
    surge = SupplyDip(rng.uniform(25.0, 36.0), rng.choice((math.inf, 10.0 ** rng.uniform(-3.0, 0.0))))
    return Damage("supply surge", str(surge), lambda board: board.inject(surge), _by_voltage, shows=False)


def _heat(rng: random.Random, at: Where) -> Damage:
    return _injected("heat", HotPowerStage(at.axis, rng.uniform(87.0, 145.0)), "OVER_TEMPERATURE")


def _stall(rng: random.Random, at: Where) -> Damage:
    fault = StalledCore(10.0 ** rng.uniform(-3.3, -0.7))
    late, dead = fault.seconds < 1.1 * WATCHDOG, fault.seconds > 0.9 * WATCHDOG
    names = (*(("LATE_LOOP",) if late else ()), *(("WATCHDOG",) if dead else ()))
    return Damage(
        "core stalled", str(fault), lambda board: board.inject(fault), lambda seen: names, shows=False, stalls=True
    )


def _noise(rng: random.Random, at: Where) -> Damage:
    noise = CurrentNoise(at.axis, rng.uniform(1.0, 3.0) * at.plant.axes[at.axis].i_noise)
    return _injected("current noise", noise, NOTHING)


def _bus_noise(rng: random.Random, at: Where) -> Damage:
    return _injected("bus noise", BusNoise(rng.uniform(1.0, 10.0) * at.plant.bus.u_noise), NOTHING)


def _glitches(rng: random.Random, at: Where) -> Damage:
    glitches = EncoderGlitches(at.axis, rng.choice("AB"), rng.uniform(10.0, 300.0))  # type: ignore[arg-type]
    return _injected("encoder glitches", glitches, NOTHING)


def _magnet(rng: random.Random, at: Where) -> Damage:
    return _injected("weak magnet", WeakMagnet(at.axis, rng.uniform(0.7, 1.0)), NOTHING)


def _contact(rng: random.Random, at: Where) -> Damage:
    return _injected("bad contact", BadContact(at.axis, rng.uniform(0.0, 0.5) * at.plant.axes[at.axis].r_s), NOTHING)


def _worn(rng: random.Random, at: Where) -> Damage:
    """A fifth of the inertia behind a shaft that twists, with play from now on."""
    axis = at.plant.axes[at.axis]
    load, rotor = WORN_LOAD * axis.inertia, (1.0 - WORN_LOAD) * axis.inertia
    mass = load * rotor / axis.inertia
    twist = 2.0 * math.pi * WORN_RESONANCE
    worn = WornShaft(at.axis, rng.uniform(0.0, 0.02))

    def strike(board: Board) -> None:
        board.take_plant(
            board.plant.with_axis(
                at.axis,
                inertia=rotor,
                load_inertia=load,
                shaft_stiffness=mass * twist**2,
                shaft_damping=2.0 * WORN_DAMPING * mass * twist,
            )
        )
        board.inject(worn)

    return Damage("worn shaft", str(worn), strike, lambda seen: (NOTHING,), shows=False)


def _disc(rng: random.Random, at: Where) -> Damage:
    disc = ShiftedDisc(at.axis, rng.uniform(0.0, 0.02), rng.uniform(0.0, 2.0 * math.pi))
    return _injected("shifted disc", disc, NOTHING)


def _bearing(rng: random.Random, at: Where) -> Damage:
    return _injected("dry bearing", DryBearing(at.axis, rng.uniform(1.0, 5.0)), NOTHING)


DAMAGES: Final[Mapping[str, tuple[Callable[[random.Random, Where], Damage], bool]]] = {
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
"""How each kind is drawn, and whether it means anything to an axis without an encoder."""


def no_damage(where: Where) -> Damage:
    """Three times the usual noise, which is none."""
    axis, bus = where.plant.axes[where.axis], where.plant.bus

    def strike(board: Board) -> None:
        board.inject(CurrentNoise(where.axis, 3.0 * axis.i_noise))
        board.inject(BusNoise(3.0 * bus.u_noise))

    return Damage(NO_DAMAGE, "noise", strike, lambda seen: (NOTHING,), shows=False)
