"""Inputs and outputs of a link, as its owner sees them. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from servo_bridge.freemaster.line import Transport
from servo_bridge.wire.serial_port import LowLatency

TICK: Final = "tick"
"""Variable that every sample begins with."""

FinalWrite = tuple[str, Sequence[float]]
"""Name of a variable and its values (SI), one per element."""


class Port(Transport, Protocol):
    """An open port."""

    @property
    def low_latency(self) -> LowLatency:
        """Whether the adapter hands over bytes at once."""

    def close(self) -> None:
        """Close it."""


@dataclass(frozen=True)
class LinkConfig:
    """How to reach a board and what to read from it."""

    url: str  # device path or pyserial URL
    baud: int = 115_200  # line speed [bit/s]
    telemetry: tuple[str, ...] = (TICK,)  # variables of every sample; ``tick`` is put in front when it is missing
    rate: float = 0.0  # largest number of samples per second; 0: as many as the line carries
    latency: float = 0.2
    """Largest delay of board and adapters besides the time on the line [s]; the timeout of an answer follows from the
    duration of those before."""
    lost_after: int = 3
    """The link counts as lost after so many unanswered requests in a row, and not before ``lost_after * latency`` of
    silence. So a board that falls silent is noticed within 0.7 s with the defaults; an unplugged adapter is noticed at
    once."""
    queue_limit: int = 64  # largest number of waiting jobs of each kind
    backoff_min: float = 0.1  # pause before the first attempt to connect again [s]
    backoff_max: float = 2.0  # longest pause before later attempts [s]
    password: str | None = field(default=None, repr=False)  # for a board that requires one

    def __post_init__(self) -> None:
        if self.baud <= 0 or self.rate < 0.0 or self.latency <= 0.0 or self.lost_after < 1 or self.queue_limit < 1:
            raise ValueError("baud, latency, lost_after and queue_limit have to be positive, rate not negative")
        if not 0.0 < self.backoff_min <= self.backoff_max:
            raise ValueError("backoff_min has to be positive and not above backoff_max")


@dataclass(frozen=True)
class WriteResult:
    """An acknowledged write."""

    variable: str  # that was written
    request_ns: int  # monotonic host time of the request [ns]
    response_ns: int  # monotonic host time of the acknowledgement [ns]
    last_tick: int  # extended tick of the last sample before it; it took effect after this tick
