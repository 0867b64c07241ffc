"""Stamps of samples in simulated ROS time, whose rate is not that of the host."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from servo_bridge.sample_clocks import SampleClocks
from servo_msgs_py.units import PERIOD_NS

MS = 1_000_000
DELAY_NS = 3 * MS  # of a response


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_stamps_are_the_simulated_time_of_the_tick(monkeypatch: pytest.MonkeyPatch, speed: float) -> None:
    steady_ns = 0
    origin_ns = 7_000 * MS  # simulated time at tick 0

    def simulated_ns() -> int:
        return origin_ns + round(steady_ns * speed)

    clock = SimpleNamespace(ros_time_is_active=True, now=lambda: SimpleNamespace(nanoseconds=simulated_ns()))
    monkeypatch.setattr("servo_bridge.wire.board_clock.time.monotonic_ns", lambda: steady_ns)
    clocks = SampleClocks(cast(Any, clock), 0)
    clocks._wall._steady = lambda: steady_ns  # a default argument
    stamps = []
    for n in range(1, 1000):
        steady_ns = n * 10 * MS
        tick = round((steady_ns - DELAY_NS) * speed / PERIOD_NS)
        stamps.append(clocks.stamp(cast(Any, SimpleNamespace(tick=tick, epoch=0, response_ns=steady_ns))))
        assert stamps[-1] == pytest.approx(origin_ns + tick * PERIOD_NS, abs=2.1 * DELAY_NS)
    assert stamps == sorted(set(stamps))
    assert clocks.origin_ns == pytest.approx(origin_ns, abs=2.1 * DELAY_NS)
    assert clocks.board_time(steady_ns) == pytest.approx(steady_ns * speed * 1e-9, abs=0.01)
