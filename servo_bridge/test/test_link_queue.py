from __future__ import annotations

import threading
import time
from typing import cast

import pytest
from servo_bridge.wire.link_queue import Job, JobQueue, LinkBusyError, LinkDownError
from servo_bridge.wire.link_statistics import StatisticsCollector
from servo_bridge.wire.session import Session

NO_SESSION = cast(Session, None)


def job(key: str, *, write: bool = True) -> Job:
    return Job(lambda _: key, write=write)


@pytest.fixture
def queue() -> JobQueue:
    q = JobQueue(4)
    q.open()
    return q


def drain(queue: JobQueue) -> list[str]:
    keys = []
    while (taken := queue.take(0.0)) is not None:
        keys.append(taken.run(NO_SESSION))
    return keys


def test_urgent_writes_precede_writes_and_reads_each_in_order(queue: JobQueue) -> None:
    queue.put(job("r1", write=False))
    queue.put(job("w1"))
    queue.put(job("w2"))
    queue.put(job("u1"), urgent=True)
    queue.put(job("u2"), urgent=True)
    assert len(queue) == 5
    assert drain(queue) == ["u1", "u2", "w1", "w2", "r1"]


def test_a_full_queue_refuses_at_once(queue: JobQueue) -> None:
    for k in range(4):
        queue.put(job(str(k)))
    fifth = job("5")
    queue.put(fifth)
    with pytest.raises(LinkBusyError):
        fifth.done.result(0)
    urgent = job("u")
    queue.put(urgent, urgent=True)
    assert drain(queue) == ["u", "0", "1", "2", "3"]


def test_close_fails_pending_and_later_jobs(queue: JobQueue) -> None:
    waiting, late = job("a"), job("b")
    queue.put(waiting)
    queue.close("the cable is out")
    queue.put(late)
    for failed in (waiting, late):
        with pytest.raises(LinkDownError, match="the cable is out"):
            failed.done.result(0)
    assert drain(queue) == []


def test_take_waits_for_a_job_or_a_wake_up(queue: JobQueue) -> None:
    start = time.monotonic()
    assert queue.take(0.02) is None
    assert time.monotonic() - start >= 0.02
    for action in (lambda: queue.put(job("x")), queue.wake):
        timer = threading.Timer(0.02, action)
        timer.start()
        start = time.monotonic()
        queue.take(20.0)
        assert time.monotonic() - start < 10.0
        timer.join()


def test_future_of_a_job_gets_its_result_or_error() -> None:
    good = job("x")
    good.execute(NO_SESSION)
    assert good.done.result(0) == "x"

    def fail(_: Session) -> None:
        raise ValueError("bad")

    bad = Job(fail)
    with pytest.raises(ValueError, match="bad"):
        bad.execute(NO_SESSION)
    with pytest.raises(ValueError, match="bad"):
        bad.done.result(0)
    good.fail(ValueError("too late to fail"))
    assert good.done.result(0) == "x"


def test_a_cancelled_job_is_not_run() -> None:
    ran: list[int] = []
    cancelled = Job(lambda _: ran.append(1))
    cancelled.done.cancel()
    cancelled.execute(NO_SESSION)
    assert ran == []


# ---- statistics ---------------------------------------------------------------------------------------------------
MS = 1_000_000


def test_report_has_rates_and_round_trips() -> None:
    collector = StatisticsCollector()
    collector.connected()
    for k in range(401):
        collector.counters.bytes_out += 5
        collector.counters.bytes_in += 50
        collector.sampled(10 * MS * k, 10 * MS * k + (9 * MS if k % 20 == 0 else 3 * MS))
    report = collector.report(4_010 * MS, waiting=2)
    assert report.samples == 401
    assert report.sample_rate == pytest.approx(100.0, rel=0.02)
    assert report.bytes_out_rate == pytest.approx(500.0, rel=0.02)
    assert report.bytes_in_rate == pytest.approx(5000.0, rel=0.02)
    assert report.round_trip_p50 == pytest.approx(0.003)
    assert report.round_trip_p99 == report.round_trip_max == pytest.approx(0.009)
    assert report.waiting == 2
    assert collector.report(60_000 * MS, waiting=0).sample_rate == 0.0


def test_report_before_the_first_sample_is_zero() -> None:
    report = StatisticsCollector().report(0, waiting=0)
    assert (report.samples, report.sample_rate, report.round_trip_p99) == (0, 0.0, 0.0)
