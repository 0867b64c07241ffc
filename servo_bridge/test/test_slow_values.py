"""Values that are read in addition to the telemetry, and the log of changes in a sample."""

from __future__ import annotations

from concurrent.futures import Future

from board_context_rig import board_context
from servo_bridge.health import Condition
from servo_bridge.slow_values import SlowValues
from servo_bridge.snapshot_events import SnapshotEvents
from servo_bridge.telemetry import Snapshot
from servo_bridge.wire.link_statistics import Silence
from servo_msgs_py.catalogue import Catalogue, Value

CATALOGUE = Catalogue.load()
FAULT = CATALOGUE.flag("faults", "OVER_CURRENT")
EXPIRED = CATALOGUE.flag("limits", "EXPIRED").mask


class Reads:
    """Pending reads that `answer` completes."""

    def __init__(self) -> None:
        self.waiting: list[tuple[str, Future[Value]]] = []
        self.motors = 0
        self.conditions: list[Condition] = []
        self.values = SlowValues(board_context(self._read), self._on_motors, self.conditions.extend)

    def _read(self, name: str) -> Future[Value]:
        self.waiting.append((name, Future()))
        return self.waiting[-1][1]

    def _on_motors(self) -> None:
        self.motors += 1

    def answer(self, **values: float) -> None:
        """Complete the pending reads in order, by the last part of the name; unknown names fail."""
        waiting, self.waiting = self.waiting, []
        for name, future in waiting:
            value = values.get(name.split(".")[-1])
            if value is None:
                future.set_exception(ConnectionError("port gone"))
            else:
                future.set_result(value)


def test_motor_data_are_known_when_all_have_been_read() -> None:
    reads = Reads()
    reads.values.read_motors()
    assert reads.values.motors == []
    reads.answer(torque_constant=0.05, acceleration_current=2.0)
    assert [motor.torque_constant for motor in reads.values.motors] == [0.05, 0.05]
    assert reads.motors == 1


def test_a_failed_read_is_ignored_and_the_next_one_is_used() -> None:
    reads = Reads()
    reads.values.read_counters()
    reads.answer(late_loops=1.0)
    assert (reads.values.counters, reads.conditions) == (None, [])
    reads.values.read_counters()
    reads.answer(
        late_loops=1.0, receiver_overruns=2.0, winding_temperature=40.0, winding_current=8.0, oscillation=236.0
    )
    assert reads.values.counters == {"late_loops": 1, "receiver_overruns": 2}
    assert reads.conditions == [Condition(40.0, 8.0, 236.0)] * 2


def test_counters_have_at_most_one_pending_read() -> None:
    reads = Reads()
    reads.values.read_counters()
    under_way = len(reads.waiting)
    reads.values.read_counters()
    assert len(reads.waiting) == under_way


def test_answers_of_a_lost_link_are_ignored() -> None:
    reads = Reads()
    reads.values.read_motors()
    reads.values.lost("gone")
    reads.answer(torque_constant=0.05, acceleration_current=2.0)
    assert (reads.values.motors, reads.motors) == ([], 0)


def snapshot(faults: tuple[int, int] = (0, 0), limits: int = 0) -> Snapshot:
    return Snapshot(16, 0, 0, {"axis1.limits": float(limits)}, 16, 0, (), faults)


def events(parameters: dict[str, list[int]] | None = None) -> tuple[SnapshotEvents, list[str]]:
    """Events of two joints, and their log."""
    log: list[str] = []
    silence = Silence(0.2)
    return SnapshotEvents(CATALOGUE, ["arm", "hand"], log.append, log.append, lambda: silence, lambda: parameters), log


def test_fault_is_logged_once_per_connection() -> None:
    subject, log = events()
    for _ in range(3):
        subject.on_sample(snapshot((0, FAULT.mask)))
    [sentence] = log
    assert sentence.startswith("hand: ")
    assert FAULT.name in sentence
    subject.lost("gone")
    subject.on_sample(snapshot((0, FAULT.mask)))
    assert log == [sentence] * 2


def test_expired_set_point_is_logged_once_with_the_known_timeout() -> None:
    timeout = CATALOGUE["param.command_timeout"]
    subject, log = events({"param.command_timeout": [round(0.25 / timeout.lsb)]})
    for limits in (0, EXPIRED, EXPIRED):
        subject.on_sample(snapshot(limits=limits))
    assert log == ["arm: no velocity or effort set-point for 0.25 s; the axis stops"]
    subject, log = events()
    subject.on_sample(snapshot(limits=EXPIRED))
    assert "param.command_timeout" in log[0]
