"""The simulation thread: order, overload, failure, end."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from servo_twin.lockstep.twin import Pair, Twin
from servo_twin.lockstep.worker import TwinWorker
from twin_rig import COLUMNS, TwinRig

TIMEOUT = 10.0  # [s]


class Recorder:
    """Records the results of a worker; threads can wait for a condition on them."""

    def __init__(self) -> None:
        self.pairs: list[Pair] = []
        self.statuses: list[str] = []
        self.failures: list[Exception] = []
        self._changed = threading.Condition()
        self.worker: TwinWorker | None = None

    def publish(self, twin: Twin, pairs: list[Pair]) -> None:
        with self._changed:
            self.pairs += pairs
            self.statuses.append(twin.status)
            self._changed.notify_all()

    def failed(self, error: Exception) -> None:
        with self._changed:
            self.failures.append(error)
            self._changed.notify_all()

    def wait_for(self, condition: Any) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, TIMEOUT)


class Line:
    """A rig whose samples and commands go through a worker."""

    def __init__(self) -> None:
        self.recorder = Recorder()
        self.rig = TwinRig(real_seed=5, twin_seed=5)
        self.twin = self.rig.twin
        self.worker = TwinWorker(self.twin, lambda p: self.recorder.publish(self.twin, p), self.recorder.failed)
        self.rig.twin = self  # type: ignore[assignment]

    # ---- interface of the twin
    @property
    def status(self) -> str:
        return self.twin.status

    def add_samples(self, columns: Any, table: Any) -> None:
        self.worker.add_samples(columns, table)

    def add_command(self, command: Any) -> None:
        self.worker.add_command(command)

    def step(self) -> list[Pair]:
        return []

    def close(self) -> None:
        self.worker.stop()


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    with line.rig:
        yield line


def test_pairs_are_published_in_order_and_exact(line: Line) -> None:
    line.worker.start()
    line.rig.enable_axes()
    line.rig.move([2.0, -2.0], seconds=0.3)
    last = line.rig.real.tick
    line.recorder.wait_for(lambda: line.recorder.pairs and line.recorder.pairs[-1].tick == last)
    assert [p.tick for p in line.recorder.pairs] == list(range(96, last + 1, 96))
    assert all(p.twin["axis1.position"] == p.real["axis1.position"] for p in line.recorder.pairs)
    figures = line.worker.figures()
    assert figures.samples == len(line.recorder.pairs)
    assert figures.overruns == 0
    assert 0.0 < figures.load <= 1.0


def test_samples_received_before_the_start_are_not_lost(line: Line) -> None:
    line.rig.run(0.1)
    line.worker.start()
    line.recorder.wait_for(lambda: len(line.recorder.pairs) >= 16)


def test_too_many_messages_restart_the_twin(line: Line) -> None:
    line.rig.run(0.3)
    row = np.zeros((1, len(COLUMNS)))
    for tick in range(8, 8 * 1100, 8):
        row[0, 0] = tick
        line.worker.add_samples(COLUMNS, row.copy())
    line.worker.start()
    line.recorder.wait_for(lambda: "the simulation is slower than the board" in line.recorder.statuses)
    assert line.worker.figures().overruns == 1


def test_too_large_a_backlog_of_board_time_restarts_the_twin(line: Line) -> None:
    line.rig.run(0.1)
    table = np.zeros((500, len(COLUMNS)))
    table[:, 0] = np.arange(500) * 800 + 80_000
    line.worker.add_samples(COLUMNS, table)
    line.worker.start()
    line.recorder.wait_for(lambda: "the simulation is slower than the board" in line.recorder.statuses)
    figures = line.worker.figures()
    assert (figures.overruns, figures.backlog) == (1, 0.0)


def test_a_table_without_required_columns_is_reported(line: Line) -> None:
    line.worker.start()
    line.worker.add_samples(["tick"], np.zeros((1, 1)))
    line.recorder.wait_for(lambda: any("the snapshot has no applied_tick" in s for s in line.recorder.statuses))
    line.rig.run(0.1)
    line.recorder.wait_for(lambda: line.recorder.pairs)


def test_a_resync_restarts_the_twin(line: Line) -> None:
    line.worker.start()
    line.rig.run(0.3)
    line.worker.resync("asked")
    line.rig.run(0.3)
    last = line.rig.real.tick
    line.recorder.wait_for(lambda: line.recorder.pairs and line.recorder.pairs[-1].tick == last)
    assert line.twin.synchronisations == 2


def test_a_failure_is_reported_and_ends_the_thread(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(maximum: int) -> list[Pair]:
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(line.twin, "step", broken)
    line.worker.start()
    line.rig.sample()
    line.recorder.wait_for(lambda: line.recorder.failures)
    assert isinstance(line.recorder.failures[0], ZeroDivisionError)


def test_worker_stops_with_pending_work(line: Line) -> None:
    line.rig.run(3.0)
    line.worker.start()
    line.worker.stop(TIMEOUT)
    assert line.twin.status == "closed"
    assert "twin" not in [thread.name for thread in threading.enumerate()]
