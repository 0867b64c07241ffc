"""Interface of a link to a board."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Protocol, TypeVar

from servo_msgs_py.catalogue import Catalogue, Value

from servo_bridge.freemaster.client import BoardInfo
from servo_bridge.wire.link import FinalWrite, LinkConfig, LinkStatus, Sample
from servo_bridge.wire.link_statistics import LinkStatistics
from servo_bridge.wire.scope import ScopeLayout
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import Session

T = TypeVar("T")


class BoardLink(Protocol):
    """Interface of `Link` that the node uses."""

    layout: ScopeLayout

    def start(self) -> None: ...
    def close(self, final_writes: Sequence[FinalWrite] = (), timeout: float = 3.0) -> bool:
        """As `Link.close`; `timeout` [s]."""

    def write_raw(self, name: str, raw: Sequence[int], *, first: int = 0, urgent: bool = False) -> Future[None]: ...
    def read(self, name: str) -> Future[Value]: ...
    def call(self, function: Callable[[Session], T]) -> Future[T]: ...
    def set_keep_alive_period(self, period: float) -> None:
        """As `Link.set_keep_alive_period` [s]."""

    def statistics(self) -> LinkStatistics: ...
    @property
    def board(self) -> BoardInfo | None: ...
    @property
    def low_latency(self) -> LowLatency: ...


class LinkFactory(Protocol):
    """Constructor of a link: `Link`, or a replacement in a test."""

    def __call__(
        self,
        config: LinkConfig,
        catalogue: Catalogue,
        *,
        on_sample: Callable[[Sample], None],
        on_state: Callable[[LinkStatus], None],
        hang: Callable[[], str],
    ) -> BoardLink: ...
