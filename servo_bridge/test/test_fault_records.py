"""Reading and publishing of the record of a first fault by the bridge."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import numpy as np
import pytest
from board_context_rig import board_context
from recorded_fault import NONE, SIZE, recorded
from servo_bridge.fault_records import SECOND_READ, FaultRecords
from servo_bridge.freemaster.errors import AnswerTimeoutError
from servo_bridge.outcome import error_of
from servo_bridge.telemetry import Snapshot
from servo_bridge.wire.link_queue import LinkDownError
from servo_msgs_py.catalogue import Catalogue, Value
from servo_msgs_py.fault_record import FaultRecord

CATALOGUE = Catalogue.load()
PHASE_LOST, OVER_CURRENT, OVER_VOLTAGE = (
    CATALOGUE.flag("faults", name).mask for name in ("PHASE_LOST", "OVER_CURRENT", "OVER_VOLTAGE")
)


class RecordsRig:
    """Link whose answers the test delivers, with a log of changed records."""

    def __init__(self) -> None:
        self.reads: list[tuple[str, Future[Value]]] = []
        self.changed: list[FaultRecord] = []
        self.posted: list[Callable[[], None]] = []
        self.records = FaultRecords(board_context(self._read, self.posted.append), self.changed.append)

    def _read(self, name: str) -> Future[Value]:
        future: Future[Value] = Future()
        self.reads.append((name, future))
        return future

    def snapshot(self, tick: int, *faults: int) -> list[str]:
        """Deliver a sample; return the reads that it caused."""
        before = len(self.reads)
        self.records.on_sample(Snapshot(tick, 0, 0, {}, 0, 0, (), faults))
        return [name for name, _ in self.reads[before:]]

    def answer(self, data: bytes | Exception) -> None:
        """Answer the last read, and run the posted functions."""
        future = self.reads[-1][1]
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
def rig() -> RecordsRig:
    return RecordsRig()


def test_nothing_is_read_without_a_fault(rig: RecordsRig) -> None:
    assert [rig.snapshot(tick, 0, 0) for tick in range(8, 8 * 1000, 8)] == [[]] * 999


@pytest.mark.parametrize(("axis", "name"), [(0, "axis1.fault_record"), (1, "axis2.fault_record")])
def test_a_fault_is_read_once(rig: RecordsRig, axis: int, name: str) -> None:
    faults = [PHASE_LOST if k == axis else 0 for k in range(2)]
    rig.snapshot(8, 0, 0)
    assert rig.snapshot(16, *faults) == [name]
    rig.answer(recorded("PHASE_LOST", 11, i_q=4000))
    (record,) = rig.changed
    assert (record.axis, rig.names(), record.tick) == (axis, ["PHASE_LOST"], 11)
    np.testing.assert_allclose(record.samples["i_q"], 4000 * 8.25 / 2**15)
    assert rig.records.records == [record if k == axis else None for k in range(2)]
    assert [rig.snapshot(tick, *faults) for tick in range(24, 2000, 8)] == [[]] * 247


def test_earlier_fault_is_read_at_the_connection(rig: RecordsRig) -> None:
    assert rig.snapshot(800_000, PHASE_LOST, 0) == ["axis1.fault_record"]


def test_second_fault_does_not_replace_the_first_record(rig: RecordsRig) -> None:
    rig.snapshot(16, PHASE_LOST, 0)
    rig.answer(recorded("PHASE_LOST", 11))
    assert rig.snapshot(24, PHASE_LOST | OVER_VOLTAGE, 0) == []
    assert rig.snapshot(16 + SECOND_READ, PHASE_LOST | OVER_VOLTAGE, 0) == ["axis1.fault_record"]
    rig.answer(recorded("PHASE_LOST", 11))
    assert rig.names() == ["PHASE_LOST"]


def test_revised_cause_of_a_fault_is_published(rig: RecordsRig) -> None:
    rig.snapshot(16, OVER_CURRENT, 0)
    rig.answer(recorded("OVER_CURRENT", 11))
    assert rig.snapshot(8 + SECOND_READ, OVER_CURRENT, 0) == []
    assert rig.snapshot(16 + SECOND_READ, OVER_CURRENT, 0) == ["axis1.fault_record"]
    rig.answer(recorded("CURRENT_SENSE", 11))
    assert rig.names() == ["OVER_CURRENT", "CURRENT_SENSE"]
    assert rig.snapshot(16 + 3 * SECOND_READ, OVER_CURRENT, 0) == []


def test_a_fault_after_clearing_is_read_as_a_first_fault(rig: RecordsRig) -> None:
    rig.snapshot(16, OVER_CURRENT, 0)
    rig.answer(recorded("OVER_CURRENT", 11))
    assert rig.snapshot(24, 0, 0) == []
    assert rig.records.records == [None, None]
    assert rig.snapshot(32, OVER_VOLTAGE, 0) == ["axis1.fault_record"]
    rig.answer(recorded("OVER_VOLTAGE", 27))
    assert rig.names() == ["OVER_CURRENT", "OVER_VOLTAGE"]


def test_record_of_a_cleared_fault_is_not_published(rig: RecordsRig) -> None:
    rig.snapshot(16, OVER_CURRENT, 0)
    rig.snapshot(24, 0, 0)
    rig.answer(recorded("OVER_CURRENT", 11))
    assert (rig.changed, rig.records.records) == ([], [None, None])


@pytest.mark.parametrize("error", [LinkDownError("gone"), AnswerTimeoutError("silence")])
def test_record_is_read_again_after_link_loss(rig: RecordsRig, error: Exception) -> None:
    """Nothing is published; the record is read again after the reconnection."""
    rig.snapshot(16, OVER_CURRENT, 0)
    rig.records.lost("gone")
    rig.answer(error)
    assert rig.changed == []
    assert rig.snapshot(8000, OVER_CURRENT, 0) == ["axis1.fault_record"]
    rig.answer(recorded("OVER_CURRENT", 11))
    assert rig.names() == ["OVER_CURRENT"]


def test_answer_of_a_lost_link_is_not_published(rig: RecordsRig) -> None:
    rig.snapshot(16, OVER_CURRENT, 0)
    rig.reads[-1][1].set_result(recorded("OVER_CURRENT", 11))
    rig.records.lost("gone")
    rig.drain()
    assert rig.changed == []


@pytest.mark.parametrize("data", [NONE, bytes(SIZE - 2), b""])
def test_invalid_record_is_not_published(rig: RecordsRig, data: bytes) -> None:
    rig.snapshot(16, OVER_CURRENT, 0)
    rig.answer(data)
    assert rig.changed == []


# ---- result of a job ------------------------------------------------------------------------------------------------
def test_error_of_pending_successful_and_cancelled_jobs() -> None:
    job: Future[int] = Future()
    assert error_of(job) == "it is not done yet"
    job.set_result(0)
    assert error_of(job) is None
    job = Future()
    job.cancel()
    assert error_of(job) == "it was cancelled"


@pytest.mark.parametrize(("error", "text"), [(LinkDownError("no link"), "no link"), (KeyError(), "KeyError")])
def test_error_of_a_failed_job_is_its_reason(error: Exception, text: str) -> None:
    job: Future[int] = Future()
    job.set_exception(error)
    assert error_of(job) == text
