"""What experiments that break things share: the name and time of a fault, and what may happen until it stands."""

from __future__ import annotations

from typing import Final

from servo_msgs_py.fault_record import FaultRecord, record_variable
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board
from servo_twin.experiments.rig import flags_of, word
from servo_twin.plant import AxisPlant

NOTHING: Final = ""
"""Name of no fault."""

EVERYTHING: Final = ("OVER_VOLTAGE", "UNDER_VOLTAGE", "LATE_LOOP", "WATCHDOG")
"""Faults that concern both axes."""

PROVOKED: Final = 3.0
"""For a fault when the axis is asked to move [s]."""

NAMED: Final = 0.15
"""Until the name of a first fault is final [s]."""

GAIN: Final = 0.5
"""Of speed meanwhile, by the load of the friction or the end of a count [rad/s]."""


def place(board: Board, axis: int) -> str:
    """Sub-state of an axis in RUN, or its state."""
    state = board.catalogue.label("state_t", word(board, axis, "state"))
    return board.catalogue.label("substate_t", word(board, axis, "substate")) if state == "RUN" else state


def faults(board: Board, axis: int) -> set[str]:
    """Faults of an axis by their names."""
    return flags_of(board, axis, "faults")


def first_fault(board: Board, axis: int) -> str:
    """Name of the first fault of an axis, `NOTHING` without one."""
    code = word(board, axis, "first_fault")
    return next((fault.name for fault in board.catalogue.flags["faults"] if fault.bit + 1 == code), NOTHING)


def fault_record(board: Board, axis: int) -> FaultRecord:
    """What led to the first fault of an axis."""
    return FaultRecord.of(axis, board.read(record_variable(axis)), board.catalogue)


def fault_time(board: Board, axis: int, *, lost_count: bool = False) -> int:
    """Time of the first fault of an axis, by its record [ns].

    Parameters
    ----------
    board : Board
        Now is the slow tick in which the fault shows.
    axis : int
        Index of the axis.
    lost_count : bool
        The core has stood still, and its count of periods with it: the time is now.
    """
    if lost_count:
        return board.time_ns
    return fault_record(board, axis).tick * PERIOD_NS


def gain_max(motor: AxisPlant, volts: float) -> float:
    """Speed that a shaft may gain with the outputs off [rad/s].

    The largest current goes on while it decays: half of torque times decay, over inertia.

    Parameters
    ----------
    motor : AxisPlant
    volts : float
        What the current decays against [V].
    """
    decay = max(motor.l_d, motor.l_q) * motor.i_break / volts
    return 0.5 * motor.torque_constant * motor.i_break * decay / motor.inertia + GAIN
