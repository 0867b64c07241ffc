"""The client on lines that lose, delay and damage frames: cost of a loss, and assignment of answers."""

from __future__ import annotations

import statistics

import pytest
from fake_target import RW, FakeEntry, FakeTarget
from fake_target_v3 import FakeTargetV3
from fake_transport import client_on
from lossy_line import MS, LossyLine
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.discovery import discover
from servo_bridge.freemaster.errors import FreemasterError
from servo_bridge.freemaster.round_trip import RoundTrip

WORDS = 64
BASE = 0x1000


def a_line(kind: type[FakeTarget] = FakeTarget, **options: object) -> tuple[FakeTarget, LossyLine, Client]:
    """Target whose words contain their index, one entry each; identified before the line is disturbed."""
    rows = [FakeEntry(f"w{k}", b"\xe1", BASE + 2 * k, 2, RW) for k in range(WORDS)]
    target = kind(tables=[rows], commands={1: lambda _: 1})
    for k in range(WORDS):
        target.set_int(BASE + 2 * k, 0x2B00 + k, 2)
    line = LossyLine(target.feed, **options)  # type: ignore[arg-type]
    client = client_on(line)
    client.identify()
    return target, line, client


def test_a_lost_request_delays_by_less_than_three_round_trips() -> None:
    _, line, client = a_line()
    request = client.set_scope([ScopeSlot(BASE + 2 * k, 2) for k in range(8)])
    usual = [exchange.response_ns - exchange.request_ns for exchange in (client.exchange(request) for _ in range(50))]
    line.lose_request, line.lose_answer = 0.05, 0.05
    costs = []
    for _ in range(400):
        begin, lost = line.now, line.lost
        client.exchange(request)
        if line.lost == lost + 1:
            costs.append(line.now - begin - statistics.median(usual))
    assert len(costs) > 20
    assert statistics.median(costs) < 3 * statistics.median(usual)


@pytest.mark.parametrize("kind", [FakeTarget, FakeTargetV3])
@pytest.mark.parametrize("half_duplex", [False, True])
def test_answers_are_not_assigned_to_other_requests(kind: type[FakeTarget], half_duplex: bool) -> None:
    """A target that is fast, then slow, then stalls, on a line that loses one frame of ten."""
    _, line, client = a_line(kind)
    line.half_duplex = half_duplex
    line.lose_request = line.lose_answer = 0.05
    right = 0
    for number in range(1500):
        slow = (0.2, 0.2, 8.0, 40.0)[number // 100 % 4]
        line.turnaround_ns = lambda slow=slow: round(line.random.expovariate(1.0 / slow) * MS)  # type: ignore[misc]
        k = line.random.randrange(WORDS)
        try:
            data = client.read_memory(BASE + 2 * k, 2)
        except FreemasterError:
            continue
        assert int.from_bytes(data, "little") == 0x2B00 + k
        right += 1
    assert right > 1400


def test_a_request_that_a_late_target_ignores_delays_by_less_than_a_tenth_of_a_second() -> None:
    """The target is late by a few milliseconds and still sends when it receives the next request."""
    _, line, client = a_line()
    line.half_duplex = True
    usual = line.turnaround_ns
    request = client.set_scope([ScopeSlot(BASE + 2 * k, 2) for k in range(8)])
    expected = client.exchange(request).data
    for late in range(1, 30):
        for _ in range(20):
            client.exchange(request)
        turnarounds = iter([late * MS // 2])
        line.turnaround_ns = lambda turnarounds=turnarounds: next(turnarounds, usual())  # type: ignore[misc]
        begin = line.now
        assert client.exchange(request).data == expected
        assert line.now - begin < 100 * MS


def test_a_command_is_never_started_twice_by_a_slow_target() -> None:
    target, line, client = a_line()
    for _ in range(50):
        client.read_memory(BASE, 2)
    line.turnaround_ns = lambda: 150 * MS
    for _ in range(5):
        before = len(target.requests)
        assert client.run_command(1) == 1
        assert [command for command, _ in target.requests[before:]].count(0x30) == 1


def test_timeout_adapts_to_a_slower_target() -> None:
    _, line, client = a_line()
    for _ in range(50):
        client.read_memory(BASE, 2)
    line.turnaround_ns = lambda: 60 * MS
    for _ in range(20):
        client.read_memory(BASE, 2)
    seen = client.line.statistics.timeouts
    for _ in range(50):
        client.read_memory(BASE, 2)
    assert client.line.statistics.timeouts == seen


@pytest.mark.parametrize("kind", [FakeTarget, FakeTargetV3])
def test_discovery_over_a_bad_line_is_right_or_fails(kind: type[FakeTarget]) -> None:
    target, line, client = a_line(kind, seed=3)
    target.build()
    line.damage = 0.05
    line.lose_request = 0.02
    found = discover(client, client.info)
    assert [(v.name, v.address) for v in found] == [(f"w{k}", BASE + 2 * k) for k in range(WORDS)]


def test_estimate_of_the_response_time_follows_and_backs_off() -> None:
    estimate = RoundTrip(200 * MS)
    assert estimate.allowance_ns == 200 * MS
    for _ in range(40):
        estimate.answered(MS)
    assert estimate.allowance_ns == pytest.approx(2.5 * MS, rel=0.05)
    for k in range(1, 5):
        estimate.lost()
        assert estimate.allowance_ns == pytest.approx((5 * MS // 2) << k, rel=0.05)
    for _ in range(10):
        estimate.lost()
    assert estimate.allowance_ns == 200 * MS
    estimate.answered(MS)
    assert estimate.allowance_ns < 4 * MS
    for k in range(60):
        estimate.answered(MS if k % 2 else 9 * MS)
    assert 15 * MS < estimate.allowance_ns < 30 * MS
    for _ in range(300):
        estimate.answered(MS)
    assert estimate.allowance_ns < 3 * MS
    estimate.answered(30 * MS)
    for _ in range(40):
        estimate.answered(MS)
    assert 10 * MS < estimate.allowance_ns < 30 * MS, "few answers are late, but by a large delay"
    estimate.answered(-5 * MS)
    estimate.answered(10_000 * MS)
    assert estimate.allowance_ns <= 200 * MS
