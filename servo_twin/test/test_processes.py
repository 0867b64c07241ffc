"""Child processes end with their parent and report the reason of their end."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from servo_twin.processes import Child, ChildError, executable, stop_all, wait_until

pytestmark = pytest.mark.realtime

STUBBORN = """
import os, signal, subprocess, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)
grandchild = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"])
print("ready", grandchild.pid, flush=True)
signal.pause()
"""
POLITE = "import signal; signal.signal(signal.SIGTERM, lambda *_: exit(0)); print('ready', flush=True); signal.pause()"


@pytest.fixture
def children() -> Iterator[list[Child]]:
    started: list[Child] = []
    yield started
    for child in started:
        child.kill()


def start(children: list[Child], folder: Path, code: str) -> Child:
    child = Child(f"child{len(children)}", [sys.executable, "-c", code], folder / f"{len(children)}.log", os.environ)
    children.append(child)
    return child


def ready(child: Child) -> bool:
    return "ready" in child.text()


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_child_ends_after_a_signal(children: list[Child], tmp_path: Path) -> None:
    child = start(children, tmp_path, POLITE)
    assert wait_until(lambda: ready(child), children, 10.0)
    assert child.stop() is True
    assert child.exit_status == 0


def test_child_that_ignores_signals_is_killed_with_its_group(children: list[Child], tmp_path: Path) -> None:
    child = start(children, tmp_path, STUBBORN)
    assert wait_until(lambda: ready(child), children, 10.0)
    grandchild = int(child.text().split()[1])
    assert child.stop(timeout=0.2) is False
    assert not child.running
    assert wait_until(lambda: not alive(grandchild), [], 5.0)


def test_children_are_stopped_in_order_and_killed_ones_reported(children: list[Child], tmp_path: Path) -> None:
    for _ in range(2):
        start(children, tmp_path, POLITE)
    assert wait_until(lambda: all(map(ready, children)), children, 10.0)
    assert stop_all(children) == []
    assert not any(child.running for child in children)


def test_child_that_ends_is_reported_with_its_last_output(children: list[Child], tmp_path: Path) -> None:
    long = "import os; os.lseek(1, os.truncate(1, 10**12) or 0, 2)"  # without the memory for it
    child = start(children, tmp_path, f"{long}; print('the reason'); raise SystemExit(3)")
    with pytest.raises(ChildError, match=r"(?s)child0 has ended with status 3.*the reason"):
        wait_until(lambda: False, [child], 10.0)


def test_missing_program_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ChildError, match="gone cannot be started"):
        Child("gone", ["/no/such/program"], tmp_path / "log", os.environ)
    with pytest.raises(ChildError, match="make setup"):
        executable("no-such-script")


def test_waiting_ends_with_the_timeout(children: list[Child], tmp_path: Path) -> None:
    child = start(children, tmp_path, POLITE)
    assert wait_until(lambda: False, [child], 0.1) is False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel ends the child on Linux only")
def test_a_child_ends_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    owner_code = (
        "import os, sys, time; from pathlib import Path; from servo_twin.processes import Child\n"
        f"child = Child('child', [sys.executable, '-c', {POLITE!r}], Path({str(tmp_path / 'log')!r}), os.environ)\n"
        "print(child.pid, flush=True); time.sleep(60)"
    )
    owner = subprocess.Popen([sys.executable, "-c", owner_code], stdout=subprocess.PIPE, text=True)
    with owner:
        try:
            assert owner.stdout is not None
            child = int(owner.stdout.readline())
            assert wait_until(lambda: "ready" in (tmp_path / "log").read_text(), [], 10.0)
            assert alive(child)
        finally:
            owner.kill()
    assert wait_until(lambda: not alive(child), [], 5.0)
