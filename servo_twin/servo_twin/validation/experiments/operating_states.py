"""Operating states for the injection of faults: bench with both axes, and states with random parameters."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from servo_msgs_py.board_port import active, choose, place, reached, read_axis, word, write_axis, write_word

from servo_twin.board import Board
from servo_twin.plant import AxisPlant
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import rig

BOOT: Final = 0.03  # reset to STOP [s]
REACHED_TIME: Final = 5.0  # timeout for reaching a state [s]
OTHER_SPEED: Final = 0.3  # speed of the other axis, relative to its speed limit
PROVOKED_SPEED: Final = 0.2  # speed of the motion command after an undetected fault, relative to the speed limit
PROVOKED_SPEED_SENSORLESS: Final = 0.3  # the same for a sensorless axis
LOAD_STEPS: Final = 20  # steps of a load ramp: a sensorless axis does not tolerate a large load step


@dataclass
class Bench:
    """Board with the tested axis and the other one."""

    board: Board
    axis: int
    motor: AxisPlant  # true parameters
    sensorless: bool = False  # the axis uses the observer
    slowest: float = 0.0  # lowest sensorless set-point, relative to the speed limit
    commanded_speed: float = 0.0  # largest commanded speed [rad/s]; in torque mode the speed limit
    load_torque: float = 0.0  # external torque [N m]
    speed_limit: float = field(init=False)  # [rad/s]
    acceleration: float = field(init=False)  # limit [rad/s^2]
    current: float = field(init=False)  # limit of i_q [A]
    other_limit: float = field(init=False)  # speed limit of the other axis [rad/s]
    other_speed: float = math.nan  # speed of the other axis [rad/s]; by default `OTHER_SPEED` of its limit

    def __post_init__(self) -> None:
        self.speed_limit = read_axis(self.board, "param.speed_limit", self.axis)
        self.acceleration = read_axis(self.board, "param.acceleration_limit", self.axis)
        self.current = read_axis(self.board, "param.i_q_limit", self.axis)
        self.other_limit = read_axis(self.board, "param.speed_limit", self.other)
        if math.isnan(self.other_speed):
            self.other_speed = OTHER_SPEED * self.other_limit

    @property
    def other(self) -> int:
        return 1 - self.axis

    # ---- state
    @property
    def place(self) -> str:
        """Sub-state of the tested axis in RUN, or its state."""
        return place(self.board, self.axis)

    def faults(self) -> set[str]:
        """Names of the faults of both axes."""
        return active(self.board, self.axis) | active(self.board, self.other)

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Run until a condition holds; raises `SimulationError` on a fault or timeout."""
        reached(self.board, lambda: holds() or bool(self.faults()), REACHED_TIME)
        if not holds():
            raise SimulationError(
                f"{what} was not reached; state {self.place}, faults: {', '.join(sorted(self.faults())) or '-'}"
            )

    # ---- commands
    def enable(self, on: bool = True) -> None:
        write_axis(self.board, "cmd.enable", self.axis, float(on))

    def speed(self, speed: float) -> None:
        """Write a speed set-point [rad/s] in speed mode."""
        self.commanded_speed = max(self.commanded_speed, abs(speed))
        choose(self.board, "cmd.mode", self.axis, "SPEED")
        write_axis(self.board, "cmd.speed", self.axis, speed)

    def turn(self, turns: float) -> None:
        """Move by a number of revolutions in position mode."""
        self.commanded_speed = self.speed_limit
        choose(self.board, "cmd.mode", self.axis, "POSITION")
        write_word(
            self.board, "cmd.position", self.axis, word(self.board, self.axis, "position") + round(4000.0 * turns)
        )

    def torque(self, current: float) -> None:
        """Write a current set-point [A] in torque mode."""
        self.commanded_speed = self.speed_limit
        choose(self.board, "cmd.mode", self.axis, "TORQUE")
        write_axis(self.board, "cmd.i_q", self.axis, current)

    def quick_stop(self) -> None:
        write_axis(self.board, "cmd.quick_stop", self.axis, 1.0)

    def load(self, part: float) -> None:
        """Set the load torque, as a part of the torque at the current limit."""
        self.load_torque = part * self.current * self.motor.torque_constant
        self.board.set_load(self.axis, self.load_torque)

    def load_pulse(self, part: float) -> None:
        """Set a load that opposes the motion for positive `part`, if the axis is in SPIN."""
        if self.place == "SPIN":
            self.load(math.copysign(part, self.board.truth(self.axis).omega_m))

    def provoke(self, sign: float) -> None:
        """Command the axis to move, regardless of earlier commands."""
        self.load(0.0)
        write_axis(self.board, "cmd.quick_stop", self.axis, 0.0)
        self.enable()
        self.speed(sign * (PROVOKED_SPEED_SENSORLESS if self.sensorless else PROVOKED_SPEED) * self.speed_limit)

    # ---- preparation of states
    def boot(self) -> None:
        """From reset to STOP, with the other axis rotating."""
        self.board.write("param.host_timeout", 30.0)
        self.board.run(BOOT)
        if self.sensorless:
            choose(self.board, "param.feedback", self.axis, "OBSERVER")
        write_axis(self.board, "cmd.enable", self.other, 1.0)
        self.until("SPIN of the other axis", lambda: place(self.board, self.other) == "SPIN")
        choose(self.board, "cmd.mode", self.other, "SPEED")
        write_axis(self.board, "cmd.speed", self.other, self.other_speed)
        self.board.run(0.2)

    def hold(self) -> None:
        self.enable()
        self.until("SPIN", lambda: self.place == "SPIN")
        self.board.run(rig.SETTLED)

    def turning(self, speed: float) -> None:
        """Rotate at a constant speed [rad/s], with encoder or sensorless."""
        if self.sensorless:
            self.enable()
            self.speed(speed)
            self.until("SPIN", lambda: self.place == "SPIN")
        else:
            self.hold()
            self.speed(speed)
        self.board.run(abs(speed) / self.acceleration + 0.15)


