"""One request, one answer: the half-duplex line with its time-outs, retries and late answers.

Never is a second request sent before the first is answered or given up.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from servo_bridge.freemaster.codec import AnswerParser
from servo_bridge.freemaster.commands import Request
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    DamagedAnswerError,
    DisturbedRequestError,
    Status,
    StatusError,
)

__all__ = ["ClientStatistics", "Exchange", "Line", "Transport"]

_BITS_PER_BYTE: Final = 10  # 8N1
_QUIET_NS: Final = 30_000_000  # longer than the 16 ms after which a USB adapter hands over a partly filled buffer
_SETTLE_LIMIT_NS: Final = 500_000_000
_STRAY_LIMIT: Final = 65_536
_RECEIVED_KEPT: Final = 64


class Transport(Protocol):
    """A byte stream.

    Both methods raise `TransportError` when the stream is gone.
    """

    def write(self, data: bytes) -> None:
        """Hand over all bytes."""

    def read(self, deadline: int) -> bytes:
        """Bytes as soon as there are any; empty when `deadline` (monotonic ns) passes first.

        A deadline in the past returns what is there already.
        """


@dataclass
class ClientStatistics:
    """Counters since the client was made."""

    requests: int = 0
    retries: int = 0
    timeouts: int = 0
    crc_errors: int = 0
    damaged: int = 0
    refused: int = 0
    stray_bytes: int = 0
    bytes_out: int = 0
    bytes_in: int = 0


@dataclass(frozen=True)
class Exchange:
    """One answered request: its data, when it was sent and answered [monotonic ns], and the status of the answer."""

    data: bytes
    request_ns: int
    response_ns: int
    status: int = Status.OK


class Line:
    """The way of one request to a target and of its answer back.

    Parameters
    ----------
    transport : Transport
        Where the bytes go.
    baud : int
        Line speed [bit/s]; time-outs follow from the bytes on the line.
    latency : float
        What the target and the adapters may add to the time on the line [s].
    retries : int
        How often an idempotent request is repeated.
    clock : callable
        Monotonic time [ns], the same as the transport's.
    before_request : callable, optional
        Called before every attempt; may raise to abandon a long job.
    statistics : ClientStatistics, optional
        Counters to go on with.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        baud: int = 115_200,
        latency: float = 0.2,
        retries: int = 2,
        clock: Callable[[], int] = time.monotonic_ns,
        before_request: Callable[[], None] | None = None,
        statistics: ClientStatistics | None = None,
    ) -> None:
        if baud <= 0 or latency < 0.0 or retries < 0:
            raise ValueError(f"baud {baud}, latency {latency:g} s, {retries} retries: not a usable combination")
        self._transport = transport
        self._byte_ns = _BITS_PER_BYTE * 1_000_000_000 // baud
        self._latency_ns = round(latency * 1e9)
        self.retries = retries
        self.clock = clock
        self.before_request = before_request
        self._unsettled = False
        self.statistics = ClientStatistics() if statistics is None else statistics

    def exchange(self, request: Request, *, retries: int | None = None) -> Exchange:
        """Send a request and wait for its answer.

        Parameters
        ----------
        request : Request
            What to send.
        retries : int, optional
            Other than those of the line; requests that are not idempotent are repeated only when the target says that
            it did not understand them.

        Raises
        ------
        AnswerTimeoutError, DamagedAnswerError, DisturbedRequestError, StatusError, TransportError
        """
        left = self.retries if retries is None else retries
        lost_answer = False
        while True:
            if self._unsettled:
                self._settle()
            try:
                exchange = self._attempt(request)
            except (AnswerTimeoutError, DamagedAnswerError):
                # The answer may only be late, so listen before the next request until the line is quiet.
                self._unsettled = lost_answer = True
                if not request.idempotent or left == 0:
                    raise
            except StatusError as error:
                self._unsettled = lost_answer
                # A damaged length makes the target report an overflow instead of a wrong checksum.
                if error.code not in (Status.CHECKSUM, Status.REQUEST_TOO_LONG):
                    self.statistics.refused += 1
                    raise
                if left == 0:
                    if error.code == Status.CHECKSUM:
                        raise DisturbedRequestError(str(error)) from error
                    raise
            else:
                # Both the lost and the repeated request may yet be answered.
                self._unsettled = lost_answer
                return exchange
            left -= 1
            self.statistics.retries += 1

    def _attempt(self, request: Request) -> Exchange:
        if self.before_request is not None:
            self.before_request()
        self._discard()
        statistics = self.statistics
        statistics.requests += 1
        parser = AnswerParser(request.answer_size or 0, request.framing)
        received = bytearray()
        request_ns = self.clock()
        self._transport.write(request.frame)
        statistics.bytes_out += len(request.frame)
        request_wire = len(request.frame) * self._byte_ns
        deadline = request_ns + request_wire + self._latency_ns
        while True:
            chunk = self._transport.read(deadline)
            response_ns = self.clock()
            if chunk:
                statistics.bytes_in += len(chunk)
                if not received:
                    # Single-wire hardware echoes the request first, so its time counts again.
                    deadline = response_ns + request_wire + request.answer_limit * self._byte_ns + self._latency_ns
                if len(received) < _RECEIVED_KEPT:
                    received += chunk[: _RECEIVED_KEPT - len(received)]
                answer = parser.feed(chunk)
                if answer is not None:
                    break
                if parser.crc_errors:
                    statistics.crc_errors += 1
                    statistics.damaged += 1
                    raise DamagedAnswerError(f"{request.name}: the answer is damaged", bytes(received))
            if not chunk or response_ns >= deadline:
                if received:
                    statistics.damaged += 1
                    raise DamagedAnswerError(f"{request.name}: no intact answer", bytes(received))
                statistics.timeouts += 1
                waited = (response_ns - request_ns) * 1e-6
                raise AnswerTimeoutError(f"{request.name}: no answer within {waited:.0f} ms")
        if answer.is_error:
            raise StatusError(answer.status, request.name)
        expected = Status.OK_VARIABLE if request.answer_size is None else Status.OK
        if answer.status != expected and answer.status not in request.statuses:
            statistics.damaged += 1
            raise DamagedAnswerError(f"{request.name}: answer of the wrong form {answer.status:02X}", bytes(received))
        return Exchange(answer.data, request_ns, response_ns, answer.status)

    def _discard(self) -> None:
        """Throw away what came without being asked for."""
        dropped = 0
        while dropped < _STRAY_LIMIT:
            chunk = self._transport.read(0)
            if not chunk:
                break
            dropped += len(chunk)
        self.statistics.stray_bytes += dropped

    def _settle(self) -> None:
        """Listen until the line has been quiet for a while, so that a late answer is not taken for the next one."""
        limit = self.clock() + _SETTLE_LIMIT_NS
        while self.clock() < limit:
            chunk = self._transport.read(self.clock() + _QUIET_NS)
            if not chunk:
                break
            self.statistics.stray_bytes += len(chunk)
        self._unsettled = False
