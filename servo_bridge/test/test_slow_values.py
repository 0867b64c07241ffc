"""Values that are read in addition to the telemetry, and the log of changes in a sample."""

from __future__ import annotations

from concurrent.futures import Future

from board_context_rig import board_context
from servo_bridge.health import Winding
from servo_bridge.slow_values import SlowValues
from servo_bridge.snapshot_events import SnapshotEvents
from servo_bridge.telemetry import Snapshot
from servo_msgs_py.catalogue import Catalogue, Value

CATALOGUE = Catalogue.load()
FAULT = CATALOGUE.flag("faults", "OVER_CURRENT")
EXPIRED = CATALOGUE.flag("limits", "EXPIRED").mask


class Reads:
    """Pending reads that `answer` completes."""

    def __init__(self) -> None:
        self.waiting: list[tuple[str, Future[Value]]] = []
        self.motors = 0
        self.windings: list[Winding] = []
        self.values = SlowValues(board_context(self._read), self._on_motors, self.windings.extend)

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
    assert (reads.values.counters, reads.windings) == (None, [])
    reads.values.read_counters()
    reads.answer(late_loops=1.0, receiver_overruns=2.0, winding_temperature=40.0, winding_current=8.0)
    assert reads.values.counters == {"late_loops": 1, "receiver_overruns": 2}
    assert reads.windings == [Winding(40.0, 8.0)] * 2


def test_counters_have_at_most_one_pending_read() -> None:
    reads = Reads()
    reads.values.read_counters()
    under_way = len(reads.waiting)
    reads.values.read_counters()
    assert len(reads.waiting) == under_way


def test_answers_of_a_lost_link_are_ignored() -> None:
    reads = Reads()
    reads.values.read_motors()
    reads.values.link_lost()
    reads.answer(torque_constant=0.05, acceleration_current=2.0)
    assert (reads.values.motors, reads.motors) == ([], 0)


def snapshot(faults: tuple[int, int] = (0, 0), limits: int = 0) -> Snapshot:
    return Snapshot(16, 0, 0, {"axis1.limits": float(limits)}, 16, 0, (), faults)


def test_fault_is_logged_once() -> None:
    events = SnapshotEvents(CATALOGUE, ["arm", "hand"])
    [sentence] = events.faults(None, snapshot((0, FAULT.mask)))
    assert sentence.startswith("hand: ")
    assert FAULT.name in sentence
    assert events.faults(snapshot((0, FAULT.mask)), snapshot((0, FAULT.mask))) == []


def test_expired_set_point_is_logged_once_with_the_known_timeout() -> None:
    events = SnapshotEvents(CATALOGUE, ["arm", "hand"])
    timeout = CATALOGUE["param.command_timeout"]
    [sentence] = events.expired(
        snapshot(), snapshot(limits=EXPIRED), {"param.command_timeout": [round(0.25 / timeout.lsb)]}
    )
    assert sentence == "arm: no velocity or effort set-point for 0.25 s; the axis stops"
    assert "param.command_timeout" in events.expired(None, snapshot(limits=EXPIRED), None)[0]
    assert events.expired(snapshot(limits=EXPIRED), snapshot(limits=EXPIRED), None) == []
