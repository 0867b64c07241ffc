"""Test bench for sensorless axes: boards with observer feedback, recordings of observer and true values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import choose, read_axis, word, write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK, TICK_NS

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments.rig import after_snapshot, fresh_board

BOOT: Final = 0.03  # reset to STOP [s]
START_MAX: Final = 3.0  # timeout of a start-up [s]
POLL: Final = 0.01  # polling interval of the state [s]


def angle_error(trace: Trace) -> NDArray[np.float64]:
    """Observed minus true angle, electrical [deg]. The true value is sampled half a period or one period later."""
    return degrees(trace["angle"] - trace["theta_e"])


def back_emf(motor: AxisPlant, speed: float) -> float:
    """Amplitude of the back-EMF at a mechanical speed [V]."""
    return motor.pole_pairs * motor.psi_m * abs(speed)


def dead_voltage(plant: PlantConfig, axis: int) -> float:
    """Voltage error of a phase by dead time and drops [V], mostly compensated by the firmware."""
    motor = plant.axes[axis]
    return motor.dead_time * plant.pwm_frequency * plant.bus.u_source + motor.v_drop


def wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles wrapped to half a revolution [rad], same shape."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def degrees(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles [rad] wrapped to half a revolution, in degrees, same shape."""
    return np.asarray(np.degrees(wrapped(angle)))


def substate(board: Board, name: str) -> int:
    """Number of a sub-state of RUN by name."""
    return board.catalogue.enums["substate_t"][name]


def without_fault(board: Board, axis: int, name: str) -> None:
    """Disable a fault of an axis."""
    words = board.read_words("param.faults_enabled")
    words[axis] &= ~board.catalogue.flag("faults", name).mask
    board.write_raw("param.faults_enabled", words)


def fault_names(board: Board, word: int) -> str:
    """Names of the faults in a word; empty: none."""
    return "+".join(fault.name for fault in board.catalogue.active("faults", word))


def ended(board: Board, axis: int) -> str:
    """Reason why an axis is no longer in closed loop; empty: it is."""
    if faults := word(board, axis, "faults"):
        return fault_names(board, faults)
    return "" if word(board, axis, "substate") == substate(board, "SPIN") else "the axis has switched off"


def remove_load_if_ended(board: Board, axis: int) -> bool:
    """Remove the load, which would reverse the shaft, if an axis is no longer in closed loop; true if so."""
    if not ended(board, axis):
        return False
    board.set_load(axis, 0.0)
    return True


@contextmanager
def observing(plant: PlantConfig, seed: int) -> Iterator[Board]:
    """New board with sensorless axes, enabled in speed mode: a set-point starts them."""
    with fresh_board(plant, seed) as board:
        board.run(BOOT)
        observer = board.catalogue.enums["feedback_kind_t"]["OBSERVER"]
        board.write_raw("param.feedback", [observer] * AXES)
        for axis in range(AXES):
            choose(board, "cmd.mode", axis, "SPEED")
        board.write("cmd.enable", [1] * AXES)
        board.run(POLL)
        yield board


@contextmanager
def started(plant: PlantConfig, seed: int, speeds: Mapping[int, float]) -> Iterator[Board]:
    """As `observing`, with axes rotating at fractions of a third of their speed limits; the sign is the direction.

    Raises
    ------
    SimulationError
        If an axis does not start.
    """
    with observing(plant, seed) as board:
        for axis, part in speeds.items():
            write_axis(board, "cmd.speed", axis, part * limits_of(board, axis)[0] / 3.0)
        for _ in range(round(START_MAX / POLL)):
            board.run(POLL)
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
    """Run in slow ticks and record observer and true values.

    Columns of the trace of an axis: the true values ``theta_e`` (electrical angle) [rad], ``omega`` (mechanical)
    [rad/s], ``i_d`` and ``i_q`` [A]; of the observer ``angle`` (electrical) [rad] and ``speed`` (mechanical) [rad/s];
    ``used``, the electrical angle of the controllers [rad]; ``speed_ref`` [rad/s]; the words ``substate``, ``faults``.

    Parameters
    ----------
    board : Board
        Board at a slow-tick boundary.
    axes : sequence of int
        Axes to record (index).
    seconds : float
        Length [s].
    act : callable, optional
        Called before each tick with its number; the run ends when it returns True.
    """
    start = after_snapshot(board)
    rows: list[bytes] = []
    samples: dict[int, list[tuple[float, ...]]] = {axis: [] for axis in axes}
    poles = {axis: board.plant.axes[axis].pole_pairs for axis in axes}
    for k in range(round(seconds / TICK)):
        if act is not None and act(k):
            break
        rows.append(board.record(start + (k + 1) * TICK_NS).tobytes())
        for axis, samples_of_axis in samples.items():
            truth = board.truth(axis)
            raw = [word(board, axis, f"estimate_{what}") for what in ("theta_e", "speed")]
            samples_of_axis.append((poles[axis] * truth.theta_m, truth.omega_m, truth.i_d, truth.i_q, *raw))
    log = np.frombuffer(b"".join(rows), board.snapshot_dtype)
    return {
        axis: _trace(board, log, axis, np.array(samples_of_axis).reshape(-1, 6).T)
        for axis, samples_of_axis in samples.items()
    }


def _trace(board: Board, log: NDArray[np.void], axis: int, samples: NDArray[np.float64]) -> Trace:
    name = axis_name(axis)
    columns: dict[str, Any] = dict(zip(("theta_e", "omega", "i_d", "i_q", "angle", "speed"), samples, strict=True))
    for column, variable in (("angle", "estimate_theta_e"), ("speed", "estimate_speed")):
        columns[column] = columns[column] * float(board.catalogue[f"{name}.{variable}"].lsb)
    for column, variable in (("used", "theta_e"), ("speed_ref", "speed_ref")):
        columns[column] = log[f"{name}.{variable}"] * float(board.catalogue[f"{name}.{variable}"].lsb)
    columns |= {flags: log[f"{name}.{flags}"].astype(np.int64) for flags in ("substate", "faults")}
    return Trace(TICK, columns, first=1)


def limits_of(board: Board, axis: int) -> tuple[float, float]:
    """Default limits of speed [rad/s] and current [A]."""
    return read_axis(board, "param.speed_limit", axis), read_axis(board, "param.i_q_limit", axis)