Event = tuple[float, Callable[[], None]]
"""Time of an action [s], and the action."""


@dataclass(frozen=True)
class Script:
    """Stimulus after a state has been reached."""

    window: float  # the fault is injected within this time [s]
    events: list[Event] = field(default_factory=list)  # actions during and after this time
    wait: float = 0.7  # time for the detection [s]


@dataclass(frozen=True)
class State:
    """Operating state of an axis."""

    name: str
    begin: Callable[[Bench, random.Random], Script]  # brings a new board into the state
    sensorless: bool = False  # uses the observer
    calibrated: bool = True  # the offsets of the current amplifiers have been measured
    aligned: bool = True  # the rotor position is known, the next motion needs no rotor search


def _sign(rng: random.Random) -> float:
    return rng.choice((-1.0, 1.0))


def _part(bench: Bench, rng: random.Random, minimum: float, maximum: float) -> float:
    slowest = max(minimum, bench.slowest) if bench.sensorless else minimum
    return _sign(rng) * rng.uniform(slowest, maximum) * bench.speed_limit


def _power_on(bench: Bench, rng: random.Random) -> Script:
    bench.board.write("param.host_timeout", 30.0)
    return Script(BOOT, [(rng.uniform(0.0, 2.0 * BOOT), bench.enable)])


