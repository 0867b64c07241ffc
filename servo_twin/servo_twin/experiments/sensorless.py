"""The bench of the experiments without an encoder: boards whose axes start on the observer, and what it sees."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board
from servo_twin.experiments.rig import TICK, TICK_NS, choose_mode, command_speed, fresh_board, get_axis, word
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError

BOOT: Final = 0.03  # reset to STOP [s]
START_MAX: Final = 3.0  # of a start-up [s]
LOOK: Final = 0.01  # between two looks at the state [s]


@dataclass(frozen=True)
class Trace:
    """One axis over time, one entry per slow tick."""

    time: NDArray[np.float64]  # since the beginning [s]
    theta_e: NDArray[np.float64]  # truth of the plant: electrical angle [rad]
    omega: NDArray[np.float64]  # truth: mechanical speed [rad/s]
    i_d: NDArray[np.float64]  # truth [A]
    i_q: NDArray[np.float64]  # truth [A]
    angle: NDArray[np.float64]  # of the observer: electrical angle [rad]
    speed: NDArray[np.float64]  # of the observer: mechanical speed [rad/s]
    used: NDArray[np.float64]  # electrical angle that the controllers use [rad]
    speed_ref: NDArray[np.float64]  # [rad/s]
    substate: NDArray[np.int64]  # words of the firmware
    faults: NDArray[np.int64]  # likewise

    def part(self, start: float, end: float | None = None) -> Trace:
        """Ticks after `start` and up to `end` [s]."""
        ticks = slice(round(start / TICK), None if end is None else round(end / TICK))
        return Trace(**{name: getattr(self, name)[ticks] for name in self.__dataclass_fields__})

    @property
    def error(self) -> NDArray[np.float64]:
        """Observed less true angle, electrical [deg]. The truth is half a period or a whole one younger."""
        return degrees(self.angle - self.theta_e)


def back_emf(motor: AxisPlant, speed: float) -> float:
    """Amplitude at a mechanical speed [V]."""
    return motor.pole_pairs * motor.psi_m * abs(speed)


def dead_voltage(plant: PlantConfig, axis: int) -> float:
    """What dead time and drops take from a phase against its current [V]; a compensation makes up most of it."""
    motor = plant.axes[axis]
    return motor.dead_time * plant.pwm_frequency * plant.bus.u_source + motor.v_drop


def wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles [rad], same shape, within half a turn."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def degrees(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles [rad], same shape, within half a turn, in degrees."""
    return np.asarray(np.degrees(wrapped(angle)))


def substate(board: Board, name: str) -> int:
    """Number of a sub-state of RUN by its name."""
    return board.catalogue.enums["substate_t"][name]


def without_fault(board: Board, axis: int, name: str) -> None:
    """Take a fault out of those that may stop an axis."""
    words = board.read_raw("param.faults_enabled")
    words[axis] &= ~board.catalogue.flag("faults", name).mask
    board.write_raw("param.faults_enabled", words)


def fault_names(board: Board, word: int) -> str:
    """Faults of a word by their names; empty when there is none."""
    return "+".join(fault.name for fault in board.catalogue.active("faults", word))


def ended(board: Board, axis: int) -> str:
    """Why an axis no longer turns in closed loop; empty while it does."""
    if faults := word(board, axis, "faults"):
        return fault_names(board, faults)
    return "" if word(board, axis, "substate") == substate(board, "SPIN") else "the axis has switched off"


def let_go(board: Board, axis: int) -> bool:
    """Whether an axis has ended; its load, which would turn the shaft back, ends with it."""
    if not ended(board, axis):
        return False
    board.set_load(axis, 0.0)
    return True


@contextmanager
def observing(plant: PlantConfig, seed: int) -> Iterator[Board]:
    """A fresh board whose axes do without their encoders, enabled in speed mode: a set-point starts them."""
    with fresh_board(plant, seed) as board:
        board.run(BOOT)
        observer = board.catalogue.enums["feedback_kind_t"]["OBSERVER"]
        board.write_raw("param.feedback", [observer] * AXES)
        for axis in range(AXES):
            choose_mode(board, axis, "SPEED")
        board.write("cmd.enable", [1] * AXES)
        board.run(LOOK)
        yield board


@contextmanager
def started(plant: PlantConfig, seed: int, speeds: Mapping[int, float]) -> Iterator[Board]:
    """The same with some axes turning, at parts of a third of their speed limits; the sign says which way.

    Raises
    ------
    SimulationError
        If one of them does not start.
    """
    with observing(plant, seed) as board:
        for axis, part in speeds.items():
            command_speed(board, axis, part * limits_of(board, axis)[0] / 3.0)
        for _ in range(round(START_MAX / LOOK)):
            board.run(LOOK)
            for axis in speeds:
                if faults := word(board, axis, "faults"):
                    raise SimulationError(f"{axis_name(axis)} does not start: {fault_names(board, faults)}")
            if not any(ended(board, axis) for axis in speeds):
                yield board
                return
        raise SimulationError(f"no start within {START_MAX:g} s")


def follow(
    board: Board, axes: Sequence[int], seconds: float, act: Callable[[int], bool | None] | None = None
) -> dict[int, Trace]:
    """Run slow tick by slow tick and keep what the observer says and what is true.

    Parameters
    ----------
    board : Board
        On a slow-tick boundary.
    axes : sequence of int
        Axes to follow (index).
    seconds : float
        Length [s].
    act : callable, optional
        Called with the number of the tick before each one; the run ends when it returns True.
    """
    start = board.time_ns
    rows: list[bytes] = []
    seen: dict[int, list[tuple[float, ...]]] = {axis: [] for axis in axes}
    poles = {axis: board.plant.axes[axis].pole_pairs for axis in axes}
    for k in range(round(seconds / TICK)):
        if act is not None and act(k):
            break
        rows.append(board.record(start + (k + 1) * TICK_NS).tobytes())
        for axis, kept in seen.items():
            truth = board.truth(axis)
            raw = [word(board, axis, f"estimate_{what}") for what in ("theta_e", "speed")]
            kept.append((poles[axis] * truth.theta_m, truth.omega_m, truth.i_d, truth.i_q, *raw))
    log = np.frombuffer(b"".join(rows), board.snapshot_dtype)
    return {axis: _trace(board, log, axis, np.array(kept).reshape(-1, 6).T) for axis, kept in seen.items()}


def _trace(board: Board, log: NDArray[np.void], axis: int, seen: NDArray[np.float64]) -> Trace:
    name = axis_name(axis)
    columns: dict[str, Any] = dict(zip(list(Trace.__dataclass_fields__)[1:7], seen, strict=True))
    for column, variable in (("angle", "estimate_theta_e"), ("speed", "estimate_speed")):
        columns[column] = columns[column] * float(board.catalogue[f"{name}.{variable}"].lsb)
    for column, variable in (("used", "theta_e"), ("speed_ref", "speed_ref")):
        columns[column] = log[f"{name}.{variable}"] * float(board.catalogue[f"{name}.{variable}"].lsb)
    columns |= {flags: log[f"{name}.{flags}"].astype(np.int64) for flags in ("substate", "faults")}
    return Trace(time=TICK * np.arange(1, log.size + 1, dtype=np.float64), **columns)


def limits_of(board: Board, axis: int) -> tuple[float, float]:
    """Limits of speed [rad/s] and current [A] after reset."""
    return get_axis(board, "param.speed_limit", axis), get_axis(board, "param.i_q_limit", axis)
