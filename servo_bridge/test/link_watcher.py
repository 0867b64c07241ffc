"""A link with a collector of its samples and states."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from fake_servo import CATALOGUE
from servo_bridge.wire.link import Link, LinkConfig, LinkState, LinkStatus, Sample

TELEMETRY = ("applied_tick", "applied_count", "u_dc", "axis1.position", "axis2.position")
TIMEOUT = 20.0


class Watcher:
    """Collects samples and states of a link, and waits for them."""

    def __init__(self, url: str, **options: object) -> None:
        self.samples: list[Sample] = []
        self.states: list[LinkStatus] = []
        self.times: list[float] = []
        self.changed = threading.Condition()
        self.hang = ""  # what the owner of the link hangs in
        config = replace(LinkConfig(url, telemetry=TELEMETRY, latency=0.1, backoff_max=0.2), **options)  # type: ignore[arg-type]
        self.link = Link(config, CATALOGUE, on_sample=self._sample, on_state=self._state, hang=lambda: self.hang)

    def _sample(self, sample: Sample) -> None:
        with self.changed:
            self.samples.append(sample)
            self.changed.notify_all()

    def _state(self, status: LinkStatus) -> None:
        with self.changed:
            self.states.append(status)
            self.times.append(time.monotonic())
            self.changed.notify_all()

    def wait(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, TIMEOUT), (
                f"not within {TIMEOUT} s; states: {[str(s) for s in self.states]}"
            )

    def wait_state(self, state: LinkState) -> LinkStatus:
        self.wait(lambda: bool(self.states) and self.states[-1].state is state)
        return self.states[-1]

    def wait_samples(self, count: int) -> None:
        target = len(self.samples) + count
        self.wait(lambda: len(self.samples) >= target)


class StartLink(Protocol):
    """Starts a watched link at the fake port."""

    def __call__(self, **options: object) -> Watcher: ...
