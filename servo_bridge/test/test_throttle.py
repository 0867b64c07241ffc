"""The log throttle."""

from __future__ import annotations

from servo_bridge.throttle import Throttle


def test_messages_of_a_burst_pass_and_then_their_rate_is_limited() -> None:
    throttle = Throttle(burst=3, rate=2.0)
    assert [throttle.admit("a", 0.0) for _ in range(5)] == [True, True, True, False, False]
    assert not throttle.admit("a", 0.4)
    assert throttle.admit("a", 0.5)
    assert not throttle.admit("a", 0.6)


def test_kinds_are_independent_and_a_pause_fills_the_bucket() -> None:
    throttle = Throttle(pause=1.0)
    assert throttle.admit("a", 0.0)
    assert throttle.admit("b", 0.0)
    assert not throttle.admit("a", 1.0)
    assert [throttle.admit("a", 100.0), throttle.admit("a", 100.0)] == [True, False]


def test_a_burst_with_suppressed_messages_is_reported_at_its_end() -> None:
    throttle = Throttle(pause=1.0)
    assert [throttle.admit("a", 0.1 * k, f"text {k}") for k in range(5)] == [True] + [False] * 4
    assert throttle.admit("b", 0.4, "other")
    assert throttle.ended(1.3) == []
    (burst,) = throttle.ended(1.5)
    assert (burst.text, burst.count, burst.suppressed, burst.end - burst.begin) == ("text 0", 5, 4, 0.4)
    assert throttle.ended(9.9) == []
    assert throttle.admit("a", 1.6, "again")
