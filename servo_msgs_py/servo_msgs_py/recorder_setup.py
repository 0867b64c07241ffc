"""What a recorder of the board is set up for, as a message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from std_msgs.msg import Float64MultiArray

from servo_msgs_py.convert import snapshot_message, snapshot_table

_COLUMNS: Final = ("recorder", "period", "points")


@dataclass(frozen=True)
class RecorderSetup:
    """A burst that is about to be recorded."""

    names: tuple[str, ...]  # variables of a point in their order, an element of an array as ``name[k]``
    recorder: int  # number of the recorder; 0 is that of the PWM periods, 1 that of the slow ticks
    period_ns: int  # time between two points [ns]; 0: the board does not state it
    points: int  # number of points that the burst will have at most


def setup_message(setup: RecorderSetup | None) -> Float64MultiArray:
    """Message of `servo_msgs_py.topics.RECORDER`; without a set-up that of a recorder that is idle."""
    rows = [] if setup is None else [[float(setup.recorder), setup.period_ns * 1e-9, float(setup.points)]]
    message = snapshot_message(_COLUMNS, rows)
    message.layout.dim[0].label = "" if setup is None else ",".join(setup.names)
    return message


def setup_from_message(message: Float64MultiArray) -> RecorderSetup | None:
    """Read a message of `servo_msgs_py.topics.RECORDER`; None if the recorder is idle.

    Raises
    ------
    ValueError
        If it has another form.
    """
    columns, table = snapshot_table(message)
    if tuple(columns) != _COLUMNS or len(table) > 1:
        raise ValueError(f"one row with the columns {', '.join(_COLUMNS)} wanted, or none")
    if not len(table):
        return None
    recorder, period, points = table[0].tolist()
    names = tuple(filter(None, message.layout.dim[0].label.split(",")))
    if not (names and recorder in (0.0, 1.0) and period >= 0.0 and points >= 1.0):
        raise ValueError(f"recorder {recorder:g}, period {period:g} s and {points:g} points of {names} are no set-up")
    return RecorderSetup(names, int(recorder), round(period * 1e9), int(points))
