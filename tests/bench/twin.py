"""Speed of a virtual board: ``make bench-twin``.

Real-time factors of one board with two axes, both levels in one run, and of several boards on several threads;
instructions by part; and other simulators with one drive in the same run. Factors depend on the machine and its load,
ratios and counts of instructions almost not. One board is timed by the CPU time of its thread; boards in parallel, and
the one board that they are compared with, by wall-clock time.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, get_args

from bench.peer.environment import peers
from bench.shares import shares
from servo_msgs_py.board_description import DEFAULT_BOARD
from servo_msgs_py.catalogue import AXES
from servo_twin.board import Board, build_of
from servo_twin.level import Level
from servo_twin.simulation import enable

OUT: Final = Path(__file__).resolve().parents[2] / "out" / "bench" / "twin.json"
AIMS: Final[dict[str, float]] = {"registers": 20.0, "ideal": 150.0}
"""Required real-time factors of a turning board."""

SIMULATED: Final[dict[str, float]] = {"registers": 1.0, "ideal": 10.0}
"""Simulated time of a run [s]: at least 0.1 s of wall-clock time, so that one time slice of the scheduler is small."""

LOAD: Final = 0.09  # [N m]
ROUNDS: Final = 30
"""Runs of each state, in turn: other load slows a machine down for seconds."""
ATTEMPTS: Final = 3  # the best attempt is used, as other load disturbs
IDLE_MIN: Final = 0.9
"""Smallest fraction of the available CPU time on a machine without other load."""
THREADS: Final = (1, 2, 4)


def off(board: Board) -> None:
    """Board after power-on."""
    board.run(0.1)


def holding(board: Board) -> None:
    """Both axes hold their positions."""
    enable(board)
    board.run(0.2)


def turning(board: Board) -> None:
    """Both axes turn."""
    enable(board)
    board.write("cmd.mode", [1] * AXES)
    board.write("cmd.speed", [100.0, -50.0])
    board.run(0.2)


def loaded(board: Board) -> None:
    """Both axes turn under load, so that the phase currents are seldom near zero."""
    turning(board)
    for axis in range(AXES):
        board.set_load(axis, LOAD if axis == 0 else -LOAD)
    board.run(0.2)


STATES: Final[tuple[Callable[[Board], None], ...]] = (off, holding, turning, loaded)


def factors(level: Level) -> dict[str, float]:
    """Simulated time over CPU time by state, the best of all rounds."""
    with contextlib.ExitStack() as stack:
        boards = {state.__name__: stack.enter_context(Board(seed=1, level=level)) for state in STATES}
        for state in STATES:
            state(boards[state.__name__])
        minimum = dict.fromkeys(boards, math.inf)
        for _ in range(ROUNDS):
            for name, board in boards.items():
                begin = time.thread_time()
                board.run(SIMULATED[level])
                minimum[name] = min(minimum[name], time.thread_time() - begin)
    return {name: SIMULATED[level] / seconds for name, seconds in minimum.items()}


@dataclass(frozen=True)
class ParallelRun:
    """Result of boards that run in parallel."""

    factor: float  # simulated time of all boards over wall-clock time [1]
    cpu_share: float  # used fraction of the available CPU time [1]; 1 on an idle machine


def run_in_parallel(level: Level, threads: int) -> ParallelRun:
    """Turning boards, one per thread, by wall-clock time; the best of several attempts."""
    boards = [Board(seed=1 + k, level=level) for k in range(threads)]
    for board in boards:
        turning(board)
    found = max((_run_once(level, boards) for _ in range(ATTEMPTS)), key=lambda attempt: attempt.factor)
    for board in boards:
        board.close()
    return found


def _run_once(level: Level, boards: Sequence[Board]) -> ParallelRun:
    """One run of turning boards; the threads are created before the time measurement starts."""
    begins, ends, used = [], [], []
    line = threading.Barrier(len(boards))

    def work(board: Board) -> None:
        line.wait()
        begins.append(time.perf_counter())
        begin = time.thread_time()
        board.run(SIMULATED[level])
        used.append(time.thread_time() - begin)
        ends.append(time.perf_counter())

    workers = [threading.Thread(target=work, args=(board,)) for board in boards]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    wall = max(ends) - min(begins)
    cores = min(len(boards), os.cpu_count() or 1)
    return ParallelRun(len(boards) * SIMULATED[level] / wall, min(sum(used) / (cores * wall), 1.0))


def compiler(library: bytes) -> str:
    """Compiler of a library, from its identification string; clang first, as its libraries may contain parts of gcc."""
    found = re.search(rb"(clang) version ([\d.]+)", library) or re.search(rb"(GCC): \([^)]*\) ([\d.]+)", library)
    return " ".join(part.decode().lower() for part in found.groups()) if found else "unknown compiler"


def measure(peer: bool, counted: bool) -> dict[str, Any]:
    """All figures, by level."""
    result: dict[str, Any] = {
        "cores": os.cpu_count(),
        "compiler": compiler(Path(build_of(DEFAULT_BOARD, "registers").file).read_bytes()),
    }
    for level in get_args(Level):
        one = factors(level)
        many = {str(threads): asdict(run_in_parallel(level, threads)) for threads in THREADS}
        result[level] = {"one board": one, "boards": many, "aim": AIMS[level]}
        if counted:
            result[level]["instructions"] = shares(level)
    result["ideal over registers"] = (
        result["ideal"]["one board"]["turning"] / result["registers"]["one board"]["turning"]
    )
    if peer:
        result["peers"] = peers()
    return result


def growth(boards: dict[str, dict[str, float]]) -> list[str]:
    """Gain by more threads, and a warning about other load."""
    single = boards["1"]["factor"]
    many = ", ".join(f"{n}: {each['factor']:.1f} (x {each['factor'] / single:.1f})" for n, each in boards.items())
    lines = [f"turning boards, one per thread, in parallel, by wall-clock time: {many}"]
    if min(each["cpu_share"] for each in boards.values()) < IDLE_MIN:
        shares = ", ".join(f"{n}: {each['cpu_share']:.0%}" for n, each in boards.items())
        lines.append(f"other processes are running, so the result is not reliable; CPU share of the boards: {shares}")
    return lines


def _shares(counts: dict[str, float] | str) -> str:
    if isinstance(counts, str):
        return counts
    total = sum(counts.values())
    parts = ", ".join(f"{part} {count / total:.0%}" for part, count in sorted(counts.items(), key=lambda c: -c[1]))
    return f"{total:.0f} instructions per PWM period: {parts}"


def _times(figures: dict[str, Any], measured: dict[str, Any], part: str) -> str:
    """Factors of a simulator, and relative speed of the boards of comparable detail."""
    words = []
    for level, kind in (("registers", "switching"), ("ideal", "averaged")):
        theirs = measured[kind][part]
        times = figures[level]["one board"]["turning"] / theirs
        many = f"{times:.0f}" if times >= 100.0 else f"{times:.2g}"
        words.append(f"{kind} {theirs:.2g}, the level {level} is {many} times as fast")
    return "; ".join(words)


def _peers(figures: dict[str, Any]) -> list[str]:
    measured = figures["peers"]
    if isinstance(measured, str):
        return [f"  {measured}"]
    lines = ["  simulators that others use, one drive instead of two, no fixed point, no encoder, no converter:"]
    for name, by_model in measured.items():
        for part in by_model["switching"]:
            what = "" if part == "all" else f", its {part} part alone"
            lines.append(f"  {'':10} {name} {by_model['version']}{what}: {_times(figures, by_model, part)}")
    return lines


def table(figures: dict[str, Any]) -> str:
    """Figures as text."""
    lines = [f"real-time factors, {figures['cores']} cores, boards compiled by {figures['compiler']}"]
    for level in get_args(Level):
        entry = figures[level]
        one = ", ".join(f"{name} {value:.1f}" for name, value in entry["one board"].items())
        missed = ", ".join(name for name, value in entry["one board"].items() if value < entry["aim"])
        lines.append(
            f"  {level:10} one board: {one}; aim {entry['aim']:g}, {f'missed {missed}' if missed else 'reached'}"
        )
        lines += [f"  {'':10} {line}" for line in growth(entry["boards"])]
        if "instructions" in entry:
            lines.append(f"  {'':10} {_shares(entry['instructions'])}")
    lines.append(f"  the register level takes {figures['ideal over registers']:.1f} times as long")
    if "peers" in figures:
        lines += _peers(figures)
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=OUT, metavar="FILE")
    parser.add_argument(
        "--no-peer", action="store_true", help="do not install motulator and motulator-export under out/ and run them"
    )
    parser.add_argument("--no-shares", action="store_true", help="do not count instructions with valgrind")
    options = parser.parse_args(arguments)
    figures = measure(not options.no_peer, not options.no_shares)
    print(table(figures))
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
