"""Access to a board on a serial line for measurements; see `servo_measurement.access.BoardAccess`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np
from servo_measurement.access import (
    TRIGGER_TIMEOUT,
    BoardAccess,
    Capture,
    MeasurementError,
    element_of,
)
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS

from servo_bridge.bursts.recording import BurstRecording, Phase
from servo_bridge.bursts.request import Before, BurstRequest
from servo_bridge.freemaster.errors import RecorderError
from servo_bridge.tool_values import UnknownVariableError
from servo_bridge.wire.keep_alive import kept_alive
from servo_bridge.wire.session import Session
from servo_bridge.wire.session_port import SessionPort

_FAST, _SLOW = 0, 1
_LEAD: Final = 0.2  # longer than the detection of the end of a recording, and its stop [s]
_FILLED: Final = 0.005  # from the answer to the start of a recorder to its first sample, at most [s]
_TICKS_MAX: Final = 2**32 * PERIOD_NS * 1e-9  # range of the time of the board [s]
_ATTEND: Final = 0.08  # period of calls of `meanwhile` during a recording [s]
_PAUSE: Final = 0.02  # period of checks for a due keep-alive [s]


class SessionAccess(SessionPort, BoardAccess):
    """Access to the board of a session; see `measurement_access`.

    Parameters
    ----------
    session : Session
        With a board of this contract.
    meanwhile : callable
        Called periodically during a wait; sends a keep-alive if it is due.
    """

    def __init__(self, session: Session, meanwhile: Callable[[], None]) -> None:
        super().__init__(session)
        self._meanwhile = meanwhile

    def _board_time(self) -> float:
        """Time of the board, which may run slower than that of the computer [s]."""
        return self.read_words("tick")[0] * PERIOD_NS * 1e-9

    def wait(self, seconds: float) -> None:
        """Wait [s]; `meanwhile` is called periodically."""
        end = self._line.clock() + round(seconds * 1e9)
        while (remaining := end - self._line.clock()) > 0:
            self._meanwhile()
            self._line.rest(min(remaining * 1e-9, _PAUSE))

    def capacity(self, names: Sequence[str]) -> int:
        memory = self._session.client.recorder(_FAST).limits().memory
        if memory is None:
            raise MeasurementError("the board does not report the memory size of its recorder")
        return memory // sum(element_of(self.catalogue, name)[0].element_size for name in names)

    def record(self, capture: Capture) -> Trace:
        """Record with the recorder of the board; see `BoardAccess.record`."""
        names, trigger = capture.names, capture.trigger
        condition = None if trigger is None else f"{trigger} >= 1"
        request = BurstRequest(
            tuple(names),
            _SLOW if capture.slow else _FAST,
            condition,
            trigger is not None,
            None if trigger is None else Before(points=0),
            capture.samples,
            1.0 / capture.step,
        )
        recording = BurstRecording(request, self.catalogue, clock=self.clock)
        try:
            burst = self._recorded(recording, capture)
        except (RecorderError, UnknownVariableError, ValueError) as error:
            raise MeasurementError(f"recording {', '.join(names)}: {error}") from error
        finally:
            recording.abandon()
        return Trace(capture.step, {name: burst[name].astype(np.float64) for name in names})

    def _recorded(self, recording: BurstRecording, capture: Capture) -> Trace:
        while recording.phase in (Phase.SET_UP, Phase.READY):
            recording.step(self._session)
            capture.meanwhile(False)
        # The trigger is effective after the memory was filled once; without a trigger the last samples are kept.
        filling = _LEAD if capture.trigger is None else capture.seconds + _FILLED - capture.lead
        begin = self._board_time()
        while (remaining := filling - (self._board_time() - begin) % _TICKS_MAX) > 0.0:
            self.wait(min(remaining, _ATTEND))
            capture.meanwhile(False)
        capture.start()
        due, full, attended = self.clock() + TRIGGER_TIMEOUT + capture.seconds, False, self.clock()
        while (burst := recording.step(self._session)) is None:
            if recording.phase is Phase.WAITING and self.clock() > due:
                raise RecorderError(f"no trigger within {TRIGGER_TIMEOUT:g} s: the signal has not started")
            self._meanwhile()
            if (recording.phase is Phase.READING) != full or self.clock() >= attended + _ATTEND:
                full, attended = recording.phase is Phase.READING, self.clock()
                capture.meanwhile(full)
            self.wait(recording.pause)
        return burst


@contextmanager
def measurement_access(session: Session, check: Callable[[], None] = lambda: None) -> Iterator[SessionAccess]:
    """Access to the board of a session; sends keep-alives until the end of the block.

    Parameters
    ----------
    session : Session
        Session with the board.
    check : callable
        Called periodically while the access waits; may raise to end a measurement.

    Raises
    ------
    BoardMismatchError
        If the board has another table of variables.
    """
    if session.mismatch is not None:
        raise session.mismatch
    with kept_alive(session.client, session.catalogue) as keep_alive:

        def meanwhile() -> None:
            check()
            keep_alive()

        yield SessionAccess(session, meanwhile)
