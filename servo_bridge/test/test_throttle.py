"""The log throttle."""

from __future__ import annotations

from servo_bridge.throttle import Repetitions, Throttle


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


def test_repetitions_are_reported_once_and_counted_at_their_end() -> None:
    repetitions = Repetitions(pause=1.0)
    assert [repetitions.admit("a", 0.1 * k, f"text {k}") for k in range(5)] == [True] + [False] * 4
    assert repetitions.admit("b", 0.4, "other")
    assert repetitions.ended(1.3) == []
    ended = repetitions.ended(1.5)
    assert [(one.text, one.count, one.end - one.begin) for one in ended] == [("text 0", 5, 0.4), ("other", 1, 0.0)]
    assert repetitions.admit("a", 1.6, "again")
