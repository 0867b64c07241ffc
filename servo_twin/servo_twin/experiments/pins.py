"""Switches, enable input and holding brake: a load that must not drop, a switch at speed, wires that are cut."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.axis_config_transfer import read_block, send_block, take_blocks
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board
from servo_twin.experiments import rig
from servo_twin.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.experiments.rig import COUNT, TICK
from servo_twin.fault_injection import CutWire, Pin
from servo_twin.lockstep.replica import Replica
from servo_twin.plant import PlantConfig

NAME: Final = "pins"
HELP: Final = """\
Beyond the reference design, which has none of these pins. A hanging load on a shaft with a holding brake: its drop
when the drive is enabled for the first time, which includes the rotor search; later, with a known angle; when it is
disabled; and with a fault. The enable input is opened at full speed: PWM periods until the outputs are off. A limit
switch is reached at speed: the overtravel, and that only the way off it is permitted. Every wire is broken once."""

LOAD: Final = 0.2
"""That hangs on the shaft, of the rotor search's largest torque."""
SEARCH_CURRENT: Final = 4.0  # of the configuration [A]
BRAKE: Final = 0.6  # torque of the brake, of the same
OPEN_TIME: Final = 0.03  # of the brake [s]
CLOSE_TIME: Final = 0.02
OPEN_NOMINAL: Final = 0.04  # the configuration waits longer: servo.toml [s]
CLOSE_NOMINAL: Final = 0.03
ANGLES: Final = 4  # at which a rotor starts

FIRST_DROP: Final = 0.5
"""While the rotor is searched under load: a rotor opposite to the vector turns until that has come round [rad]."""
HELD_DROP: Final = 6.0 * COUNT
"""While the position is controlled and the brake hands over the load [rad]."""
LATE: Final = 2.0 * TICK  # until the brake's coil is off after a fault [s]

FULL_SPEED: Final = 300.0  # [rad/s]
ACCELERATION: Final = 4000.0  # of a stop, servo.toml [rad/s^2]
SEEN: Final = 4.0 * TICK  # a switch is filtered, the stop begins with the next slow loop [s]
AWAY: Final = 20.0  # from the start to the switch [rad]
LAG: Final = 0.004  # of the speed loop behind its ramp [s]


def fit(board: Board, *pins: Pin) -> None:
    """Tell the firmware which pins both axes of a board at rest have."""

    def wait() -> bool:
        board.run(TICK)
        return True

    replica = Replica(board)
    flags = {flag.name.lower(): flag.mask for flag in board.catalogue.flags["inputs"]}
    changed = {
        "pins.fitted": sum(flags["brake_open" if pin == "brake" else pin] for pin in pins),
        "pins.open_ticks": round(OPEN_NOMINAL / TICK),
        "pins.close_ticks": round(CLOSE_NOMINAL / TICK),
    }
    for axis in range(AXES):
        send_block(replica, axis, {**read_block(replica, axis), **changed})
    take_blocks(replica, range(AXES), wait)
    board.run(10.0 * TICK)


@contextmanager
def fitted(plant: PlantConfig, seed: int, *pins: Pin) -> Iterator[Board]:
    """A fresh board in STOP whose axes have these pins."""
    with rig.fresh_board(plant, seed) as board:
        board.run(0.03)
        fit(board, *pins)
        yield board


def wired(plant: PlantConfig, **pins: float) -> PlantConfig:
    """The plant with something at the pins of both axes."""
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, pins=replace(entry.pins, **pins))
    return plant


def _in(board: Board, axis: int, state: str, substate: str | None = None) -> bool:
    enums = board.catalogue.enums
    found = rig.word(board, axis, "state") == enums["state_t"][state]
    if substate is None:
        return found
    return found and rig.word(board, axis, "substate") == enums["substate_t"][substate]


def _until(board: Board, what: str, holds: Callable[[Board, int], bool], seconds: float = 3.0) -> None:
    """Run until something holds for both axes."""
    rig.until(board, what, lambda: all(holds(board, axis) for axis in range(AXES)), seconds, 0.005)


def _enable(board: Board) -> None:
    board.write("cmd.enable", [1] * AXES)
    _until(board, "both axes in SPIN, their brakes open", _ready)


def _ready(board: Board, axis: int) -> bool:
    brake = board.truth(axis).brake_holds == 0.0 or board.plant.axes[axis].pins.brake_torque == 0.0
    return _in(board, axis, "RUN", "SPIN") and brake


