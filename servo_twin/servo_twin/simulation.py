"""Runs of one virtual board in simulated time: enable, move, record. No ROS, no clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from servo_measurement.step_response import overshoot, settling_time
from servo_msgs_py.board_port import BoardPort, place, reached, read_axis, word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.board import Board, SimulationError

__all__ = ["MoveResult", "SimulationError", "enable", "keep_set_points", "move", "record"]

_BOOT = 0.03  # reset to STOP [s]
SEARCH_MAX = 6.5  # rotor search of both axes [s]
_STEP = 0.01  # polling interval of the state [s]


@dataclass(frozen=True)
class MoveResult:
    """One position move of one axis."""

    axis: str  # name of the axis
    target: int  # commanded position [counts]
    reached: int  # position at the end [counts]
    overshoot: int  # largest distance beyond the target [counts]
    settling_time: float | None  # from the command until the shaft stays within the tolerance [s]; None: not settled
    steady_state: int  # largest distance from the target over the last quarter of the recording [counts]
    speed_max: float  # largest magnitude in the recording [rad/s]
    i_q_max: float  # largest magnitude in the recording [A]


def record(board: Board, seconds: float) -> NDArray[np.void]:
    """Run for some simulated time [s] and record every snapshot."""
    return board.record(board.time_ns + round(seconds * 1e9))


def keep_set_points(board: BoardPort) -> None:
    """Disable the timeout of velocity and torque set-points: no host repeats them in such a run."""
    write_axis(board, "param.command_timeout", 0, 0.0)


def enable(board: BoardPort, search_max: float = SEARCH_MAX) -> float:
    """Enable both axes of a new board and wait for SPIN; returns the duration of the rotor search [s].

    Parameters
    ----------
    board : BoardPort
        New board, in simulated time.
    search_max : float
        Largest duration of the rotor search [s].

    Raises
    ------
    SimulationError
        If an axis has a fault, or on a timeout of the rotor search.
    """
    keep_set_points(board)
    board.wait(_BOOT)
    for axis in range(AXES):
        write_word(board, "cmd.enable", axis, 1)
    begin = board.clock()

    def found() -> bool:
        for axis in range(AXES):
            if faults := board.catalogue.active("faults", word(board, axis, "faults")):
                raise SimulationError(f"{axis_name(axis)}: " + "; ".join(f"{f.name}: {f.cause}" for f in faults))
        return all(place(board, axis) == "SPIN" for axis in range(AXES))

    if not reached(board, found, search_max, _STEP):
        raise SimulationError(f"rotor search not finished within {search_max:g} s" + "".join(_waiting(board)))
    return board.clock() - begin


def _waiting(board: BoardPort) -> Iterator[str]:
    """What the axes wait for whose rotor is not found."""
    for axis in range(AXES):
        speed, where = read_axis(board, f"{axis_name(axis)}.speed", 0), place(board, axis)
        if where == "ALIGN":
            yield (
                f"; the shaft of {axis_name(axis)} does not come to rest in ALIGN: it needs friction, and in another "
                "simulator a small time step (servo_twin/doc/coupling.md)"
            )
        if where == "CALIB" and abs(speed) > 0.0:
            yield (
                f"; {axis_name(axis)} waits in CALIB until its shaft rests, which turns at {speed:g} rad/s: hold the "
                "load until the rotor is found, for example by a holding brake (firmware/doc/pins.md)"
            )


def move(
    board: Board, targets: dict[int, int], seconds: float, tolerance: int = 2
) -> tuple[list[MoveResult], NDArray[np.void]]:
    """Command positions [counts] by axis and measure the moves.

    Parameters
    ----------
    board : Board
        Board with the axes in SPIN.
    targets : dict
        Axis index to position [counts].
    seconds : float
        Length of the recording [s].
    tolerance : int
        Permitted distance from the target after settling [counts].
    """
    raw = board.read_words("cmd.position")
    for axis, target in targets.items():
        raw[axis] = target
    for axis in set(range(AXES)) - set(targets):
        raw[axis] = board.read_words(f"{axis_name(axis)}.position")[0]
    board.write_raw("cmd.position", raw)
    log = record(board, seconds)
    return [_measure(board, log, axis, target, tolerance) for axis, target in targets.items()], log


def _measure(board: Board, log: NDArray[np.void], axis: int, target: int, tolerance: int) -> MoveResult:
    name = axis_name(axis)
    position = np.asarray(log[f"{name}.position"], dtype=np.float64)
    si = board.si(log)
    return MoveResult(
        name,
        target,
        int(position[-1]),
        int(overshoot(position, target)),
        settling_time(si.time - si.time[0], position - target, tolerance),
        int(np.abs(position[-position.size // 4 :] - target).max()),
        float(np.abs(si[f"{name}.speed"]).max()),
        float(np.abs(si[f"{name}.i_q"]).max()),
    )


def turns(value: float) -> int:
    """Convert revolutions to position counts."""
    return round(value * COUNTS_PER_TURN)
