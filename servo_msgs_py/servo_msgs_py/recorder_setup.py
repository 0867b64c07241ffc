"""Set-up of a recorder of the board as a message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from std_msgs.msg import Float64MultiArray

from servo_msgs_py.convert import snapshot_message, snapshot_table

_COLUMNS: Final = ("recorder", "period", "points")


@dataclass(frozen=True)
class RecorderSetup:
    """Set-up of a burst, known before its recording starts."""

    names: tuple[str, ...]  # variables of a point in order; array elements as ``name[k]``
    recorder: int  # number of the recorder; 0: PWM periods, 1: slow ticks
    period_ns: int  # sampling period [ns]; 0: not reported by the board
    points: int  # maximum number of points of the burst


def setup_message(setup: RecorderSetup | None) -> Float64MultiArray:
    """Message of `servo_msgs_py.topics.RECORDER`; no row if the recorder is idle."""
    rows = [] if setup is None else [[float(setup.recorder), setup.period_ns * 1e-9, float(setup.points)]]
    message = snapshot_message(_COLUMNS, rows)
    message.layout.dim[0].label = "" if setup is None else ",".join(setup.names)
    return message


def setup_from_message(message: Float64MultiArray) -> RecorderSetup | None:
    """Decode a message of `servo_msgs_py.topics.RECORDER`; None if the recorder is idle.

    Raises
    ------
    ValueError
        If the format is wrong.
    """
    columns, table = snapshot_table(message)
    if tuple(columns) != _COLUMNS or len(table) > 1:
        raise ValueError(f"one row with the columns {', '.join(_COLUMNS)} expected, or none")
    if not len(table):
        return None
    recorder, period, points = table[0].tolist()
    names = tuple(filter(None, message.layout.dim[0].label.split(",")))
    if not (names and recorder in (0.0, 1.0) and period >= 0.0 and points >= 1.0):
        raise ValueError(
            f"recorder {recorder:g}, period {period:g} s and {points:g} points of {names} are not a valid set-up"
        )
    return RecorderSetup(names, int(recorder), round(period * 1e9), int(points))