# ---- a load that hangs ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Hang:
    """How far loads have dropped, and their ways while the drive was enabled for the first time."""

    drops: list[tuple[float, ...]]
    """By axis: enabled for the first time, again, disabled, and switched off by the enable input [rad]."""
    time: NDArray[np.float64]  # of the first enabling [s]
    ways: NDArray[np.float64]  # shafts meanwhile, one row per axis [rad]


def _ways(board: Board, seconds: float) -> NDArray[np.float64]:
    """Ways of the shafts from where they are now, one row per axis, every millisecond [rad]."""
    start = [board.truth(axis).theta_m for axis in range(AXES)]
    ways = []
    for _ in range(round(seconds / 0.001)):
        board.run(0.001)
        ways.append([board.truth(axis).theta_m - start[axis] for axis in range(AXES)])
    return np.asarray(np.array(ways).T)


def load_of(plant: PlantConfig, axis: int) -> float:
    """What hangs on a shaft [N m]."""
    return LOAD * SEARCH_CURRENT * plant.axes[axis].torque_constant


def hang(plant: PlantConfig, seed: int, angle: float) -> Hang:
    """Loads on both shafts from the start on; rotors `angle` off the vector of their searches, electrical [rad]."""
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
        first = _ways(board, 1.2)
        _until(board, "SPIN after the search", _ready)
        board.write("cmd.enable", [0] * AXES)
        off = _ways(board, 0.3)
        _until(board, "STOP", lambda board, axis: _in(board, axis, "STOP"))
        board.run(0.3)  # an axis waits for a shaft that rests
        board.write("cmd.enable", [1] * AXES)
        again = _ways(board, 0.4)
        _until(board, "SPIN again", _ready)
        for axis in range(AXES):
            board.inject(CutWire(axis, "enable"))
        fault = _ways(board, 0.2)
    drops = [tuple(float(np.abs(ways[axis]).max()) for ways in (first, again, off, fault)) for axis in range(AXES)]
    return Hang(drops, 0.001 * np.arange(1, first.shape[1] + 1), first)


def fault_drop(plant: PlantConfig, axis: int) -> float:
    """Bound of the drop with a fault: free fall until the brake holds, then against it [rad]."""
    entry, load = plant.axes[axis], load_of(plant, axis)
    falling = CLOSE_TIME + LATE
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
        PWM periods until the last switch of its inverter changes; 0 where there is no chip to look at.
    named : bool
        ENABLE_INPUT, and nothing else, 5 ms later.
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
        return periods, rig.flags_of(board, 0, "faults") == {"ENABLE_INPUT"}


# ---- a limit switch at speed ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Overrun:
    """A switch that an axis reaches at speed."""

    beyond: float  # way past the switch [rad]
    named: bool  # LIMIT_SWITCH, and nothing else
    into: float  # way after a set-point beyond the switch [counts]
    off: float  # way after one back [counts]


def overrun(plant: PlantConfig, seed: int) -> list[Overrun]:
    """Both axes run into their upper limit switches, and are sent on, and back."""
    start = [entry.theta_start if entry.theta_start != "random" else 0.0 for entry in plant.drawn(seed).axes]
    at = [angle + AWAY for angle in start]
    for axis, entry in enumerate(plant.axes):
        pins = replace(entry.pins, limit_max=at[axis])
        plant = plant.with_axis(axis, theta_start=start[axis], pins=pins)
    with fitted(plant, seed, "limit_min", "limit_max") as board:
        _enable(board)
        for axis in range(AXES):
            rig.set_up(board, axis, "SPEED", FULL_SPEED)
        _until(board, "the stop at the switches", lambda board, axis: _in(board, axis, "FAULT"))
        beyond = [board.truth(axis).theta_m - at[axis] for axis in range(AXES)]
        named = [rig.flags_of(board, axis, "faults") == {"LIMIT_SWITCH"} for axis in range(AXES)]
        board.run(0.2)
        board.write("cmd.clear_faults", [1] * AXES)
        board.run(0.1)
        _enable(board)
        board.run(0.2)
        ways = []
        for turns in (1.0, -1.0):
            here = [rig.position_of(board, axis) for axis in range(AXES)]
            for axis in range(AXES):
                rig.choose_mode(board, axis, "POSITION")
                rig.command_position(board, axis, here[axis] + round(turns * 4000))
            board.run(0.8)
            ways.append([abs(rig.position_of(board, axis) - here[axis]) for axis in range(AXES)])
    return [Overrun(beyond[k], named[k], ways[0][k], ways[1][k]) for k in range(AXES)]


