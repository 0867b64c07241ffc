"""Reads telemetry samples from a connected board, and checks that its clock advances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.errors import FreemasterError, Status, StatusError
from servo_bridge.freemaster.line import Exchange
from servo_bridge.wire.board_clock import TickExtender
from servo_bridge.wire.boot_token import read_boot_token
from servo_bridge.wire.scope import Sample, ScopeLayout
from servo_bridge.wire.session import Session

_STANDSTILL_NS: Final = 1_000_000_000


class BoardResetError(FreemasterError):
    """The board was reset during the connection."""


class BoardStoppedError(FreemasterError):
    """The board responds, but its control loop does not run."""


class ScopeReader:
    """Reads the telemetry of one connection.

    A reset of the board removes the set-up of its scope, so every sample proves that there was none. If the clocks of
    board and host disagree, the reader also compares the token of the board.

    Parameters
    ----------
    session : Session
        Session with the board.
    layout : ScopeLayout
        Variables of a sample; the first is the tick.
    extender : TickExtender
        Survives the connection; restarted by the owner if the board was reset in between.
    token : int
        Boot token of the board at the connection; 0: it has none, then a disagreement of the clocks since the previous
        connection counts as a reset.
    on_disagreement : callable
        Called with the smallest error of the clocks [ns] if they disagree although the board was not reset.
    """

    def __init__(
        self,
        session: Session,
        layout: ScopeLayout,
        extender: TickExtender,
        token: int,
        on_disagreement: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._session = session
        self._layout = layout
        self._extender = extender
        self._token = token
        self._on_disagreement = on_disagreement
        slots = [ScopeSlot(session.variables[v.name].address, v.size) for v in layout.variables]
        self._request = session.client.set_scope(slots)
        self._last: Sample | None = None

    def first(self) -> Sample:
        """Read until the clock of the board advances.

        Raises
        ------
        BoardResetError, BoardStoppedError
            If the board was reset, or its clock does not advance within a second.
        """
        self._last = self._read(None)
        while True:
            sample = self.next(retries=None)
            if sample is not None:
                return sample

    def next(self, retries: int | None = 0) -> Sample | None:
        """Read the next sample; None if the board has not taken a new one yet.

        Raises
        ------
        BoardResetError, BoardStoppedError
            If the board was reset, or its clock stands still.
        """
        assert self._last is not None
        sample = self._read(retries)
        if sample.tick != self._last.tick:
            self._last = sample
            return sample
        if sample.response_ns - self._last.response_ns > _STANDSTILL_NS:
            raise BoardStoppedError("the control loop of the board stands still: its clock does not advance")
        return None

    def _read(self, retries: int | None) -> Sample:
        exchange = self._exchange(retries)
        if self._disagreement(exchange):
            exchange = self._examined(exchange)
        raw = self._layout.raw(exchange.data)
        reading = self._extender.update(raw[0], exchange.request_ns, exchange.response_ns)
        times = (exchange.request_ns, exchange.response_ns)
        return Sample(reading.tick, reading.epoch, *times, exchange.data, raw, self._layout)

    def _exchange(self, retries: int | None) -> Exchange:
        try:
            return self._session.client.exchange(self._request, retries=retries)
        except StatusError as error:
            if error.code != Status.NOT_INITIALISED:
                raise
            self._extender.restart()
            raise BoardResetError("the board was reset: its telemetry is no longer set up") from error

    def _disagreement(self, exchange: Exchange) -> int:
        (raw, *_) = self._layout.raw(exchange.data)
        return self._extender.disagreement(raw, exchange.request_ns, exchange.response_ns)

    def _examined(self, exchange: Exchange) -> Exchange:
        """Sample to be used instead of one whose clock disagrees."""
        if self._last is None and not self._token:
            self._extender.restart()
            return exchange
        if read_boot_token(self._session) != self._token:
            self._extender.restart()
            raise BoardResetError("the board was reset: it has lost the token of this connection")
        repeated = self._exchange(None)  # a sample that was damaged on the line is discarded
        disagreement = self._disagreement(repeated)
        if disagreement:
            self._on_disagreement(disagreement)
        return repeated
