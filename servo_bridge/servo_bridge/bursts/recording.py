"""One burst from its set-up to its last point, in steps that leave the line to others in between. Pure."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from typing import Final

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.recorder_setup import RecorderSetup

from servo_bridge.bursts.burst import Burst, Channel, burst_of
from servo_bridge.bursts.request import BurstRequest, Prepared
from servo_bridge.freemaster.errors import RecorderError
from servo_bridge.freemaster.recorder import SampleMemory, State, in_order, memory_checked
from servo_bridge.wire.session import Session

POLL: Final = 0.05
"""Between two questions for the state of the recorder [s]."""

_MARGIN: Final = 0.05
"""After which a memory that is filled without a trigger is surely full [s]."""

_GRACE: Final = 2.0
"""In which a recorder that was told to stop has to [s]."""


_PIECE_SECONDS: Final = 0.0025
"""For which a set-point may wait for a piece of the samples, however short the telemetry is [s]."""


def piece_size(sample_size: int, baud: int) -> int:
    """Bytes to read between two samples of the telemetry.

    On a slow line a piece takes as long as a sample, so that the telemetry keeps half of its rate; on a fast one what
    counts is the number of exchanges.
    """
    return max(sample_size, round(_PIECE_SECONDS * baud / 10))


class Phase(Enum):
    """How far a recording is."""

    SET_UP = "not begun"
    READY = "set up"
    RECORDING = "recording"
    WAITING = "waiting for the trigger"
    STOPPING = "stopping"
    READING = "reading"
    DONE = "done"


class Recording:
    """One burst.

    Parameters
    ----------
    request : BurstRequest
        What it is to hold.
    catalogue : Catalogue
        Meaning of the variables.
    piece : int, optional
        Bytes that are read in one step; by default as many as the board sends in one answer.
    clock : callable, optional
        Time from any origin [s].
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
        self.triggered = False  # whether the trigger has ended it

    @property
    def read(self) -> int:
        """Bytes that have been read."""
        return len(self._data)

    @property
    def size(self) -> int:
        """Bytes of all points; 0 before they are known."""
        return 0 if self._memory is None else self._memory.size

    @property
    def pause(self) -> float:
        """How long to wait before the next step [s]."""
        return POLL if self.phase in (Phase.RECORDING, Phase.WAITING, Phase.STOPPING) else 0.0

    @property
    def setup(self) -> RecorderSetup:
        """What the recorder is set up for; once it is."""
        assert self._prepared is not None
        names = tuple(channel.name for channel in self._prepared.channels)
        return RecorderSetup(names, self.request.recorder, self._prepared.period_ns, self._points)

    @property
    def text(self) -> str:
        """What is recorded, in words; once the recorder is set up."""
        assert self._prepared is not None
        period = self._prepared.period_ns
        rate = f" at {1e9 / period:g} Hz" if period else ""
        trigger = f", trigger {self.request.trigger}" if self.request.trigger is not None else ""
        return f"{self._points} points of {len(self._prepared.channels)} number(s){rate}{trigger}"

    def stop(self) -> None:
        """End the recording without waiting for the trigger; the next step carries it out."""
        self._stop = True

    def abandon(self) -> None:
        """Stop the recorder where it runs, and read nothing."""
        if self._prepared is not None and self.phase in (Phase.RECORDING, Phase.WAITING):
            self._prepared.recorder.stop()

    @property
    def timed(self) -> bool:
        """Whether the board says how fast it samples; once it has begun."""
        assert self._prepared is not None
        return self._prepared.period_ns > 0

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What is recorded; once it has begun."""
        assert self._prepared is not None
        return self._prepared.channels

    def step(self, session: Session) -> Burst | None:
        """Do what is next, which takes a few exchanges at most.

        Returns
        -------
        Burst or None
            The burst, when it is complete; else None: call again after `pause`.

        Raises
        ------
        UsageError, UnknownVariableError, RecorderError, FreemasterError
            If it cannot be recorded; the recording has ended then.
        """
        if self._prepared is None:
            self._set_up(session)
        elif self.phase is Phase.READY:
            self._begin(self._prepared)
        elif self._memory is None:
            self._look(self._prepared)
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

    def _look(self, prepared: Prepared) -> None:
        """Ask for the state, and have the recorder stop when it has to."""
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
