"""One recording from configuration to the last point, in steps between which the line is free for others."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from typing import Final

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.recorder_setup import RecorderSetup
from servo_msgs_py.trace import Trace

from servo_bridge.bursts.burst import Channel, burst_of
from servo_bridge.bursts.request import BurstRequest, Prepared
from servo_bridge.freemaster.errors import RecorderError
from servo_bridge.freemaster.recorder import SampleMemory, State, in_order, memory_checked
from servo_bridge.wire.session import Session

POLL: Final = 0.05
"""Period of requests for the state of the recorder [s]."""

_MARGIN: Final = 0.05
"""Margin after which a memory that is filled without a trigger is full [s]."""

_GRACE: Final = 2.0
"""Timeout of a stop of the recorder [s]."""


_PIECE_SECONDS: Final = 0.0025
"""Longest delay of a set-point by a piece of the samples, if the telemetry is shorter [s]."""


def piece_size(sample_size: int, baud: int) -> int:
    """Bytes to read between two samples of the telemetry.

    On a slow line a piece is as long as a sample, so that the telemetry keeps half of its rate; on a fast line larger
    pieces save exchanges.
    """
    return max(sample_size, round(_PIECE_SECONDS * baud / 10))


class Phase(Enum):
    """Progress of a recording."""

    SET_UP = "not started"
    READY = "configured"
    RECORDING = "recording"
    WAITING = "waiting for the trigger"
    STOPPING = "stopping"
    READING = "reading"
    DONE = "done"


class BurstRecording:
    """One recording.

    Parameters
    ----------
    request : BurstRequest
        Configuration.
    catalogue : Catalogue
        Meaning of the variables.
    piece : int, optional
        Bytes read in one step; default: one full response.
    clock : callable, optional
        Time with any origin [s].
    """

    def __init__(
        self,
        request: BurstRequest,
        catalogue: Catalogue,
        piece: int | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.request = request
        self._catalogue = catalogue
        self._piece = piece
        self._clock = clock
        self._stop = False
        self._due = float("inf")
        self._points = 0
        self._prepared: Prepared | None = None
        self._memory: SampleMemory | None = None
        self._data = bytearray()
        self.phase = Phase.SET_UP  # progress
        self.triggered = False  # whether it was ended by the trigger

    @property
    def read(self) -> int:
        """Number of bytes read."""
        return len(self._data)

    @property
    def size(self) -> int:
        """Bytes of all points; 0 if not known yet."""
        return 0 if self._memory is None else self._memory.size

    @property
    def pause(self) -> float:
        """Time to wait before the next step [s]."""
        return POLL if self.phase in (Phase.RECORDING, Phase.WAITING, Phase.STOPPING) else 0.0

    @property
    def setup(self) -> RecorderSetup:
        """Configuration of the recorder, after its set-up."""
        assert self._prepared is not None
        names = tuple(channel.name for channel in self._prepared.channels)
        return RecorderSetup(names, self.request.recorder, self._prepared.period_ns, self._points)

    @property
    def text(self) -> str:
        """Text of the configuration, after the set-up of the recorder."""
        assert self._prepared is not None
        period = self._prepared.period_ns
        rate = f" at {1e9 / period:g} Hz" if period else ""
        trigger = f", trigger {self.request.trigger}" if self.request.trigger is not None else ""
        return f"{self._points} points of {len(self._prepared.channels)} number(s){rate}{trigger}"

    def stop(self) -> None:
        """Stop the recorder without a trigger, in the next step."""
        self._stop = True

    def abandon(self) -> None:
        """Stop a running recorder, without reading."""
        if self._prepared is not None and self.phase in (Phase.RECORDING, Phase.WAITING):
            self._prepared.recorder.stop()

    @property
    def timed(self) -> bool:
        """Whether the board reports its sampling rate; after the set-up."""
        assert self._prepared is not None
        return self._prepared.period_ns > 0

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Recorded channels; after the set-up."""
        assert self._prepared is not None
        return self._prepared.channels

    def step(self, session: Session) -> Trace | None:
        """Execute the next step, which takes few exchanges.

        Returns
        -------
        Trace or None
            All points; None: call again after `pause`.

        Raises
        ------
        UsageError, UnknownVariableError, RecorderError, FreemasterError
            If the recording is not possible; it has ended then.
        """
        if self._prepared is None:
            self._set_up(session)
        elif self.phase is Phase.READY:
            self._begin(self._prepared)
        elif self._memory is None:
            self._poll(self._prepared)
        elif self.read < self.size:
            limit = session.client.read_limit & ~7
            piece = min(limit, self._piece or limit, self.size - self.read)
            self._data += session.client.read_memory(self._memory.address + self.read, piece)
        if self._memory is None or self.read < self.size:
            return None
        assert self._prepared is not None
        self.phase = Phase.DONE
        zero = self._prepared.setup.before if self.triggered else 0
        return burst_of(
            self._prepared.channels, in_order(self._memory, bytes(self._data)), self._prepared.period_ns, zero
        )

    def _set_up(self, session: Session) -> None:
        prepared = self.request.prepare(session, self._catalogue)
        self._points = prepared.recorder.configure(prepared.setup)
        self._prepared = prepared
        self.phase = Phase.READY

    def _begin(self, prepared: Prepared) -> None:
        prepared.recorder.start()
        self.phase = Phase.RECORDING
        if prepared.setup.trigger is not None:
            self.phase = Phase.WAITING
        elif prepared.period_ns:
            self._due = self._clock() + self._span + _MARGIN

    @property
    def _span(self) -> float:
        assert self._prepared is not None
        return self._points * self._prepared.period_ns * 1e-9

    def _poll(self, prepared: Prepared) -> None:
        """Read the state, and stop the recorder if requested or due."""
        if prepared.recorder.state() is not State.RUNNING:
            self.triggered = self.phase is Phase.WAITING
            self._memory = memory_checked(prepared.recorder.memory())
            self.phase = Phase.READING
        elif self.phase is Phase.STOPPING:
            if self._clock() > self._due:
                raise RecorderError("the recorder of the board does not stop")
        elif self._stop or self._clock() >= self._due:
            prepared.recorder.stop()
            self.phase = Phase.STOPPING
            self._due = self._clock() + self._span + _GRACE
