"""A transport in simulated time."""

from __future__ import annotations

from collections.abc import Callable

from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line


class FakeTransport:
    """Transport that passes requests to `respond` and delivers its result after `delay_ns`.

    `respond` returns bytes, or a list of (delay [ns], bytes) for answers in pieces or with other delays.
    """

    def __init__(self, respond: Callable[[bytes], bytes | list[tuple[int, bytes]]], delay_ns: int = 1_000_000) -> None:
        self.respond = respond
        self.delay_ns = delay_ns
        self.now = 1_000_000_000
        self.requests: list[bytes] = []
        self.sent_at: list[int] = []
        self._pending: list[tuple[int, bytes]] = []

    def clock(self) -> int:
        return self.now

    def push(self, delay_ns: int, data: bytes) -> None:
        """Deliver bytes without a request."""
        self._pending.append((self.now + delay_ns, data))
        self._pending.sort(key=lambda item: item[0])

    def write(self, data: bytes) -> None:
        self.requests.append(data)
        self.sent_at.append(self.now)
        answer = self.respond(data)
        for delay, part in [(self.delay_ns, answer)] if isinstance(answer, bytes) else answer:
            if part:
                self.push(delay, part)

    def read(self, deadline: int) -> bytes:
        due = max(deadline, self.now)
        if self._pending and self._pending[0][0] <= due:
            time_ns, data = self._pending.pop(0)
            self.now = max(self.now, time_ns)
            return data
        self.now = due
        return b""


def client_on(transport: FakeTransport, **options: object) -> Client:
    """Client with the simulated clock of a transport."""
    return Client(Line(transport, clock=transport.clock, **options))  # type: ignore[arg-type]