# ---- cut wires -----------------------------------------------------------------------------------------------------


def cut_wires(plant: PlantConfig, seed: int) -> dict[str, bool]:
    """What the board says of each wire that is cut while axis 1 holds, and of the enable circuit's at rest."""
    said: dict[str, bool] = {}
    plant = wired(plant, home_from=-1e6, home_to=1e6)
    wanted: dict[Pin, set[str]] = {
        "home": set(),
        "limit_min": {"LIMIT_SWITCH"},
        "limit_max": {"LIMIT_SWITCH"},
        "enable": {"ENABLE_INPUT"},
    }
    for pin, faults in wanted.items():
        with fitted(plant, seed, "home", "limit_min", "limit_max", "enable") as board:
            _enable(board)
            board.run(0.1)
            board.inject(CutWire(0, pin))
            board.run(0.1)
            inputs = {"home": "HOME", "enable": "ENABLE"}.get(pin, pin.upper())
            seen = (inputs in rig.flags_of(board, 0, "inputs")) == pin.startswith("limit")
            said[f"{pin}, holding"] = (
                rig.flags_of(board, 0, "faults") == faults and seen and not rig.flags_of(board, 1, "faults")
            )
    with fitted(plant, seed, "enable") as board:
        board.inject(CutWire(0, "enable"))
        board.run(0.01)
        board.write("cmd.enable", [1, 0])
        board.run(0.1)
        refused = (
            _in(board, 0, "STOP")
            and not rig.flags_of(board, 0, "faults")
            and "INPUT" in rig.flags_of(board, 0, "limits")
        )
        board.clear_fault()
        board.run(0.1)
        said["enable, at rest: refused without a fault"] = refused and _in(board, 0, "STOP")
        board.write("cmd.enable", [1, 0])
        board.run(0.05)
        said["enable, whole again: enabled by a new command"] = _in(board, 0, "RUN")
    return said


# ---- the experiment ------------------------------------------------------------------------------------------------


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Hanging loads from several angles, the enable input and a limit switch at speed, cut wires."""
    hangs = [hang(plant, seed, 2.0 * math.pi * (k + 0.5) / ANGLES) for k in range(ANGLES)]
    for axis in range(AXES):
        judge = Judge(f"{axis_name(axis)}, load of {load_of(plant, axis) * 1e3:.0f} mN m: drop, ")
        first, again, off, fault = (max(drops) for drops in zip(*(h.drops[axis] for h in hangs), strict=True))
        yield judge("first enabling", first, "rad", maximum=FIRST_DROP, apart=0.1)
        yield judge("enabled again", again, "rad", maximum=HELD_DROP)
        yield judge("disabled", off, "rad", maximum=HELD_DROP)
        yield judge("enable input opened", fault, "rad", maximum=fault_drop(plant, axis))
    switches, named = open_enable(plant, seed)
    judge = Judge("enable input at full speed: ")
    yield judge("switches open after", switches, "PWM periods", 0.0, 1.0)
    yield judge.true("named", named)
    maximum = FULL_SPEED**2 / (2.0 * ACCELERATION) + FULL_SPEED * (SEEN + LAG)
    for axis, found in enumerate(overrun(plant, seed)):
        judge = Judge(f"{axis_name(axis)}, limit switch at {FULL_SPEED:.0f} rad/s: ")
        yield judge("beyond", found.beyond, "rad", 0.0, maximum)
        yield judge.true("named", found.named)
        yield judge("sent on, moves", found.into, "counts", maximum=2.0)
        yield judge("sent back, moves", found.off, "counts", 3990.0, 4010.0)
    for what, right in cut_wires(plant, seed).items():
        yield Judge("wire cut: ").true(what, right)
    curves = [
        Curve(f"{axis_name(axis)}, {360.0 * (k + 0.5) / ANGLES:.0f} deg", h.time, np.degrees(h.ways[axis]))
        for k, h in enumerate(hangs)
        for axis in range(AXES)
    ]
    yield Panel("a load hangs on the shaft: first enabling", "time [s]", "shaft [deg]", curves)
    yield f"brake: opens in {OPEN_TIME * 1e3:.0f} ms, closes in {CLOSE_TIME * 1e3:.0f} ms"
    yield f"drops: the largest of {ANGLES} angles of the rotor"