def _stop(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    return Script(0.1)


def _calib(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    return Script(0.05, [(0.0, bench.enable)])


def _search(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.enable()
    bench.until("ALIGN", lambda: bench.place == "ALIGN")
    return Script(1.0)


def _hold(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.hold()
    return Script(0.2)


def _move(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.hold()
    turns = _sign(rng) * 10.0 ** rng.uniform(-1.5, 1.0)
    return Script(0.6, [(0.0, lambda: bench.turn(turns))])


def _constant(minimum: float, maximum: float, load: float = 0.0) -> Callable[[Bench, random.Random], Script]:
    """Constant speed in a range relative to the limit. The load brakes, as the bus cannot absorb energy for long."""

    def begin(bench: Bench, rng: random.Random) -> Script:
        bench.boot()
        speed = _part(bench, rng, minimum, maximum)
        bench.turning(speed)
        part = math.copysign(rng.uniform(0.5 * load, load), speed)
        for k in range(LOAD_STEPS):
            bench.load(part * (k + 1) / LOAD_STEPS)
            bench.board.run(0.005)
        return Script(0.3)

    return begin


def _acceleration(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.hold()
    speed = _part(bench, rng, 0.3, 1.0)
    return Script(abs(speed) / bench.acceleration + 0.05, [(0.0, lambda: bench.speed(speed))])


def _reversal(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    speed = _part(bench, rng, 0.2, 0.8)
    bench.turning(speed)
    return Script(2.0 * abs(speed) / bench.acceleration + 0.05, [(0.0, lambda: bench.speed(-speed))])


def _braking(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    speed = _part(bench, rng, 0.3, 1.0)
    bench.turning(speed)
    how = rng.choice((lambda: bench.speed(0.0), bench.quick_stop, lambda: bench.enable(False)))
    return Script(abs(speed) / bench.acceleration + 0.05, [(0.0, how)])


def _torque(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.hold()
    friction = bench.motor.friction / bench.motor.torque_constant
    current = _sign(rng) * (friction + rng.uniform(0.05, 0.4) * bench.current)
    return Script(0.3, [(0.0, lambda: bench.torque(current))])


def _coasting(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.turning(_part(bench, rng, 0.1, 1.0))
    choose(bench.board, "param.on_disable", bench.axis, "COAST")
    bench.enable(False)
    return Script(0.3)


def _swinging(bench: Bench, rng: random.Random) -> Script:
    """Sinusoidal speed set-points."""
    bench.boot()
    bench.hold()
    speed, frequency = _part(bench, rng, 0.1, 0.6), rng.uniform(2.0, 10.0)
    step = 0.005

    def at(k: int) -> Event:
        return k * step, lambda: bench.speed(speed * math.sin(2.0 * math.pi * frequency * k * step))

    return Script(0.5, [at(k) for k in range(round(1.5 / step))])


def _rest(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.enable()
    return Script(0.2)


def _start_up(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    bench.enable()
    choose(bench.board, "cmd.mode", bench.axis, "SPEED")
    bench.board.run(0.1)
    speed = _part(bench, rng, 0.1, 0.5)
    return Script(0.8, [(0.0, lambda: bench.speed(speed))])


def _observed_change(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    speed = _part(bench, rng, 0.1, 0.9)
    bench.turning(speed)
    another = math.copysign(_part(bench, rng, 0.1, 0.9), speed)
    change = abs(another - speed) / bench.acceleration
    return Script(change + 0.05, [(0.0, lambda: bench.speed(another))])


def _observed_stop(bench: Bench, rng: random.Random) -> Script:
    bench.boot()
    speed = _part(bench, rng, 0.1, 0.9)
    bench.turning(speed)
    another = rng.choice((0.0, -speed))
    return Script(abs(speed) / bench.acceleration + 0.1, [(0.0, lambda: bench.speed(another))])


STATES: Final[Mapping[str, State]] = {
    state.name: state
    for state in (
        State("power-on", _power_on, calibrated=False, aligned=False),
        State("stop", _stop, calibrated=False, aligned=False),
        State("calibration", _calib, calibrated=False, aligned=False),
        State("rotor search", _search, aligned=False),
        State("hold", _hold),
        State("position move", _move),
        State("low speed", _constant(0.01, 0.08)),
        State("high speed", _constant(0.5, 1.0)),
        State("under load", _constant(0.1, 0.6, load=0.5)),
        State("acceleration", _acceleration),
        State("reversal", _reversal),
        State("braking", _braking, aligned=False),
        State("torque", _torque),
        State("coasting", _coasting, aligned=False),
        State("swinging", _swinging),
        State("observer, rest", _rest, sensorless=True, calibrated=False, aligned=False),
        State("observer, start-up", _start_up, sensorless=True),
        State("observer, speed", _constant(0.06, 0.95), sensorless=True),
        State("observer, under load", _constant(0.2, 0.6, load=0.25), sensorless=True),
        State("observer, change", _observed_change, sensorless=True),
        State("observer, stop", _observed_stop, sensorless=True),
    )
}
"""Operating states by name."""


# ---- trials without a fault
LENGTH: Final = 3.0  # [s]


def _ripple(bench: Bench, rng: random.Random) -> list[Event]:
    """Sinusoidal variation of the supply by 2 V."""
    frequency, step = rng.uniform(50.0, 300.0), 0.001

    def at(k: int) -> Event:
        volts = 24.0 + 2.0 * math.sin(2.0 * math.pi * frequency * k * step)
        return k * step, lambda: bench.board.set_supply(volts)

    return [at(k) for k in range(round(LENGTH / step))]


def _command(bench: Bench, rng: random.Random) -> Callable[[], None]:
    """Random valid command."""
    speed = _part(bench, rng, 0.0, 1.0)
    turns = _sign(rng) * 10.0 ** rng.uniform(-2.0, 1.0)
    current = rng.uniform(-1.0, 1.0) * bench.current
    return rng.choice(
        (
            lambda: bench.speed(speed),
            lambda: bench.speed(speed),
            lambda: bench.turn(turns),
            lambda: bench.torque(current),
            bench.quick_stop,
            lambda: bench.enable(False),
        )
    )


def _manoeuvres(bench: Bench, rng: random.Random) -> Script:
    """Sequence of random commands, without waiting for completion, and load pulses."""
    bench.boot()
    bench.hold()
    events, moment = _ripple(bench, rng), 0.0
    while moment < LENGTH:
        events.append((moment, _command(bench, rng)))
        events.append((moment + 1e-3, bench.enable))  # also after a disable command
        events.append((moment + 1e-3, lambda: write_axis(bench.board, "cmd.quick_stop", bench.axis, 0.0)))
        torque, length = rng.uniform(-0.4, 0.4), rng.uniform(0.005, 0.1)
        events.append((moment + 0.01, lambda torque=torque: bench.load_pulse(torque)))  # type: ignore[misc]
        events.append((moment + 0.01 + length, lambda: bench.load(0.0)))
        moment += rng.uniform(0.12, 0.5)
    return Script(0.0, events, LENGTH)


def _observed_manoeuvres(bench: Bench, rng: random.Random) -> Script:
    """Random speeds of both signs, stops, and small load pulses."""
    bench.boot()
    bench.turning(_part(bench, rng, 0.1, 0.9))
    events, moment = _ripple(bench, rng), 0.0
    while moment < LENGTH:
        speed = rng.choice((_part(bench, rng, 0.2, 0.95), _part(bench, rng, 0.2, 0.95), 0.0))
        torque, length = rng.uniform(-0.1, 0.1), rng.uniform(0.005, 0.1)
        events.append((moment, lambda speed=speed: bench.speed(speed)))  # type: ignore[misc]
        events.append((moment + 0.3, lambda torque=torque: bench.load_pulse(torque)))  # type: ignore[misc]
        events.append((moment + 0.3 + length, lambda: bench.load(0.0)))
        moment += rng.uniform(0.45, 1.5)
    return Script(0.0, events, LENGTH)


MANOEUVRES: Final[Mapping[str, State]] = {
    state.name: state
    for state in (
        State("manoeuvres", _manoeuvres),
        State("observer, manoeuvres", _observed_manoeuvres, sensorless=True),
    )
}
"""States for trials without a fault."""
