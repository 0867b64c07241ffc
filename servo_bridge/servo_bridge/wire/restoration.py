"""Waits until a board has taken back the changes of a measurement whose program has ended (app/measurement.h)."""

from __future__ import annotations

from typing import Final

from servo_msgs_py.catalogue import numbers

from servo_bridge.freemaster.errors import FreemasterError
from servo_bridge.wire.session import Session

_STATE: Final = "measurement.state"
_LONGEST: Final = 1.0  # longest wait [s]; sufficient for a shaft at rest
_PAUSE: Final = 0.02  # between two readings [s]


class BoardRestoringError(FreemasterError):
    """The board still has the configuration of a measurement."""

    def __init__(self) -> None:
        super().__init__("the board still has the configuration of a measurement whose program has ended")


def await_restored(session: Session) -> None:
    """Wait until the board has its own configuration and parameters.

    Raises
    ------
    BoardRestoringError
        If that takes longer than a second, because the shaft moves.
    """
    line, restoring = session.client.line, session.catalogue.enums["measurement_state_t"]["RESTORING"]
    end = line.clock() + round(_LONGEST * 1e9)
    while numbers(session.read(session.variables[_STATE]))[0] == restoring:
        if line.clock() > end:
            raise BoardRestoringError
        line.rest(_PAUSE)
