"""Switches, enable input and holding brake: hanging load, limit switch at speed, broken wires."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.axis_config_transfer import read_block, send_configuration
from servo_msgs_py.board_port import active, choose, place, word, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS, TICK

from servo_twin.board import Board
from servo_twin.fault_injection import CutWire, Pin
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import COUNT

NAME: Final = "pins"
HELP: Final = """\
Beyond the reference design, which has none of these pins. A hanging load on a shaft with a holding brake: its drop
when the drive is enabled for the first time, which includes the rotor search; later, with a known angle; when it is
disabled; and with a fault. The enable input is opened at full speed: PWM periods until the outputs are off. A limit
switch is reached at speed: the overtravel, and that only the way off it is permitted. Every wire is broken once."""

LOAD: Final = 0.2
"""Hanging load, relative to the largest torque of the rotor search."""
SEARCH_CURRENT: Final = 4.0  # current of the rotor search in the configuration [A]
BRAKE: Final = 0.6  # torque of the brake, relative to the largest torque of the rotor search
OPEN_TIME: Final = 0.03  # opening time of the brake [s]
CLOSE_TIME: Final = 0.02  # closing time of the brake [s]
OPEN_NOMINAL: Final = 0.04  # configured opening time, longer than the true one [s]
CLOSE_NOMINAL: Final = 0.03  # configured closing time [s]
ANGLES: Final = 4  # number of start angles of the rotor

FIRST_DROP: Final = 0.5
"""Permitted drop during the rotor search under load: a rotor opposite to the vector rotates with the load [rad]."""
TRANSFER_DROP_MAX: Final = 6.0 * COUNT
"""Permitted drop at the load transfer between brake and position control [rad]."""
BRAKE_DELAY: Final = 2.0 * TICK  # time from a fault to the de-energised coil of the brake [s]

FULL_SPEED: Final = 300.0  # [rad/s]
ACCELERATION: Final = 4000.0  # deceleration of a stop, servo.toml [rad/s^2]
REACTION_TIME: Final = 4.0 * TICK  # reaction time: filter of a switch, start of the stop with the next slow loop [s]
AWAY: Final = 20.0  # from the start to the switch [rad]
LAG: Final = 0.004  # lag of the speed loop behind the ramp [s]


def fit(board: Board, *pins: Pin) -> None:
    """Configure the pins of both axes of a board at standstill."""
    flags = {flag.name.lower(): flag.mask for flag in board.catalogue.flags["inputs"]}
    changed = {
        "pins.fitted": sum(flags["brake_open" if pin == "brake" else pin] for pin in pins),
        "pins.open_ticks": round(OPEN_NOMINAL / TICK),
        "pins.close_ticks": round(CLOSE_NOMINAL / TICK),
    }
    send_configuration(board, {axis: {**read_block(board, axis), **changed} for axis in range(AXES)})
    board.run(10.0 * TICK)


@contextmanager
def fitted(plant: PlantConfig, seed: int, *pins: Pin) -> Iterator[Board]:
    """New board in STOP with these pins on both axes."""
    with rig.fresh_board(plant, seed) as board:
        board.run(0.03)
        fit(board, *pins)
        yield board


def wired(plant: PlantConfig, **pins: float) -> PlantConfig:
    """Plant with devices at the pins of both axes."""
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, pins=replace(entry.pins, **pins))
    return plant


def _until(board: Board, what: str, holds: Callable[[Board, int], bool], seconds: float = 3.0) -> None:
    """Run until a condition holds for both axes."""
    rig.until(board, what, lambda: all(holds(board, axis) for axis in range(AXES)), seconds, 0.005)


def _enable(board: Board) -> None:
    board.write("cmd.enable", [1] * AXES)
    _until(board, "both axes in SPIN, their brakes open", _ready)


def _ready(board: Board, axis: int) -> bool:
    brake = board.truth(axis).brake_holds == 0.0 or board.plant.axes[axis].pins.brake_torque == 0.0
    return place(board, axis) == "SPIN" and brake


# ---- hanging load --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LoadDrops:
    """Drops of hanging loads, and motion during the first enable."""

    drops: list[tuple[float, ...]]
    """By axis: first enable, second enable, disable, and switch-off by the enable input [rad]."""
    motions: Trace  # motion of the shaft of each axis during the first enable [rad]


def _motions(board: Board, seconds: float) -> Trace:
    """Motion of the shafts from now on, one column per axis, every millisecond [rad]."""
    start = [board.truth(axis).theta_m for axis in range(AXES)]
    motions = []
    for _ in range(round(seconds / 0.001)):
        board.run(0.001)
        motions.append([board.truth(axis).theta_m - start[axis] for axis in range(AXES)])
    return Trace(0.001, dict(zip(map(axis_name, range(AXES)), np.array(motions).T, strict=True)), first=1)


def load_of(plant: PlantConfig, axis: int) -> float:
    """Torque of the hanging load [N m]."""
    return LOAD * SEARCH_CURRENT * plant.axes[axis].torque_constant


def measure_drops(plant: PlantConfig, seed: int, angle: float) -> LoadDrops:
    """Hanging loads on both shafts; rotors at `angle` from the first vector of the search, electrical [rad]."""
    for axis, entry in enumerate(plant.axes):
        pins = replace(
            entry.pins,
            brake_torque=BRAKE * SEARCH_CURRENT * entry.torque_constant,
            brake_open_time=OPEN_TIME,
            brake_close_time=CLOSE_TIME,
        )
        plant = plant.with_axis(axis, theta_start=angle / entry.pole_pairs, pins=pins)
    with fitted(plant, seed, "brake", "enable") as board:
        for axis in range(AXES):
            board.set_load(axis, load_of(plant, axis))
        board.write("cmd.enable", [1] * AXES)
        first = _motions(board, 1.2)
        _until(board, "SPIN after the search", _ready)
        board.write("cmd.enable", [0] * AXES)
        off = _motions(board, 0.3)
        _until(board, "STOP", lambda board, axis: place(board, axis) == "STOP")
        board.run(0.3)  # an enable requires standstill
        board.write("cmd.enable", [1] * AXES)
        again = _motions(board, 0.4)
        _until(board, "SPIN again", _ready)
        for axis in range(AXES):
            board.inject(CutWire(axis, "enable"))
        fault = _motions(board, 0.2)
    drops = [
        tuple(float(np.abs(motions[axis_name(axis)]).max()) for motions in (first, again, off, fault))
        for axis in range(AXES)
    ]
    return LoadDrops(drops, first)


def fault_drop(plant: PlantConfig, axis: int) -> float:
    """Bound of the drop with a fault: free fall until the brake closes, then deceleration by the brake [rad]."""
    entry, load = plant.axes[axis], load_of(plant, axis)
    falling = CLOSE_TIME + BRAKE_DELAY
    speed = load / entry.inertia * falling
    held = (BRAKE - LOAD) * SEARCH_CURRENT * entry.torque_constant / entry.inertia
    return 0.5 * speed * falling + speed**2 / (2.0 * held)


# ---- the enable input at speed -------------------------------------------------------------------------------------


_TRACE_GATES: Final = 3  # chip/trace.h
_CLOCK_NS: Final = 10


def open_enable(plant: PlantConfig, seed: int) -> tuple[float, bool]:
    """Cut the wire of the enable circuit of axis 1 at full speed.

    Returns
    -------
    switches : float
        PWM periods until the last switch of the inverter changes; 0 at level ideal.
    named : bool
        True if ENABLE_INPUT, and no other fault, is reported 5 ms later.
    """
    with fitted(plant, seed, "enable") as board:
        _enable(board)
        rig.set_up(board, 0, "SPEED", FULL_SPEED)
        board.run(0.4)
        now = board.time_ns + PERIOD_NS
        before = board.trace(now)["clock"]
        board.inject(CutWire(0, "enable"))
        log = board.trace(now + 80 * PERIOD_NS)
        gates = log["clock"][(log["kind"] == _TRACE_GATES) & (log["a"] < 3)]
        board.run(0.001)
        periods = (int(gates[-1]) - int(before[-1])) * _CLOCK_NS / PERIOD_NS if gates.size else 0.0
        return periods, active(board, 0, "faults") == {"ENABLE_INPUT"}


# ---- a limit switch at speed ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Overrun:
    """Run into a limit switch at speed."""

    beyond: float  # overtravel [rad]
    named: bool  # LIMIT_SWITCH, and no other fault, is reported
    into: float  # motion after a set-point beyond the switch [counts]
    off: float  # motion after a set-point back from the switch [counts]


def overrun(plant: PlantConfig, seed: int) -> list[Overrun]:
    """Run both axes into their upper limit switches, then command motion beyond and back."""
    start = [entry.theta_start if entry.theta_start != "random" else 0.0 for entry in plant.drawn(seed).axes]
    at = [angle + AWAY for angle in start]
    for axis, entry in enumerate(plant.axes):
        pins = replace(entry.pins, limit_max=at[axis])
        plant = plant.with_axis(axis, theta_start=start[axis], pins=pins)
    with fitted(plant, seed, "limit_min", "limit_max") as board:
        _enable(board)
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", FULL_SPEED)
        _until(board, "the stop at the switches", lambda board, axis: place(board, axis) == "FAULT")
        beyond = [board.truth(axis).theta_m - at[axis] for axis in range(AXES)]
        named = [active(board, axis, "faults") == {"LIMIT_SWITCH"} for axis in range(AXES)]
        board.run(0.2)
        board.write("cmd.clear_faults", [1] * AXES)
        board.run(0.1)
        _enable(board)
        board.run(0.2)
        motions = []
        for turns in (1.0, -1.0):
            here = [word(board, axis, "position") for axis in range(AXES)]
            for axis in range(AXES):
                choose(board, "cmd.mode", axis, "POSITION")
                write_word(board, "cmd.position", axis, here[axis] + round(turns * 4000))
            board.run(0.8)
            motions.append([abs(word(board, axis, "position") - here[axis]) for axis in range(AXES)])
    return [Overrun(beyond[k], named[k], motions[0][k], motions[1][k]) for k in range(AXES)]


# ---- broken wires --------------------------------------------------------------------------------------------------


def cut_wires(plant: PlantConfig, seed: int) -> dict[str, bool]:
    """Reaction to each broken wire in position hold of axis 1, and of the enable circuit at standstill."""
    results: dict[str, bool] = {}
    plant = wired(plant, home_from=-1e6, home_to=1e6)
    expected: dict[Pin, set[str]] = {
        "home": set(),
        "limit_min": {"LIMIT_SWITCH"},
        "limit_max": {"LIMIT_SWITCH"},
        "enable": {"ENABLE_INPUT"},
    }
    for pin, faults in expected.items():
        with fitted(plant, seed, "home", "limit_min", "limit_max", "enable") as board:
            _enable(board)
            board.run(0.1)
            board.inject(CutWire(0, pin))
            board.run(0.1)
            inputs = {"home": "HOME", "enable": "ENABLE"}.get(pin, pin.upper())
            seen = (inputs in active(board, 0, "inputs")) == (pin in ("limit_min", "limit_max"))
            results[f"{pin}, holding"] = (
                active(board, 0, "faults") == faults and seen and not active(board, 1, "faults")
            )
    with fitted(plant, seed, "enable") as board:
        board.inject(CutWire(0, "enable"))
        board.run(0.01)
        board.write("cmd.enable", [1, 0])
        board.run(0.1)
        refused = place(board, 0) == "STOP" and not active(board, 0, "faults") and "INPUT" in active(board, 0, "limits")
        board.clear_fault()
        board.run(0.1)
        results["enable, at rest: refused without a fault"] = refused and place(board, 0) == "STOP"
        board.write("cmd.enable", [1, 0])
        board.run(0.05)
        results["enable, restored: enabled by a new command"] = (
            board.catalogue.label("state_t", word(board, 0, "state")) == "RUN"
        )
    return results


# ---- the experiment ------------------------------------------------------------------------------------------------


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Hanging loads from several angles, enable input and limit switch at speed, broken wires."""
    load_drops = [measure_drops(plant, seed, 2.0 * math.pi * (k + 0.5) / ANGLES) for k in range(ANGLES)]
    for axis in range(AXES):
        judge = Judge(f"{axis_name(axis)}, load of {load_of(plant, axis) * 1e3:.0f} mN m: drop, ")
        first, again, off, fault = (max(drops) for drops in zip(*(h.drops[axis] for h in load_drops), strict=True))
        yield judge("first enable", first, "rad", maximum=FIRST_DROP, apart=0.1)
        yield judge("repeated enable", again, "rad", maximum=TRANSFER_DROP_MAX)
        yield judge("disabled", off, "rad", maximum=TRANSFER_DROP_MAX)
        yield judge("enable input opened", fault, "rad", maximum=fault_drop(plant, axis))
    switches, named = open_enable(plant, seed)
    judge = Judge("enable input at full speed: ")
    yield judge("time until the switches open", switches, "PWM periods", 0.0, 1.0)
    yield judge.true("fault reported", named)
    maximum = FULL_SPEED**2 / (2.0 * ACCELERATION) + FULL_SPEED * (REACTION_TIME + LAG)
    for axis, found in enumerate(overrun(plant, seed)):
        judge = Judge(f"{axis_name(axis)}, limit switch at {FULL_SPEED:.0f} rad/s: ")
        yield judge("overtravel", found.beyond, "rad", 0.0, maximum)
        yield judge.true("fault reported", found.named)
        yield judge("motion by a set-point beyond the switch", found.into, "counts", maximum=2.0)
        yield judge("motion by a set-point off the switch", found.off, "counts", 3990.0, 4010.0)
    for what, right in cut_wires(plant, seed).items():
        yield Judge("wire cut: ").true(what, right)
    curves = [
        Curve(f"{name}, {360.0 * (k + 0.5) / ANGLES:.0f} deg", h.motions.time, np.degrees(angle))
        for k, h in enumerate(load_drops)
        for name, angle in h.motions.columns.items()
    ]
    yield Panel("hanging load on the shaft: first enable", "time [s]", "shaft [deg]", curves)
    yield f"brake: opens in {OPEN_TIME * 1e3:.0f} ms, closes in {CLOSE_TIME * 1e3:.0f} ms"
    yield f"drops: the largest of {ANGLES} angles of the rotor"
