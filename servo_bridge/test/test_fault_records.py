"""When the bridge reads the record of a first fault, and what it makes of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import numpy as np
import pytest
from recorded_fault import NONE, SIZE, recorded
from servo_bridge.fault_records import SECOND_READ, FaultRecords
from servo_bridge.freemaster.errors import AnswerTimeoutError
from servo_bridge.outcome import error_of
from servo_bridge.wire.link_queue import LinkDownError
from servo_msgs_py.catalogue import Catalogue, Value
from servo_msgs_py.fault_record import FaultRecord

CATALOGUE = Catalogue.load()
PHASE_LOST, OVER_CURRENT, OVER_VOLTAGE = (
    CATALOGUE.flag("faults", name).mask for name in ("PHASE_LOST", "OVER_CURRENT", "OVER_VOLTAGE")
)


class Desk:
    """A link whose answers wait until the test hands them out, and a log of what has changed."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Future[Value]]] = []
        self.changed: list[FaultRecord] = []
        self.posted: list[Callable[[], None]] = []
        self.records = FaultRecords(CATALOGUE, self._read, self.posted.append, self.changed.append)

    def _read(self, name: str) -> Future[Value]:
        future: Future[Value] = Future()
        self.asked.append((name, future))
        return future

    def snapshot(self, tick: int, *faults: int) -> list[str]:
        """Show a sample; returns what was asked for because of it."""
        before = len(self.asked)
        self.records.on_snapshot(tick, faults)
        return [name for name, _ in self.asked[before:]]

    def answer(self, data: bytes | Exception) -> None:
        """End the read that was asked for last, and run what was posted."""
        future = self.asked[-1][1]
        if isinstance(data, Exception):
            future.set_exception(data)
        else:
            future.set_result(data)
        self.drain()

    def drain(self) -> None:
        while self.posted:
            self.posted.pop(0)()

    def names(self) -> list[str]:
        return [record.fault.name for record in self.changed if record.fault is not None]


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_nothing_is_read_without_a_fault(desk: Desk) -> None:
    assert [desk.snapshot(tick, 0, 0) for tick in range(8, 8 * 1000, 8)] == [[]] * 999


@pytest.mark.parametrize(("axis", "name"), [(0, "axis1.fault_record"), (1, "axis2.fault_record")])
def test_a_fault_is_read_once(desk: Desk, axis: int, name: str) -> None:
    faults = [PHASE_LOST if k == axis else 0 for k in range(2)]
    desk.snapshot(8, 0, 0)
    assert desk.snapshot(16, *faults) == [name]
    desk.answer(recorded("PHASE_LOST", 11, i_q=4000))
    (record,) = desk.changed
    assert (record.axis, desk.names(), record.tick) == (axis, ["PHASE_LOST"], 11)
    np.testing.assert_allclose(record.table[:, 4], 4000 * 8.25 / 2**15)
    assert desk.records.records == [record if k == axis else None for k in range(2)]
    assert [desk.snapshot(tick, *faults) for tick in range(24, 2000, 8)] == [[]] * 247


def test_a_fault_from_before_is_read_by_a_bridge_that_comes_later(desk: Desk) -> None:
    assert desk.snapshot(800_000, PHASE_LOST, 0) == ["axis1.fault_record"]


def test_a_second_fault_leaves_the_first_one_alone(desk: Desk) -> None:
    desk.snapshot(16, PHASE_LOST, 0)
    desk.answer(recorded("PHASE_LOST", 11))
    assert desk.snapshot(24, PHASE_LOST | OVER_VOLTAGE, 0) == []
    assert desk.snapshot(16 + SECOND_READ, PHASE_LOST | OVER_VOLTAGE, 0) == ["axis1.fault_record"]
    desk.answer(recorded("PHASE_LOST", 11))
    assert desk.names() == ["PHASE_LOST"]


def test_a_cause_that_is_found_behind_a_symptom_is_told(desk: Desk) -> None:
    desk.snapshot(16, OVER_CURRENT, 0)
    desk.answer(recorded("OVER_CURRENT", 11))
    assert desk.snapshot(8 + SECOND_READ, OVER_CURRENT, 0) == []
    assert desk.snapshot(16 + SECOND_READ, OVER_CURRENT, 0) == ["axis1.fault_record"]
    desk.answer(recorded("CURRENT_SENSE", 11))
    assert desk.names() == ["OVER_CURRENT", "CURRENT_SENSE"]
    assert desk.snapshot(16 + 3 * SECOND_READ, OVER_CURRENT, 0) == []


def test_a_fault_after_clearing_is_a_first_one(desk: Desk) -> None:
    desk.snapshot(16, OVER_CURRENT, 0)
    desk.answer(recorded("OVER_CURRENT", 11))
    assert desk.snapshot(24, 0, 0) == []
    assert desk.records.records == [None, None]
    assert desk.snapshot(32, OVER_VOLTAGE, 0) == ["axis1.fault_record"]
    desk.answer(recorded("OVER_VOLTAGE", 27))
    assert desk.names() == ["OVER_CURRENT", "OVER_VOLTAGE"]


def test_a_fault_that_is_cleared_before_its_record_has_come(desk: Desk) -> None:
    desk.snapshot(16, OVER_CURRENT, 0)
    desk.snapshot(24, 0, 0)
    desk.answer(recorded("OVER_CURRENT", 11))
    assert (desk.changed, desk.records.records) == ([], [None, None])


@pytest.mark.parametrize("error", [LinkDownError("gone"), AnswerTimeoutError("silence")])
def test_a_board_that_vanishes_in_the_middle_of_reading(desk: Desk, error: Exception) -> None:
    """Nothing is told; when it is back with its fault, that is read again."""
    desk.snapshot(16, OVER_CURRENT, 0)
    desk.records.link_lost()
    desk.answer(error)
    assert desk.changed == []
    assert desk.snapshot(8000, OVER_CURRENT, 0) == ["axis1.fault_record"]
    desk.answer(recorded("OVER_CURRENT", 11))
    assert desk.names() == ["OVER_CURRENT"]


def test_an_answer_from_before_the_link_was_lost_is_not_told(desk: Desk) -> None:
    desk.snapshot(16, OVER_CURRENT, 0)
    desk.asked[-1][1].set_result(recorded("OVER_CURRENT", 11))
    desk.records.link_lost()
    desk.drain()
    assert desk.changed == []


@pytest.mark.parametrize("data", [NONE, bytes(SIZE - 2), b""])
def test_a_record_that_is_none(desk: Desk, data: bytes) -> None:
    desk.snapshot(16, OVER_CURRENT, 0)
    desk.answer(data)
    assert desk.changed == []


# ---- what has become of a job ---------------------------------------------------------------------------------------
def test_outcome_of_a_job() -> None:
    job: Future[int] = Future()
    assert error_of(job) == "it is not done yet"
    job.set_result(0)
    assert error_of(job) is None
    job = Future()
    job.cancel()
    assert error_of(job) == "it was cancelled"


@pytest.mark.parametrize(("error", "text"), [(LinkDownError("no link"), "no link"), (KeyError(), "KeyError")])
def test_a_job_that_has_failed_says_why(error: Exception, text: str) -> None:
    job: Future[int] = Future()
    job.set_exception(error)
    assert error_of(job) == text
