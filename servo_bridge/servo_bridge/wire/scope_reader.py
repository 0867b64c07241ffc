"""Reads telemetry samples from a connected board, and checks that its clock advances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.errors import FreemasterError, Status, StatusError
from servo_bridge.wire.board_clock import TickExtender
from servo_bridge.wire.scope import Sample, ScopeLayout
from servo_bridge.wire.session import BoardVariable

_STANDSTILL_NS: Final = 1_000_000_000


class BoardResetError(FreemasterError):
    """The board was reset during the connection."""


class BoardStoppedError(FreemasterError):
    """The board responds, but its control loop does not run."""


class ScopeReader:
    """Reads the telemetry of one connection.

    Parameters
    ----------
    client : Client
        Client of the board.
    layout : ScopeLayout
        Variables of a sample; the first is the tick.
    variables : mapping
        Variables of the board.
    extender : TickExtender
        Survives the connection, so that a reset in between is detected.
    """

    def __init__(
        self, client: Client, layout: ScopeLayout, variables: Mapping[str, BoardVariable], extender: TickExtender
    ) -> None:
        self._client = client
        self._layout = layout
        self._extender = extender
        self._request = client.set_scope([ScopeSlot(variables[v.name].address, v.size) for v in layout.variables])
        self._last: Sample | None = None

    @property
    def last_tick(self) -> int:
        """Extended tick of the last sample."""
        return 0 if self._last is None else self._last.tick

    def first(self) -> Sample:
        """Read until the clock of the board advances.

        Raises
        ------
        BoardStoppedError
            If it does not advance within a second.
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
            If the clock of the board was restarted, or stands still.
        """
        assert self._last is not None
        sample = self._read(retries)
        if sample.epoch != self._last.epoch:
            raise BoardResetError("the board was reset: its clock started again")
        if sample.tick != self._last.tick:
            self._last = sample
            return sample
        if sample.response_ns - self._last.response_ns > _STANDSTILL_NS:
            raise BoardStoppedError("the control loop of the board stands still: its clock does not advance")
        return None

    def _read(self, retries: int | None) -> Sample:
        try:
            exchange = self._client.exchange(self._request, retries=retries)
        except StatusError as error:
            if error.code != Status.NOT_INITIALISED:
                raise
            self._extender.restart()
            raise BoardResetError("the board was reset: its telemetry is no longer set up") from error
        raw = self._layout.raw(exchange.data)
        reading = self._extender.update(raw[0], exchange.response_ns)
        times = (exchange.request_ns, exchange.response_ns)
        return Sample(reading.tick, reading.epoch, *times, exchange.data, raw, self._layout)
