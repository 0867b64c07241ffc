"""The log throttle."""

from __future__ import annotations

from servo_bridge.throttle import Throttle


def test_burst_passes_and_then_the_rate_is_limited() -> None:
    throttle = Throttle(burst=3, rate=2.0)
    assert [throttle.admit("a", 0.0) for _ in range(5)] == [0, 0, 0, None, None]
    assert throttle.admit("a", 0.4) is None
    assert throttle.admit("a", 0.5) == 3
    assert throttle.admit("a", 0.6) is None


def test_keys_are_independent_and_a_pause_refills() -> None:
    throttle = Throttle(burst=1, rate=1.0)
    assert throttle.admit("a", 0.0) == 0
    assert throttle.admit("b", 0.0) == 0
    assert throttle.admit("a", 0.1) is None
    assert [throttle.admit("a", 100.0), throttle.admit("a", 100.0)] == [1, None]
