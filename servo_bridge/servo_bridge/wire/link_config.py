"""Configuration, inputs and outputs of a link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from servo_bridge.freemaster.line import Transport
from servo_bridge.wire.serial_port import LowLatency

TICK: Final = "tick"
"""First variable of every sample."""

FinalWrite = tuple[str, Sequence[float]]
"""Name of a variable and its values (SI), one per element."""


class Port(Transport, Protocol):
    """An open port."""

    @property
    def low_latency(self) -> LowLatency:
        """Whether the adapter passes bytes on immediately."""

    def close(self) -> None:
        """Close the port."""


@dataclass(frozen=True)
class LinkConfig:
    """Address of a board, and variables of its telemetry."""

    url: str  # device path or pyserial URL
    baud: int = 115_200  # line speed [bit/s]
    telemetry: tuple[str, ...] = (TICK,)  # variables of every sample; ``tick`` is added if it is missing
    rate: float = 0.0  # largest number of samples per second; 0: limited by the line only
    latency: float = 0.2
    """Largest delay of board and adapters in addition to the time on the line [s]; the timeouts of responses adapt to
    the measured delays."""
    lost_after: int = 3
    """The link counts as lost after this number of consecutive unanswered requests, and at least ``lost_after *
    latency`` of silence. With the defaults a silent board is detected within 0.7 s, an unplugged adapter at once."""
    queue_limit: int = 64  # largest number of waiting jobs of each kind
    backoff_min: float = 0.1  # pause before the first attempt to reconnect [s]
    backoff_max: float = 2.0  # longest pause before later attempts [s]
    password: str | None = field(default=None, repr=False)  # for a board that requires one

    def __post_init__(self) -> None:
        if self.baud <= 0 or self.rate < 0.0 or self.latency <= 0.0 or self.lost_after < 1 or self.queue_limit < 1:
            raise ValueError("baud, latency, lost_after and queue_limit must be positive, rate not negative")
        if not 0.0 < self.backoff_min <= self.backoff_max:
            raise ValueError("backoff_min must be positive and not above backoff_max")
