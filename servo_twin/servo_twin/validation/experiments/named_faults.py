"""Common functions of the fault injection experiments: reported fault, detection time, permitted motion."""

from __future__ import annotations

from typing import Final

from servo_msgs_py.board_port import word
from servo_msgs_py.fault_record import FaultRecord, record_variable
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board, BoardError
from servo_twin.board_memory import BUSY
from servo_twin.plant import AxisPlant

NOTHING: Final = ""
"""Name for "no fault"."""

COMMON_FAULTS: Final = ("OVER_VOLTAGE", "UNDER_VOLTAGE", "LATE_LOOP", "WATCHDOG")
"""Faults of both axes."""

PROVOKED_TIME: Final = 3.0
"""Longest time for the detection after the axis is commanded to move [s]."""

FINAL_TIME: Final = 0.15
"""Time until the first fault is final [s]."""

GAIN_MARGIN: Final = 0.5
"""Permitted gain of speed by friction and quantisation [rad/s]."""


def has_fault(board: Board, axis: int) -> bool:
    """Whether an axis reports a fault; it reports none while the software starts after a reset."""
    try:
        return word(board, axis, "faults") != 0
    except BoardError as error:
        if error.status != BUSY:
            raise
        return False


def fault_record(board: Board, axis: int) -> FaultRecord:
    """Record of the first fault of an axis."""
    return FaultRecord.of(axis, board.read(record_variable(axis)), board.catalogue)


def fault_time(board: Board, axis: int, *, lost_count: bool = False) -> int:
    """Time of the first fault of an axis, from its record [ns].

    Parameters
    ----------
    board : Board
        Board, in the slow tick of the detection.
    axis : int
        Index of the axis.
    lost_count : bool
        The core was stopped and has not counted the PWM periods: the present time is returned.
    """
    if lost_count:
        return board.time_ns
    return fault_record(board, axis).tick * PERIOD_NS


def gain_max(motor: AxisPlant, volts: float) -> float:
    """Largest permitted gain of speed with the outputs off [rad/s].

    The decaying current, at most the over-current threshold, accelerates the shaft: half of torque times decay time,
    divided by the inertia.

    Parameters
    ----------
    motor : AxisPlant
    volts : float
        Voltage against which the current decays [V].
    """
    decay = max(motor.l_d, motor.l_q) * motor.i_break / volts
    return 0.5 * motor.torque_constant * motor.i_break * decay / motor.inertia + GAIN_MARGIN
