"""Half-duplex line: one request, one response, with timeouts, retries and late responses.

A request is sent after the response of the previous one, or after its timeout. A response that arrives after the
timeout must not be assigned to the next request. Before that, a fence is therefore sent, a request whose response is
constant: targets respond in order, so later responses are new. Without a fence the line must be quiet for a while.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from servo_bridge.freemaster.commands import Request
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    DamagedAnswerError,
    DisturbedRequestError,
    Status,
    StatusError,
)
from servo_bridge.freemaster.frames import AnswerParser
from servo_bridge.freemaster.round_trip import RoundTrip

_BITS_PER_BYTE: Final = 10  # 8N1
_QUIET_NS: Final = 30_000_000  # longer than the 16 ms after which a USB adapter transmits a partly filled buffer
_SETTLE_LIMIT_NS: Final = 500_000_000
_STRAY_LIMIT: Final = 65_536
_RECEIVED_KEPT: Final = 64
_ANSWER_LIMIT: Final = 512  # longest response [bytes]
_FRAME_BYTES: Final = 3  # start, status and checksum
_FIRST_CHUNK: Final = 64  # of a response of unknown length; largest piece of an adapter [bytes]


class Transport(Protocol):
    """Byte stream.

    Both methods raise `TransportError` if the stream is lost.
    """

    def write(self, data: bytes) -> None:
        """Write all bytes."""

    def read(self, deadline: int) -> bytes:
        """Received bytes as soon as possible; empty after `deadline` (monotonic ns).

        A deadline in the past returns the bytes that are already available.
        """


@dataclass
class ClientStatistics:
    """Counters of a client."""

    requests: int = 0
    retries: int = 0
    timeouts: int = 0
    crc_errors: int = 0
    damaged: int = 0
    refused: int = 0
    stray_bytes: int = 0
    bytes_out: int = 0
    bytes_in: int = 0
    waited_ns: int = 0  # waiting for responses, each up to its timeout


@dataclass(frozen=True)
class Exchange:
    """Completed request: data, times of request and response [monotonic ns], and status of the response."""

    data: bytes
    request_ns: int
    response_ns: int
    status: int = Status.OK


SendRequest = Callable[[Request], Exchange]
"""Sends a request and returns its answer; see `Line.exchange`."""


@dataclass(frozen=True)
class Fence:
    """Request without effect whose response is constant; both as encoded on the line."""

    request: bytes
    answer: bytes
    second: Fence | None = None  # with another response


class Line:
    """Exchanges requests and responses with a target.

    Parameters
    ----------
    transport : Transport
        Byte stream.
    baud : int
        Line speed [bit/s], for the timeouts.
    latency : float
        Largest delay of target and adapters in addition to the time on the line [s]. Timeouts adapt to the measured
        delays; requests that must not be executed twice, and those that take the target some time, always use this
        value.
    retries : int
        Number of repetitions of an idempotent request.
    clock : callable
        Monotonic time [ns], the clock of the transport.
    before_request : callable, optional
        Called before every attempt; may raise to abort a long job.
    statistics : ClientStatistics, optional
        Counters to continue.
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
        self._round_trip = RoundTrip(self._latency_ns)
        self.fence: Fence | None = None  # of the target, after its identification
        self.meanwhile: Callable[[], None] | None = None
        """Called once after the next request has been sent: work during the transmission. Must not send requests."""
        self.retries = retries
        self.clock = clock
        self.before_request = before_request
        self._unsettled = False
        self._asked_ns = 0  # time at which the target has received the last request [ns]
        self.statistics = ClientStatistics() if statistics is None else statistics

    def exchange(self, request: Request, *, retries: int | None = None) -> Exchange:
        """Send a request and wait for its response.

        Parameters
        ----------
        request : Request
            Request to send.
        retries : int, optional
            Replaces the number of the line; requests that are not idempotent are repeated only if the target reports
            that it could not decode them.

        Raises
        ------
        AnswerTimeoutError, DamagedAnswerError, DisturbedRequestError, StatusError, TransportError
        """
        remaining_retries = self.retries if retries is None else retries
        remaining_ns = (remaining_retries + 1) * self._latency_ns
        lost = False
        while True:
            if self._unsettled and self._settle():
                lost = False
            begin_ns = self.clock()
            try:
                exchange = self._attempt(request, ambiguous=lost)
            except AnswerTimeoutError:
                self._unsettled = lost = True
                self._round_trip.lost()
                # Retries count by the sum of their waiting times: the target may just be busy for a moment.
                remaining_ns -= self.clock() - begin_ns
                if not request.idempotent or remaining_retries == 0 or remaining_ns <= 0:
                    raise
                self.statistics.retries += 1
                continue
            except DamagedAnswerError:
                self._unsettled = lost = True
                if not request.idempotent or remaining_retries == 0:
                    raise
            except StatusError as error:
                self._unsettled = lost
                # With a damaged length the target reports an overflow instead of a wrong checksum.
                if error.code not in (Status.CHECKSUM, Status.REQUEST_TOO_LONG):
                    self.statistics.refused += 1
                    raise
                if remaining_retries == 0:
                    if error.code == Status.CHECKSUM:
                        raise DisturbedRequestError(str(error)) from error
                    raise
            else:
                # Both the lost and the repeated request may still be answered.
                self._unsettled = lost
                return exchange
            remaining_retries -= 1
            self.statistics.retries += 1

    def rest(self, seconds: float) -> None:
        """Wait without a request [s]; bytes received meanwhile are counted as stray."""
        deadline = self.clock() + math.ceil(seconds * 1e9)
        while self.clock() < deadline:
            self.statistics.stray_bytes += len(self._transport.read(deadline))

    def work_off(self) -> None:
        """Call `meanwhile` now, not during the next request."""
        work, self.meanwhile = self.meanwhile, None
        if work is not None:
            work()

    def _attempt(self, request: Request, *, ambiguous: bool) -> Exchange:
        """Send once; if the response may belong to an earlier request, it is not used for the round trip."""
        if self.before_request is not None:
            self.before_request()
        self._discard()
        statistics = self.statistics
        statistics.requests += 1
        expected = Status.OK_VARIABLE if request.answer_size is None else Status.OK
        parser = AnswerParser(request.answer_size or 0, request.framing, (expected, *request.statuses))
        received = bytearray()
        count = 0
        request_ns = self.clock()
        self._transport.write(request.frame)
        statistics.bytes_out += len(request.frame)
        self.work_off()
        request_wire = len(request.frame) * self._byte_ns
        self._asked_ns = request_ns + request_wire
        answer_size = _FIRST_CHUNK if request.answer_size is None else request.answer_size + _FRAME_BYTES
        allowance = self._latency_ns if request.patient else self._round_trip.allowance_ns
        deadline = request_ns + request_wire + allowance
        if allowance < self._latency_ns:
            deadline += answer_size * self._byte_ns
        while True:
            begin_ns = self.clock()
            chunk = self._transport.read(deadline)
            response_ns = self.clock()
            statistics.waited_ns += max(min(response_ns, deadline) - begin_ns, 0)
            if chunk:
                statistics.bytes_in += len(chunk)
                count += len(chunk)
                if not received:
                    # Single-wire hardware echoes the request first, so its time is added again.
                    deadline = response_ns + request_wire + request.answer_limit * self._byte_ns + allowance
                if len(received) < _RECEIVED_KEPT:
                    received += chunk[: _RECEIVED_KEPT - len(received)]
                answer = parser.feed(chunk)
                if answer is not None:
                    break
                if parser.crc_errors:
                    statistics.crc_errors += 1
                    statistics.damaged += 1
                    raise DamagedAnswerError(f"{request.name}: the response is damaged", bytes(received))
            if not chunk or response_ns >= deadline:
                if received:
                    statistics.damaged += 1
                    problem = "only a response of the wrong form" if parser.passed_over else "no intact response"
                    raise DamagedAnswerError(f"{request.name}: {problem}", bytes(received))
                statistics.timeouts += 1
                waited = (response_ns - request_ns) * 1e-6
                raise AnswerTimeoutError(f"{request.name}: no response within {waited:.0f} ms")
        if not ambiguous and not request.patient:
            self._round_trip.answered(response_ns - request_ns - request_wire - count * self._byte_ns)
        if parser.trailing and request.idempotent:
            # A byte inserted by the line shifts the checksum; one of 256 such frames seems to be intact.
            statistics.damaged += 1
            raise DamagedAnswerError(f"{request.name}: bytes after the end of the response", bytes(received))
        if answer.is_error:
            raise StatusError(answer.status, request.name)
        return Exchange(answer.data, request_ns, response_ns, answer.status)

    def _discard(self) -> None:
        """Discard received bytes without a request."""
        dropped = 0
        while dropped < _STRAY_LIMIT:
            chunk = self._transport.read(0)
            if not chunk:
                break
            dropped += len(chunk)
        self.statistics.stray_bytes += dropped

    def _settle(self) -> bool:
        """Make sure that a late response is not assigned to the next request; returns whether this is certain."""
        self._unsettled = False
        if self.fence is not None and self._round_trip.allowance_ns < self._latency_ns:
            self._pass(self.fence)
            return True
        limit = self.clock() + _SETTLE_LIMIT_NS
        while self.clock() < limit:
            chunk = self._transport.read(self.clock() + _QUIET_NS)
            if not chunk:
                break
            self.statistics.stray_bytes += len(chunk)
        return False

    def _pass(self, fence: Fence) -> None:
        """Send a fence and wait for its response; earlier bytes are late or damaged.

        A half-duplex target ignores a fence that it receives while it sends a late response. Then the second fence
        follows; its response is another one, so that a response to the first one does not count.

        Without a response the target is slow or the line has errors. Then the longest timeout applies to all requests
        sent, so that there is never more than one of these fences pending.
        """
        if self.before_request is not None:
            self.before_request()
        sent_ns = self._send_fence(fence)
        allowance = self._round_trip.allowance_ns
        limit = sent_ns + len(fence.answer) * self._byte_ns + self._latency_ns
        deadline = sent_ns + len(fence.answer) * self._byte_ns + allowance
        received, arrived_ns = b"", sent_ns
        while True:
            chunk = self._transport.read(deadline)
            now = self.clock()
            received += chunk
            if fence.answer in received:
                self.statistics.bytes_in += len(fence.answer)
                self.statistics.stray_bytes += len(received) - len(fence.answer)
                self._round_trip.answered(now - sent_ns - len(received) * self._byte_ns)
                return
            if now >= limit:
                self.statistics.stray_bytes += len(received)
                return
            if chunk:
                arrived_ns = now
                # The response may follow a late one, which needs its transmission time.
                late_ns = (len(fence.answer) + min(len(received), _ANSWER_LIMIT)) * self._byte_ns
                deadline = min(max(sent_ns + late_ns, now) + allowance, limit)
            elif received and fence.second is not None:
                self._round_trip.late(arrived_ns - self._asked_ns)
                fence = fence.second
                sent_ns = self._send_fence(fence)
                deadline = min(sent_ns + len(fence.answer) * self._byte_ns + allowance, limit)
            else:
                self._round_trip.stalled()
                deadline = limit

    def _send_fence(self, fence: Fence) -> int:
        """Send a fence; returns the time at which the target has received it [ns]."""
        begin_ns = self.clock()
        self._transport.write(fence.request)
        self.statistics.bytes_out += len(fence.request)
        return begin_ns + len(fence.request) * self._byte_ns
