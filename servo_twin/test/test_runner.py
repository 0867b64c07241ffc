"""The runner of many boards: results are independent of the workers; a crashed worker loses only its present trial."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from servo_twin.board import SimulationError
from servo_twin.runner import HERE, RunError, Runner, TrialError, WorkerLostError, run_in_order, run_to_file

NUMBERS = range(40)


@dataclass(frozen=True)
class Square:
    """Work without a board."""

    seconds: float = 0.0  # duration of a trial [s]

    def run(self, number: int) -> int:
        time.sleep(self.seconds)
        return number * number


@dataclass(frozen=True)
class DiesOnce:
    """Kills its process in the first attempt at one trial."""

    marks: Path
    number: int

    def run(self, number: int) -> tuple[int, int]:
        mark = self.marks / "died"
        if number == self.number and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return number, os.getpid()


@dataclass(frozen=True)
class DiesAlways:
    """Kills every process that tries one trial."""

    number: int

    def run(self, number: int) -> int:
        if number == self.number:
            os.kill(os.getpid(), signal.SIGKILL)
        return number


@dataclass(frozen=True)
class Raises:
    """Raises in one trial."""

    number: int
    error: type[Exception] = ZeroDivisionError

    def run(self, number: int) -> int:
        if number == self.number:
            raise self.error("on purpose")
        return number


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_do_not_depend_on_the_number_of_workers(workers: int) -> None:
    results = run_in_order(Runner(workers), Square(), NUMBERS, "squares")
    assert results == [number * number for number in NUMBERS]


def test_file_has_the_finished_trials_in_their_order(tmp_path: Path) -> None:
    """Its folder is created."""
    path = tmp_path / "new" / "trials.json"
    found, text = run_to_file(
        Runner(workers=2), Square(), 5, "squares", path, lambda k, square: {"of": k, "is": square}
    )
    assert found == [(k, k * k) for k in range(5)]
    assert json.loads(text) == [{"of": k, "is": k * k} for k in range(5)]
    assert path.read_text(encoding="utf-8") == text


def test_workers_may_outnumber_the_trials() -> None:
    assert run_in_order(Runner(8), Square(), [3], "squares") == [9]
    assert run_in_order(HERE, Square(), [], "squares") == []


def test_results_come_while_others_are_still_run() -> None:
    results = Runner(2).run(Square(0.01), range(1_000_000_000), "squares")
    with contextlib.closing(results):
        assert {next(results)[0] for _ in range(10)} <= set(range(20))


@pytest.mark.parametrize(("workers", "least"), [(1, 11), (2, 5)])
def test_a_run_that_is_ended_has_left_a_line_of_each_result(
    workers: int, least: int, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(TrialError):
        run_in_order(Runner(workers), Raises(11), NUMBERS, "trials", "number {}".format)
    lines = capfd.readouterr().err.splitlines()
    assert len([line for line in lines if re.fullmatch(r"\d+/40  number \d+", line)]) >= least


def test_crash_of_a_worker_loses_no_result(tmp_path: Path) -> None:
    results = run_in_order(Runner(2), DiesOnce(tmp_path, 7), NUMBERS, "trials")
    assert (tmp_path / "died").exists()
    assert [number for number, _ in results] == list(NUMBERS)
    assert len({pid for _, pid in results}) >= 2
    assert os.getpid() not in {pid for _, pid in results}


def test_trial_that_ends_every_worker_is_reported() -> None:
    with pytest.raises(WorkerLostError, match=r"trial 5 has ended 3 workers.*-9"):
        run_in_order(Runner(2), DiesAlways(5), NUMBERS, "trials")


class _NoStart:
    """Ends a process that unpacks it."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os._exit, (3,)

    def run(self, number: int) -> int:
        return number


def test_failed_start_of_workers_is_not_reported_as_a_trial() -> None:
    with pytest.raises(RunError, match="exit status 3 before its first trial"):
        run_in_order(Runner(2), _NoStart(), NUMBERS, "trials")


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_names_its_trial(workers: int) -> None:
    with pytest.raises(TrialError, match=r"(?s)trial 11.*on purpose"):
        run_in_order(Runner(workers), Raises(11), NUMBERS, "trials")


@pytest.mark.parametrize("workers", [1, 2])
def test_error_of_a_board_has_no_traceback(workers: int) -> None:
    with pytest.raises(TrialError, match=r"\Atrial 11:\non purpose\Z"):
        run_in_order(Runner(workers), Raises(11, SimulationError), NUMBERS, "trials")


def test_workers_end_with_an_abandoned_run() -> None:
    results = Runner(2).run(DiesAlways(-1), range(1000), "trials")
    next(results)
    mine = _children()
    assert mine
    results.close()
    assert not mine & _children()


def _children() -> set[int]:
    """Child processes of this process, without the tracker of shared resources."""
    found = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii").split()
    return {pid for pid in map(int, found) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()}


# ---- a Dask cluster --------------------------------------------------------------------------------------------------

WORKERS = 4


class Cluster:
    """A scheduler and workers, each in a process of its own, on loopback."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
        file = folder / "scheduler.json"
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        self.workers = [
            self._start("worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-nanny", "--no-dashboard")
            for _ in range(WORKERS)
        ]
        self.address = self._address(file)

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
        log = (self._folder / f"{words[0]}-{time.monotonic_ns()}.log").open("wb")
        process = subprocess.Popen(command, cwd=self._folder, env=self._environment, stdout=log, stderr=log)
        self.processes = [*getattr(self, "processes", []), process]
        return process

    def _address(self, file: Path) -> str:
        distributed: Any = importlib.import_module("distributed")  # its types are not complete
        deadline = time.monotonic() + 60.0
        while not (file.exists() and file.read_text().endswith("}")) and time.monotonic() < deadline:
            time.sleep(0.05)
        address = str(json.loads(file.read_text())["address"])
        with distributed.Client(address, timeout=60.0, set_as_default=False) as client:
            client.wait_for_workers(WORKERS, timeout=60.0)
        return address

    def stop(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    started = Cluster(tmp_path_factory.mktemp("cluster"))
    yield started
    started.stop()


def test_a_cluster_gives_the_same_results(cluster: Cluster) -> None:
    assert run_in_order(Runner(scheduler=cluster.address), Square(), NUMBERS, "squares") == [n * n for n in NUMBERS]


def test_an_exception_on_a_cluster_names_its_trial(cluster: Cluster) -> None:
    with pytest.raises(TrialError, match=r"(?s)trial 11.*on purpose"):
        run_in_order(Runner(scheduler=cluster.address), Raises(11), NUMBERS, "trials")


def test_no_result_is_missing_when_a_worker_of_the_cluster_is_killed(cluster: Cluster) -> None:
    results: dict[int, int] = {}
    for number, result in Runner(scheduler=cluster.address).run(Square(0.02), range(300), "squares"):
        results[number] = result
        if len(results) == 20:
            cluster.workers[0].kill()
    assert results == {number: number * number for number in range(300)}


def test_missing_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("servo_twin.runner.cluster.CONNECT_TIME", 0.5)
    with pytest.raises(RuntimeError, match=r"no Dask scheduler at tcp://127.0.0.1:1"):
        run_in_order(Runner(scheduler="tcp://127.0.0.1:1"), Square(), NUMBERS, "squares")
